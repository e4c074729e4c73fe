#include <stddef.h>

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

/* The method of order eight and twelve stages of Dormand and Prince, as in DOP853 of Hairer, Norsett and Wanner (1993),
   without its error estimate. */
static const real dop8_a[] = {
    R(0.05260015195876773),
    R(0.0197250569845379), R(0.0591751709536137),
    R(0.02958758547680685), R(0), R(0.08876275643042054),
    R(0.2413651341592667), R(0), R(-0.8845494793282861), R(0.924834003261792),
    R(0.037037037037037035), R(0), R(0), R(0.17082860872947386), R(0.12546768756682242),
    R(0.037109375), R(0), R(0), R(0.17025221101954405), R(0.06021653898045596), R(-0.017578125),
    R(0.03709200011850479), R(0), R(0), R(0.17038392571223998), R(0.10726203044637328), R(-0.015319437748624402),
    R(0.008273789163814023),
    R(0.6241109587160757), R(0), R(0), R(-3.3608926294469414), R(-0.868219346841726), R(27.59209969944671),
    R(20.154067550477894), R(-43.48988418106996),
    R(0.47766253643826434), R(0), R(0), R(-2.4881146199716677), R(-0.590290826836843), R(21.230051448181193),
    R(15.279233632882423), R(-33.28821096898486), R(-0.020331201708508627),
    R(-0.9371424300859873), R(0), R(0), R(5.186372428844064), R(1.0914373489967295), R(-8.149787010746927),
    R(-18.52006565999696), R(22.739487099350505), R(2.4936055526796523), R(-3.0467644718982196),
    R(2.273310147516538), R(0), R(0), R(-10.53449546673725), R(-2.0008720582248625), R(-17.9589318631188),
    R(27.94888452941996), R(-2.8589982771350235), R(-8.87285693353063), R(12.360567175794303), R(0.6433927460157636)
};
static const real dop8_b[] = {
    R(0.054293734116568765), R(0), R(0), R(0), R(0), R(4.450312892752409), R(1.8915178993145003),
    R(-5.801203960010585), R(0.3111643669578199), R(-0.1521609496625161), R(0.20136540080403034),
    R(0.04471061572777259)
};
static const real dop8_c[] = {
    R(0), R(0.05260015195876773), R(0.0789002279381516), R(0.1183503419072274), R(0.2816496580927726),
    R(0.3333333333333333), R(0.25), R(0.3076923076923077), R(0.6512820512820513), R(0.6), R(0.8571428571428571),
    R(1.0)
};

const sim_method sim_methods[SIM_METHODS] = {{4, 4, rk4_a, rk4_b, rk4_c}, {12, 8, dop8_a, dop8_b, dop8_c}};

/* to = x + h (weight[0] k_0 + ... ), the k_s one after the other in `slopes`; to may be x. sum: workspace [n], perhaps
   to where that is not x. */
static void combine(const real *x, real h, const real *weight, int count, const real *slopes, int n, real *sum, real *to)
{
    int i, s;
    for (i = 0; i < n; ++i) {
        sum[i] = R(0);
    }
    for (s = 0; s < count; ++s) {
        const real *slope = slopes + s * n;
        const real factor = weight[s];
        if (factor != R(0)) {
            for (i = 0; i < n; ++i) {
                sum[i] += factor * slope[i];
            }
        }
    }
    for (i = 0; i < n; ++i) {
        to[i] = x[i] + h * sum[i];
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
    if (system->advance != NULL) {
        return system->advance(system->scene, h, loop->x, &loop->stop);
    }
    if (system->rate(system->scene, t, loop->x, slopes, &loop->stop)) {
        return 1;
    }
    for (s = 1; s < method->stages; ++s) {
        combine(loop->x, h, a, s, slopes, n, stage, stage);
        if (system->rate(system->scene, t + method->c[s] * h, stage, slopes + s * n, &loop->stop)) {
            return 1;
        }
        a += s;
    }
    combine(loop->x, h, method->b, method->stages, slopes, n, stage, loop->x);
    return 0;
}

/* The grid point reached: a row where one is due, and the judgement whether it is the last. */
static int arrive(sim_loop *loop, sim_sink sink, void *user)
{
    const sim_system *system = loop->system;
    const real t = R(loop->done) * loop->step;
    const int due = loop->done % loop->row_every == 0;
    sim_row row;
    if (system->sample(system->scene, loop->done, t, loop->x, due ? &row : NULL, &loop->stop)) {
        return 1;
    }
    if (due) {
        loop->stop.t = t;
        sink(user, &row);
        if (system->event(system->scene, &row, &loop->stop)) {
            return 1;
        }
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

int sim_integrate(sim_loop *loop, real t)
{
    const real h = loop->step / R(loop->substeps);
    uint32_t k;
    for (k = 0; k < loop->substeps; ++k) {
        if (k > 0 && loop->system->between != NULL) {
            loop->system->between(loop->system->scene, loop->done, k);
        }
        if (step(loop, t + R(k) * h, h)) {
            return 1;
        }
    }
    return 0;
}

int sim_advance(sim_loop *loop, uint32_t count, sim_sink sink, void *user)
{
    while (loop->stop.reason == SIM_RUNNING && count > 0) {
        if (sim_integrate(loop, R(loop->done) * loop->step)) {
            return loop->stop.reason;
        }
        ++loop->done;
        --count;
        (void)arrive(loop, sink, user);
    }
    return loop->stop.reason;
}
