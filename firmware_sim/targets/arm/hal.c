/* Semihosting: the board's console and its exit code belong to the emulator. */
#include "hal.h"

#include <stdint.h>

enum { SYS_OPEN = 0x01, SYS_WRITE = 0x05, SYS_EXIT_EXTENDED = 0x20, OPEN_FOR_WRITING = 4, APPLICATION_EXIT = 0x20026 };

static int console = -1;

static int semihosting(int operation, const uint32_t *arguments)
{
    register int r0 __asm("r0") = operation;
    register const uint32_t *r1 __asm("r1") = arguments;
    __asm volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

void hal_init(void)
{
    static const char terminal[] = ":tt";
    const uint32_t arguments[3] = {(uint32_t)(uintptr_t)terminal, OPEN_FOR_WRITING, sizeof terminal - 1};
    console = semihosting(SYS_OPEN, arguments);
}

void hal_write(const char *text, size_t length)
{
    const uint32_t arguments[3] = {(uint32_t)console, (uint32_t)(uintptr_t)text, (uint32_t)length};
    if (semihosting(SYS_WRITE, arguments) != 0) {
        hal_exit(2);
    }
}

void hal_exit(int code)
{
    const uint32_t arguments[2] = {APPLICATION_EXIT, (uint32_t)code};
    for (;;) {
        (void)semihosting(SYS_EXIT_EXTENDED, arguments);
    }
}
