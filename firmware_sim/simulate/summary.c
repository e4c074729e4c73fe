#include "summary.h"

#include <stddef.h>

#define PI 3.141592653589793

void sum_begin(sum_run *run, const sum_claim *claim, double *state)
{
    static const sum_run nothing = {0};
    *run = nothing;
    run->claim = claim;
    run->state = state;
    run->off = run->left = run->inconsistent = run->limited = SUM_NEVER;
}

/* An angle at the turn nearest to `middle`. */
static double folded(double angle, double middle)
{
    const double turns = (angle - middle + PI) / (2 * PI);
    double whole;
    if (!(turns > -1e15 && turns < 1e15)) {
        return angle;
    }
    whole = (double)(int64_t)turns;
    if (whole > turns) {
        whole -= 1;
    }
    return angle - 2 * PI * whole;
}

/* Whether an entry of the state is outside its range. */
static int outside(const sum_claim *claim, const real *q, const real *u)
{
    int k;
    for (k = 0; k < claim->q + claim->u; ++k) {
        double value = k < claim->q ? (double)q[k] : (double)u[k - claim->q];
        if (value >= claim->low[k] && value <= claim->high[k]) {
            continue;
        }
        if (claim->angle[k]) {
            value = folded(value, (claim->low[k] + claim->high[k]) / 2);
        }
        if (value < claim->low[k] || value > claim->high[k]) {
            return 1;
        }
    }
    return 0;
}

/* The prescribed decay at the next row. */
static void decay(const sum_claim *claim, double *state)
{
    double *next = state + claim->states;
    int i, j;
    for (i = 0; i < claim->states; ++i) {
        next[i] = 0;
        for (j = 0; j < claim->states; ++j) {
            next[i] += claim->forward[i * claim->states + j] * state[j];
        }
    }
    for (i = 0; i < claim->states; ++i) {
        state[i] = next[i];
    }
}

static double magnitude(double x)
{
    return x < 0 ? -x : x;
}

static void note_error(sum_run *run, const sim_row *row)
{
    const sum_claim *claim = run->claim;
    const int64_t quarter = claim->rows / 4;
    double share = 0;
    int k;
    for (k = 0; k < claim->constraint; ++k) {
        const double psi = (double)row->constraint[k];
        double error;
        if (run->rows == 0) {
            run->state[claim->place[k]] = psi;
        }
        error = magnitude(psi - run->state[claim->place[k]]);
        run->error[k] = error > run->error[k] ? error : run->error[k];
        run->end[k] = magnitude(psi);
        share = error / claim->tolerance[k] > share ? error / claim->tolerance[k] : share;
    }
    run->share = share > run->share ? share : run->share;
    if (share > 1 && run->off == SUM_NEVER) {
        run->off = run->rows;
    }
    if (run->rows >= claim->rows - quarter) {
        run->last = share > run->last ? share : run->last;
    } else if (run->rows >= claim->rows - 2 * quarter) {
        run->third = share > run->third ? share : run->third;
    }
    decay(claim, run->state);
}

void sum_keep(void *user, const sim_row *row)
{
    sum_run *run = (sum_run *)user;
    const sum_claim *claim = run->claim;
    int k;
    note_error(run, row);
    for (k = 0; k < claim->tau; ++k) {
        const double size = magnitude((double)row->tau[k]);
        run->tau[k] = size > run->tau[k] ? size : run->tau[k];
    }
    if (run->left == SUM_NEVER && outside(claim, row->q, row->u)) {
        run->left = run->rows;
    }
    if (row->status == 2 && run->inconsistent == SUM_NEVER) {
        run->inconsistent = run->rows;
    }
    if (row->limited != 0) {
        run->limited = run->limited == SUM_NEVER ? run->rows : run->limited;
        ++run->rows_limited;
    }
    if (row->status >= 0 && row->status < SUM_STATUSES) {
        ++run->statuses[row->status];
    }
    ++run->rows;
}
