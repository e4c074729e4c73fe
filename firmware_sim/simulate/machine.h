/*
 * What stands between a sampling controller and the mechanism: sensors, a delay, actuators.
 *
 * Portable C99 without heap or <math.h>: random numbers are made of integers, so that every machine draws the same.
 */
#ifndef SERVOGEN_SIMULATE_MACHINE_H
#define SERVOGEN_SIMULATE_MACHINE_H

#include <stdint.h>

#include "scalar.h"

#define SIM_QUEUE 33 /* commands kept: a delay may last so many ticks less one */

typedef struct {
    int n;               /* entries of q and u */
    const real *noise;   /* [n] standard deviations */
    const real *quantum; /* [n] steps that the readings come in, 0 for none */
    uint32_t seed;
} sim_sensors;

typedef struct {
    int n;             /* controls */
    const real *limit; /* [n] largest magnitude, negative for none */
    const real *slew;  /* [n] largest change in a substep, negative for none */
    const real *keep;  /* [n] lag: the part of a difference that is left after a substep, negative for none */
    const real *mean;  /* [n] and its mean over the substep */
} sim_actuators;

/* What a control's actuator remembers, and what it does in the substep that begins. */
typedef struct {
    real slewed; /* the command after limit and slew rate */
    real output; /* at the end of the substep */
    real now;    /* at its start */
    real held;   /* its mean, which acts on the mechanism throughout */
} sim_actuator;

/* The n-th deviate of a stream, of mean 0 and variance 1: the sum of twelve uniform ones of 16 bits, less its mean.
   Words: splitmix64 (Steele, Lea and Flood (2014)) of a counter. Exact in both scalars. */
real sim_normal(uint32_t seed, uint64_t n);

/* What the sensors read at a tick. */
void sim_measure(const sim_sensors *sensors, uint32_t tick, const real *exact, real *reading);

/* Actuators that have long obeyed `command`. */
void sim_settle(const sim_actuators *actuators, const real *command, sim_actuator *state);

/* One substep under `command`. Returns a bit mask of the controls that a limit or a slew rate holds back. */
uint32_t sim_drive(const sim_actuators *actuators, const real *command, sim_actuator *state);

#endif
