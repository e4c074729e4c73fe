/*
 * The stack below the caller, painted and looked at again. Neither function uses any itself, so that the first byte
 * painted is the first that whatever the caller calls next can take. At most 16 KB are painted, and never variables.
 */
#include <stdint.h>

#include "hal.h"

/* r0 = sp, r1 = the lowest byte to paint, r2 = the paint */
#define RANGE                                                                                                       \
    ".syntax unified\n mov r0, sp\n movs r1, #1\n lsls r1, r1, #14\n subs r1, r0, r1\n ldr r2, =bss_end\n"            \
    "cmp r1, r2\n bhs 1f\n mov r1, r2\n 1: ldr r2, =0x5eed5eed\n"

__attribute__((naked)) void hal_stack_paint(void)
{
    __asm volatile(RANGE "2: cmp r0, r1\n bls 3f\n subs r0, r0, #4\n str r2, [r0]\n b 2b\n"
                         "3: bx lr\n .ltorg");
}

__attribute__((naked)) uint32_t hal_stack_used(void)
{
    __asm volatile(RANGE "2: cmp r1, r0\n bhs 4f\n ldr r3, [r1]\n adds r1, r1, #4\n cmp r3, r2\n beq 2b\n"
                         "3: subs r1, r1, #4\n"
                         "4: subs r0, r0, r1\n bx lr\n .ltorg");
}
