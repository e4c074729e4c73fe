#include "machine.h"

#define GOLDEN UINT64_C(0x9E3779B97F4A7C15) /* 2^64 over the golden ratio */

static uint64_t mixed(uint64_t z)
{
    z = (z ^ (z >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94D049BB133111EB);
    return z ^ (z >> 31);
}

real sim_normal(uint32_t seed, uint64_t n)
{
    const uint64_t key = mixed((uint64_t)seed + GOLDEN);
    int32_t sum = -393210; /* twelve times the mean 32767.5 */
    uint64_t word;
    int j, k;
    for (j = 0; j < 3; ++j) {
        word = mixed(key + (3u * n + (uint64_t)j + 1u) * GOLDEN);
        for (k = 0; k < 4; ++k) {
            sum += (int32_t)(word & 0xFFFFu);
            word >>= 16;
        }
    }
    return (real)sum / (real)65536; /* the variance of the sum is 65536^2 - 1 */
}

/* The nearest multiple of the step, ties away from zero; what has more than 2^30 steps is left as it is. */
static real quantised(real value, real quantum)
{
    const real steps = value / quantum;
    if (!(steps > (real)-1073741824) || !(steps < (real)1073741824)) {
        return value;
    }
    return (real)(int32_t)(steps < (real)0 ? steps - (real)0.5 : steps + (real)0.5) * quantum;
}

void sim_measure(const sim_sensors *sensors, uint32_t tick, const real *exact, real *reading)
{
    int k;
    for (k = 0; k < sensors->n; ++k) {
        reading[k] = exact[k];
        if (sensors->noise[k] > (real)0) {
            reading[k] += sensors->noise[k] * sim_normal(sensors->seed, (uint64_t)tick * (uint64_t)sensors->n + (uint64_t)k);
        }
        if (sensors->quantum[k] > (real)0) {
            reading[k] = quantised(reading[k], sensors->quantum[k]);
        }
    }
}

/* `value` within +-bound; *held_back tells whether it was not. */
static real within(real value, real bound, int *held_back)
{
    if (value > bound) {
        *held_back = 1;
        return bound;
    }
    if (value < -bound) {
        *held_back = 1;
        return -bound;
    }
    return value;
}

void sim_settle(const sim_actuators *actuators, const real *command, sim_actuator *state)
{
    int k, ignored = 0;
    for (k = 0; k < actuators->n; ++k) {
        state[k].slewed = actuators->limit[k] < (real)0 ? command[k] : within(command[k], actuators->limit[k], &ignored);
        state[k].output = state[k].now = state[k].held = state[k].slewed;
    }
}

uint32_t sim_drive(const sim_actuators *actuators, const real *command, sim_actuator *state)
{
    uint32_t mask = 0;
    int k;
    for (k = 0; k < actuators->n; ++k) {
        real wanted = command[k];
        int held_back = 0;
        if (!(actuators->limit[k] < (real)0)) {
            wanted = within(wanted, actuators->limit[k], &held_back);
        }
        if (!(actuators->slew[k] < (real)0)) {
            int slewing = 0;
            const real change = within(wanted - state[k].slewed, actuators->slew[k], &slewing);
            if (slewing) {
                wanted = state[k].slewed + change;
                held_back = 1;
            }
        }
        state[k].slewed = wanted;
        if (actuators->keep[k] < (real)0) {
            state[k].now = state[k].held = state[k].output = wanted;
        } else {
            const real gap = state[k].output - wanted;
            state[k].now = state[k].output;
            state[k].held = wanted + gap * actuators->mean[k];
            state[k].output = wanted + gap * actuators->keep[k];
        }
        mask |= (uint32_t)held_back << k;
    }
    return mask;
}
