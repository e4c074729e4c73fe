/*
 * Firmware around a generated controller, as small as it gets: a timer sets the pace, every tick does bounded work, and
 * a refusal of the controller holds the last command.
 *
 * Sensors and actuators are stand-ins, to be replaced: here the double pendulum swings as it did when it was recorded,
 * and one sensor fails for a while. In the emulator the image runs TICKS ticks, says what happened and ends.
 */
#include <math.h>
#include <stdint.h>

#include "double_pendulum_energy_f32.h"
#include "hal.h"
#include "print.h"

enum { TICKS = 400, FAILS_AT = 100, RECOVERS_AT = 150, MOST_FAULTS = 200, RELOAD = 25000 };

#define SYST_CSR (*(volatile uint32_t *)0xE000E010u)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014u)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018u)

void systick_handler(void);

static volatile uint32_t ticks;

void systick_handler(void)
{
    ++ticks;
}

static void timer_start(void)
{
    SYST_RVR = RELOAD - 1u;
    SYST_CVR = 0;
    SYST_CSR = 7; /* core clock, interrupt, on */
}

static void sensors_read(uint32_t tick, double_pendulum_energy_f32_input *in)
{
    const float t = 0.001f * (float)tick;
    in->q[0] = 1.6f - 1.6f * t;
    in->q[1] = -1.8f + 0.8f * t;
    in->u[0] = tick >= FAILS_AT && tick < RECOVERS_AT ? NAN : -1.6f;
    in->u[1] = 0.8f;
    in->E_0 = 0.0f;
}

static void actuators_write(const float tau[2], float sent[2])
{
    sent[0] = tau[0];
    sent[1] = tau[1];
}

int main(void)
{
    static double_pendulum_energy_f32_model model;
    float tau[2] = {0.0f, 0.0f}; /* the last good command; a refusal leaves it as it is */
    float sent[2] = {0.0f, 0.0f}, held[2] = {0.0f, 0.0f};
    uint32_t done = 0, faults = 0, late = 0, moved = 0;
    hal_init();
    if (double_pendulum_energy_f32_prepare(&double_pendulum_energy_f32_params_default, &model) < 0) {
        hal_exit(1);
    }
    timer_start();
    while (done < TICKS) {
        double_pendulum_energy_f32_input in;
        double_pendulum_energy_f32_info info;
        while (ticks == done) {
            __asm volatile("wfi");
        }
        sensors_read(done, &in);
        if (double_pendulum_energy_f32_control(&model, &in, tau, &info) < 0) {
            ++faults; /* tau is untouched: hold it, and give up after too long */
            moved += faults > 1 && (tau[0] != held[0] || tau[1] != held[1]);
            if (faults > MOST_FAULTS) {
                break;
            }
        }
        held[0] = tau[0];
        held[1] = tau[1];
        actuators_write(tau, sent);
        ++done;
        late += ticks > done; /* the work took longer than a tick */
    }
    SYST_CSR = 0;
    print_count("ticks=", done);
    print_count(" faults=", faults);
    print_count(" moved=", moved);
    print_count(" late=", late);
    print_number(" pushed=", sent[0] != 0.0f);
    print_text("\n");
    print_flush();
    hal_exit(done == TICKS && faults == RECOVERS_AT - FAILS_AT && moved == 0 && late == 0 ? 0 : 1);
    return 1;
}
