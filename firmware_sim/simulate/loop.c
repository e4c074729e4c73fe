#include "loop.h"

#define R(number) ((real)(number))

/* The classical method of order four. */
static const real rk4_a[] = {
    R(0.5),
    R(0), R(0.5),
    R(0), R(0), R(1)
};
static const real rk4_b[] = {R(1) / R(6), R(1) / R(3), R(1) / R(3), R(1) / R(6)};
static const real rk4_c[] = {R(0), R(0.5), R(0.5), R(1)};

const sim_method sim_methods[SIM_METHODS] = {{4, 4, rk4_a, rk4_b, rk4_c}};

void sim_copy(const real *from, real *to, int n)
{
    int k;
    for (k = 0; k < n; ++k) {
        to[k] = from[k];
    }
}

/* to = x + h (weight[0] k_0 + ... ), the k_s one after the other in `slopes`; to may be x. */
static void combine(const real *x, real h, const real *weight, int count, const real *slopes, int n, real *to)
{
    int i, s;
    for (i = 0; i < n; ++i) {
        real sum = R(0);
        for (s = 0; s < count; ++s) {
            sum += weight[s] * slopes[s * n + i];
        }
        to[i] = x[i] + h * sum;
    }
}

/* One step of the method from t; x changes only if every stage succeeded. */
static int step(sim_loop *loop, real t, real h)
{
    const sim_system *system = loop->system;
    const sim_method *method = loop->method;
    const int n = system->states;
    real *slopes = loop->work;
    real *stage = loop->work + method->stages * n;
    const real *a = method->a;
    int s;
    for (s = 0; s < method->stages; ++s) {
        combine(loop->x, h, a, s, slopes, n, stage);
        if (system->rate(system->scene, t + method->c[s] * h, stage, slopes + s * n, &loop->stop)) {
            return 1;
        }
        a += s;
    }
    combine(loop->x, h, method->b, method->stages, slopes, n, loop->x);
    return 0;
}

/* The grid point reached: a row, and the judgement whether it is the last. */
static int arrive(sim_loop *loop, sim_sink sink, void *user)
{
    const sim_system *system = loop->system;
    const real t = R(loop->done) * loop->step;
    sim_row row;
    if (system->sample(system->scene, loop->done, t, loop->x, &row, &loop->stop)) {
        return 1;
    }
    loop->stop.t = t;
    sink(user, &row);
    if (system->event(system->scene, &row, &loop->stop)) {
        return 1;
    }
    if (loop->done == loop->steps) {
        loop->stop.reason = SIM_FINISHED;
    }
    return loop->stop.reason;
}

int sim_begin(sim_loop *loop, sim_sink sink, void *user)
{
    loop->done = 0;
    loop->stop.reason = SIM_RUNNING;
    loop->stop.detail = 0;
    loop->stop.t = R(0);
    (void)arrive(loop, sink, user);
    return loop->stop.reason;
}

int sim_advance(sim_loop *loop, uint32_t count, sim_sink sink, void *user)
{
    const real h = loop->step / R(loop->substeps);
    while (loop->stop.reason == SIM_RUNNING && count > 0) {
        const real t = R(loop->done) * loop->step;
        uint32_t k;
        for (k = 0; k < loop->substeps; ++k) {
            if (step(loop, t + R(k) * h, h)) {
                return loop->stop.reason;
            }
        }
        ++loop->done;
        --count;
        (void)arrive(loop, sink, user);
    }
    return loop->stop.reason;
}
