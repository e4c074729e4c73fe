/* A sink that keeps of a run what a verdict and quantiles need, and no rows. Doubles throughout: hosts only. */
#ifndef SERVOGEN_SIMULATE_SUMMARY_H
#define SERVOGEN_SIMULATE_SUMMARY_H

#include "loop.h"

#define SUM_STATUSES 8  /* positive statuses counted one by one */
#define SUM_CONTROLS 12 /* controls, and rows of constraints, at most */
#define SUM_NEVER (-1)

/* What a run is held to. All memory is the caller's. */
typedef struct {
    int q, u, tau, constraint; /* sizes of a row's vectors */
    const double *low, *high;  /* [q + u]; infinite where nothing is claimed */
    const int *angle;          /* [q + u]: compared at the turn nearest to the middle of the range */
    const double *tolerance;   /* [constraint] */
    int states;                /* of the prescribed decay */
    const double *forward;     /* [states * states]: it, from row to row */
    const int *place;          /* [constraint]: where a row of psi stands among the states */
    int64_t rows;              /* of a run that finishes */
} sum_claim;

typedef struct {
    const sum_claim *claim;
    double *state;                  /* [2 * states]: prescribed, at the start all but psi filled in; and workspace */
    double error[SUM_CONTROLS];     /* largest deviation from the prescribed decay, by row of psi */
    double end[SUM_CONTROLS];       /* |psi| at the last row */
    double tau[SUM_CONTROLS];       /* largest magnitude, by control */
    double share;                   /* largest deviation over its tolerance */
    double third, last;             /* the same in the third and the last quarter of a run that finishes */
    int64_t rows;
    int64_t off, left, inconsistent, limited; /* first rows at which this was so, or SUM_NEVER */
    int64_t rows_limited;
    int64_t statuses[SUM_STATUSES];
} sum_run;

/* A sim_sink; `user` is a sum_run that sum_begin has seen. */
void sum_begin(sum_run *run, const sum_claim *claim, double *state);
void sum_keep(void *user, const sim_row *row);

#endif
