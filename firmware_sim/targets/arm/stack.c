/*
 * The stack below the caller, painted and looked at again. Neither function uses any itself, so that the first byte
 * painted is the first that whatever the caller calls next can take. At most 16 KB are painted, and never variables;
 * eight words at a time, for an emulator's time goes by the instruction.
 */
#include <stdint.h>

#include "hal.h"

/* r0 = sp, r1 = the lowest byte to paint, a multiple of eight words below r0, r2 = the paint */
#define RANGE                                                                                                       \
    ".syntax unified\n mov r0, sp\n ldr r1, =bss_end\n subs r1, r0, r1\n lsrs r1, r1, #5\n lsls r1, r1, #5\n"         \
    "movs r2, #1\n lsls r2, r2, #14\n cmp r1, r2\n bls 1f\n mov r1, r2\n 1: subs r1, r0, r1\n ldr r2, =0x5eed5eed\n"

__attribute__((naked)) void hal_stack_paint(void)
{
    __asm volatile(RANGE "mov r3, r2\n"
                         "2: cmp r1, r0\n bhs 3f\n"
                         "stmia r1!, {r2, r3}\n stmia r1!, {r2, r3}\n stmia r1!, {r2, r3}\n stmia r1!, {r2, r3}\n b 2b\n"
                         "3: bx lr\n .ltorg");
}

/* Passes two words at a time while they are paint; r4 is kept in ip. */
__attribute__((naked)) uint32_t hal_stack_used(void)
{
    __asm volatile(RANGE "mov ip, r4\n"
                         "2: cmp r1, r0\n bhs 4f\n ldmia r1!, {r3, r4}\n cmp r3, r2\n bne 3f\n cmp r4, r2\n beq 2b\n"
                         "subs r1, r1, #4\n b 4f\n"
                         "3: subs r1, r1, #8\n"
                         "4: subs r0, r0, r1\n mov r4, ip\n bx lr\n .ltorg");
}
