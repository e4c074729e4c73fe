/*
 * The closed loop of one scene, advanced by fixed steps of an explicit Runge-Kutta method.
 *
 * Portable C99 without heap or files: rows go to a callback, so that the same loop runs on a host and on a board.
 * What depends on the scene (which functions make up the right-hand side) stands behind sim_system, which servogen
 * generates as <prefix>_loop.c. All memory is the caller's.
 */
#ifndef SERVOGEN_SIMULATE_LOOP_H
#define SERVOGEN_SIMULATE_LOOP_H

#include <stdint.h>

#include "scalar.h"

#define SIM_MAX_STAGES 12 /* of the methods in sim_methods; the workspace is made for so many */
#define SIM_WORK(states) ((SIM_MAX_STAGES + 1) * (states)) /* reals of workspace for a system of so many states */

/* Why a run ended. */
enum {
    SIM_RUNNING = 0,
    SIM_FINISHED = 1,        /* all steps done */
    SIM_EVENT = 2,           /* detail: which stop expression became <= 0 */
    SIM_CONTROLLER = 3,      /* detail: the controller's negative status */
    SIM_PLANT = 4,           /* detail: the plant's negative status */
    SIM_STOP_EXPRESSION = 5, /* detail: the negative status of a stop expression that is no number */
    SIM_REFERENCE = 6        /* detail: the same of a reference that moves */
};

typedef struct {
    int reason; /* SIM_... */
    int detail;
    real t;     /* of the last row handed out, seconds */
} sim_stop;

/* What is known at one instant. The pointers hold until the callback returns. */
typedef struct {
    real t;
    const real *q, *u;
    const real *tau;        /* applied at t */
    const real *constraint; /* psi or phi */
    int status, rank;       /* of the controller; the worst status since the row before, the rank at the last tick */
    real sigma_min;         /* at the last tick */
    uint32_t limited;       /* bit mask of the controls that an actuator held back since the row before */
} sim_row;

typedef void (*sim_sink)(void *user, const sim_row *row);

/* An explicit Runge-Kutta method: a row by row below the diagonal [stages*(stages-1)/2], weights b and nodes c [stages]. */
typedef struct {
    int stages;
    int order;
    const real *a, *b, *c;
} sim_method;

enum { SIM_RK4 = 0, SIM_DOP8 = 1, SIM_METHODS = 2 };
extern const sim_method sim_methods[SIM_METHODS];

/* Physics from elsewhere, a simulator that nobody here wrote: q and u, the n reals at x, after h seconds under the
   controls tau, which are held. Nonzero where it broke down. */
typedef int (*sim_physics)(void *world, real h, const real *tau, real *x);

/* One scene's closed loop. Each function returns 0, or nonzero with reason and detail of *stop set. */
typedef struct {
    void *scene; /* handed to the functions */
    int states;
    /* x' [states] at (t, x); the controller is called inside, or its tau is held. The first call behind `sample` is at
       the t and x of that */
    int (*rate)(void *scene, real t, const real *x, real *x_dot, sim_stop *stop);
    /* at the k-th grid point, where a sampling controller may have its tick; row: to be filled in, NULL if none is due */
    int (*sample)(void *scene, uint32_t k, real t, const real *x, sim_row *row, sim_stop *stop);
    /* before the substep-th of the substeps that follow the k-th grid point, but for the first; NULL if nothing is due */
    void (*between)(void *scene, uint32_t k, uint32_t substep);
    /* x after a substep of h in place of the method; NULL where the method integrates */
    int (*advance)(void *scene, real h, real *x, sim_stop *stop);
    /* SIM_EVENT where a stop expression is <= 0 */
    int (*event)(void *scene, const sim_row *row, sim_stop *stop);
} sim_system;

typedef struct {
    const sim_system *system;
    const sim_method *method;
    real *x;           /* the state now [system->states] */
    real *work;        /* [SIM_WORK(system->states)] */
    real step;          /* between grid points, seconds */
    uint32_t substeps;  /* of the method within a step, at least 1 */
    uint32_t steps;     /* of the whole run */
    uint32_t row_every; /* steps from row to row, at least 1 */
    uint32_t done;      /* steps so far */
    sim_stop stop;
} sim_loop;

/* Hands out the row of the start; loop->x and all settings are filled in. Returns loop->stop.reason. */
int sim_begin(sim_loop *loop, sim_sink sink, void *user);

/* At most `count` further steps; stops for good with a reason. Returns loop->stop.reason. */
int sim_advance(sim_loop *loop, uint32_t count, sim_sink sink, void *user);

/* loop->x from t to t + loop->step, without ticks and rows: what an importer that keeps time itself calls. Nonzero
   where a function of the system failed, with loop->stop set. */
int sim_integrate(sim_loop *loop, real t);

static inline void sim_copy(const real *from, real *to, int n)
{
    int k;
    for (k = 0; k < n; ++k) {
        to[k] = from[k];
    }
}

#endif
