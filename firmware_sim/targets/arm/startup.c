/* From reset to main: floating-point unit on where there is one, .data copied, .bss cleared. */
#include <stdint.h>

#include "hal.h"

extern uint32_t data_start[], data_end[], data_load[], bss_start[], bss_end[], stack_top[];

int main(void);
void reset_handler(void);
static void fault_handler(void);
void systick_handler(void) __attribute__((weak, alias("fault_handler"))); /* an image with a timer has its own */

#define CPACR (*(volatile uint32_t *)0xE000ED88u)

void reset_handler(void)
{
#ifdef __ARM_FP
    CPACR |= 0xFu << 20; /* full access to CP10 and CP11, before any floating-point instruction */
    __asm volatile("dsb\n isb" ::: "memory");
#endif
    for (uint32_t *to = data_start, *from = data_load; to < data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *to = bss_start; to < bss_end;) {
        *to++ = 0;
    }
    (void)main();
    hal_exit(1); /* main ends in hal_exit: to come back is an error */
}

static void fault_handler(void)
{
    static const char text[] = "fault: an exception was taken on the board\n";
    hal_write(text, sizeof text - 1);
    hal_exit(3);
}

typedef union {
    uint32_t *stack;
    void (*handler)(void);
} vector;

__attribute__((section(".isr_vector"), used)) static const vector vectors[16] = {
    {.stack = stack_top},         {.handler = reset_handler}, {.handler = fault_handler}, {.handler = fault_handler},
    {.handler = fault_handler},   {.handler = fault_handler}, {.handler = fault_handler}, {.stack = 0},
    {.stack = 0},                 {.stack = 0},               {.stack = 0},               {.handler = fault_handler},
    {.handler = fault_handler},   {.stack = 0},               {.handler = fault_handler}, {.handler = systick_handler},
};
