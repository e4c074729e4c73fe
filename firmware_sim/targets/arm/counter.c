/* Instructions by SysTick: under -icount shift=0 the emulated board executes one instruction a nanosecond. */
#include <stdint.h>

#include "hal.h"

#define SYST_CSR (*(volatile uint32_t *)0xE000E010u)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014u)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018u)

enum { ENABLE = 1, CORE_CLOCK = 4, LARGEST = 0xffffff, WRAPPED = 0x10000 };

void hal_count_start(void)
{
    SYST_CSR = 0;
    SYST_RVR = LARGEST;
    SYST_CVR = 0;
    SYST_CSR = ENABLE | CORE_CLOCK;
}

uint32_t hal_count_stop(void)
{
    const uint32_t now = SYST_CVR;
    const int wrapped = (SYST_CSR & WRAPPED) != 0;
    SYST_CSR = 0;
    if (wrapped) {
        return 0;
    }
    if (now == 0) {
        return 1; /* not one tick, or the counter had been loaded */
    }
    return (uint32_t)((uint64_t)(LARGEST - now) * 1000000000u / BOARD_CLOCK_HZ);
}
