#include "record.h"

static real *put(real *to, const real *from, int n)
{
    sim_copy(from, to, n);
    return to + n;
}

void sim_keep(void *user, const sim_row *row)
{
    sim_record *record = (sim_record *)user;
    const uint32_t width = (uint32_t)(record->q + record->u + record->tau + record->constraint) + 2u;
    real *to;
    int32_t *mark;
    if (record->used == record->capacity) {
        return;
    }
    to = record->values + (size_t)record->used * width;
    mark = record->marks + 3u * (size_t)record->used;
    to = put(to, &row->t, 1);
    to = put(to, row->q, record->q);
    to = put(to, row->u, record->u);
    to = put(to, row->tau, record->tau);
    to = put(to, row->constraint, record->constraint);
    (void)put(to, &row->sigma_min, 1);
    mark[0] = row->status;
    mark[1] = row->rank;
    mark[2] = (int32_t)row->limited;
    ++record->used;
}
