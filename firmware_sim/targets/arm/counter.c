/*
 * Instructions by SysTick: under -icount shift=0 the emulated board executes one instruction a nanosecond.
 *
 * The clock runs on between two counts: to stop and start it takes the emulator longer than a kernel does.
 */
#include <stdint.h>

#include "hal.h"

#define SYST_CSR (*(volatile uint32_t *)0xE000E010u)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014u)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018u)

enum { ENABLE = 1, CORE_CLOCK = 4, LARGEST = 0xffffff, HALF = 0x800000, WRAPPED = 0x10000 };

static uint32_t begun;

void hal_count_start(void)
{
    const uint32_t state = SYST_CSR; /* which forgets that the clock wrapped before */
    begun = SYST_CVR;
    if ((state & (ENABLE | CORE_CLOCK)) != (ENABLE | CORE_CLOCK) || begun < HALF) {
        SYST_CSR = 0;
        SYST_RVR = LARGEST;
        SYST_CVR = 0;
        SYST_CSR = ENABLE | CORE_CLOCK;
        begun = SYST_CVR;
    }
}

uint32_t hal_count_stop(void)
{
    const uint32_t now = SYST_CVR;
    if ((SYST_CSR & WRAPPED) != 0) {
        return 0;
    }
    const uint32_t ticks = (begun - now) & LARGEST; /* the clock goes down, from 0 to LARGEST where it was just set */
    return ticks == 0 ? 1 : (uint32_t)((uint64_t)ticks * 1000000000u / BOARD_CLOCK_HZ);
}
