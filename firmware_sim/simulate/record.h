/* A sink that keeps rows in memory of the caller. */
#ifndef SERVOGEN_SIMULATE_RECORD_H
#define SERVOGEN_SIMULATE_RECORD_H

#include <stddef.h>

#include "loop.h"

typedef struct {
    int q, u, tau, constraint; /* sizes of a row's vectors */
    uint32_t capacity, used;   /* rows */
    real *values;              /* [capacity * (q + u + tau + constraint + 2)]: t, q, u, tau, constraint, sigma_min */
    int32_t *marks;            /* [capacity * 3]: status, rank, limited */
} sim_record;

/* A sim_sink; `user` is a sim_record. Rows beyond the capacity are dropped. */
void sim_keep(void *user, const sim_row *row);

#endif
