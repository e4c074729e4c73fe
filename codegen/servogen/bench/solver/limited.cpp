// Answers within limits: ours beside DAQP and eiquadprog on the same systems, in one process; built by limited.py with
//   -DROWS= -DCOLUMNS= -DOURS_HEADER= -DOURS=<prefix>_solve
// Each rival states the problem in two ways. "met": the distance from y is least and S tau = z an equality, which finds
// nothing where limits keep it from being met. "least squares": |S tau - z|^2 + d |tau - y|^2 with a small d, which always
// answers, a little beside the best.
#include <Eigen/Dense>
#include <eiquadprog/eiquadprog-rt.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>
extern "C" {
#include "api.h"
#include "auxiliary.h"
#include "daqp.h"
#include "utils.h"
#include OURS_HEADER
}

constexpr int m = ROWS, l = COLUMNS;
constexpr double SMALL = 1e-8;

static std::vector<double> S, z, y, lower, upper, tau;
static std::vector<int> status;

static void ours(int i)
{
    status[i] = OURS(&S[i * m * l], &z[i * m], &y[i * l], &lower[i * l], &upper[i * l], &tau[i * l], nullptr) >= 0;
}

struct Daqp {
    DAQPWorkspace work{};
    DAQPProblem problem{};
    double H[l * l] = {}, f[l], A[m * l], high[m + l], low[m + l];
    int sense[m + l] = {};
};
static Daqp met, squares;

static void set_up()
{
    double time;
    for (int j = 0; j < l; ++j) { squares.H[(l + 1) * j] = 1; squares.f[j] = 1; }
    for (Daqp *d : {&met, &squares}) {
        const bool rows = d == &met;
        std::fill(d->high, d->high + m + l, 1.0);
        std::fill(d->low, d->low + m + l, -1.0);
        std::copy(S.begin(), S.begin() + m * l, d->A);
        for (int i = l; i < l + m && rows; ++i) { d->sense[i] = DAQP_ACTIVE | DAQP_IMMUTABLE; d->low[i] = d->high[i] = 0; }
        d->problem = {l, rows ? m + l : l, l, rows ? nullptr : d->H, rows ? nullptr : d->f, rows ? d->A : nullptr, d->high,
            d->low, rows ? d->sense : nullptr, nullptr, 0, 0};
        if (setup_daqp(&d->problem, &d->work, &time) < 0) { std::fprintf(stderr, "DAQP refuses its workspace\n"); std::exit(2); }
    }
}

static void solve(Daqp &d, int i, int changed)
{
    int flag = daqp_update_ldp(changed, &d.work, &d.problem);
    if (flag >= 0 && d.work.sing_ind != DAQP_UNCONSTRAINED_OPTIMAL) {
        flag = daqp_ldp(&d.work);
        if (flag > 0) ldp2qp_solution(&d.work);
    }
    status[i] = flag >= 0;
}

static void daqp_met(int i)  // in tau - y, so that the Hessian is the identity, which DAQP knows
{
    const double *s = &S[i * m * l], *wish = &y[i * l];
    std::copy(s, s + m * l, met.A);
    for (int j = 0; j < l; ++j) { met.low[j] = lower[i * l + j] - wish[j]; met.high[j] = upper[i * l + j] - wish[j]; }
    for (int r = 0; r < m; ++r) {
        double rest = z[i * m + r];
        for (int j = 0; j < l; ++j) rest -= s[r * l + j] * wish[j];
        met.low[l + r] = met.high[l + r] = rest;
    }
    solve(met, i, DAQP_UPDATE_M | DAQP_UPDATE_d | DAQP_UPDATE_sense);
    for (int j = 0; j < l; ++j) tau[i * l + j] = met.work.x[j] + wish[j];
}

static void form(int i, double *H, double *f)
{
    const double *s = &S[i * m * l];
    for (int a = 0; a < l; ++a) {
        f[a] = -SMALL * y[i * l + a];
        for (int r = 0; r < m; ++r) f[a] -= s[r * l + a] * z[i * m + r];
        for (int b = a; b < l; ++b) {
            double sum = a == b ? SMALL : 0;
            for (int r = 0; r < m; ++r) sum += s[r * l + a] * s[r * l + b];
            H[a * l + b] = H[b * l + a] = sum;
        }
    }
}

static void daqp_squares(int i)
{
    form(i, squares.H, squares.f);
    std::copy(&lower[i * l], &lower[i * l] + l, squares.low);
    std::copy(&upper[i * l], &upper[i * l] + l, squares.high);
    reset_daqp_workspace(&squares.work);
    solve(squares, i, DAQP_UPDATE_Rinv | DAQP_UPDATE_M | DAQP_UPDATE_v | DAQP_UPDATE_d | DAQP_UPDATE_sense | DAQP_UPDATE_unconstrained);
    std::copy(squares.work.x, squares.work.x + l, &tau[i * l]);
}

template <int E> static void eiquadprog_(int i)  // E equalities: m, or none and least squares
{
    using namespace eiquadprog::solvers;
    static RtEiquadprog<l, E, 2 * l> qp;
    static typename RtMatrixX<l, l>::d H;
    static typename RtVectorX<l>::d f, x;
    static typename RtMatrixX<E, l>::d equal;
    static typename RtVectorX<E>::d right;
    static typename RtMatrixX<2 * l, l>::d sides;
    static typename RtVectorX<2 * l>::d bounds;
    if (E > 0) {
        H.setIdentity();
        for (int j = 0; j < l; ++j) f(j) = -y[i * l + j];
        for (int r = 0; r < E; ++r) {
            right(r) = -z[i * m + r];
            for (int j = 0; j < l; ++j) equal(r, j) = S[i * m * l + r * l + j];
        }
    } else {
        double h[l * l], g[l];
        form(i, h, g);
        for (int j = 0; j < l; ++j) { f(j) = g[j]; for (int k = 0; k < l; ++k) H(j, k) = h[j * l + k]; }
    }
    sides.setZero();
    for (int j = 0; j < l; ++j) {
        sides(j, j) = 1; bounds(j) = -lower[i * l + j];
        sides(l + j, j) = -1; bounds(l + j) = upper[i * l + j];
    }
    status[i] = qp.solve_quadprog(H, f, equal, right, sides, bounds, x) == RT_EIQUADPROG_OPTIMAL;
    for (int j = 0; j < l; ++j) tau[i * l + j] = x(j);
}

struct Contender { const char *name; void (*run)(int); };
static const Contender all[] = {{"servogen", ours}, {"DAQP, met", daqp_met}, {"DAQP, least squares", daqp_squares},
    {"eiquadprog, met", eiquadprog_<m>}, {"eiquadprog, least squares", eiquadprog_<0>}};

// argv: file of N, then N of S, z, y, lower and upper each, as doubles; rounds; for a count of instructions one contender
int main(int argc, char **argv)
{
    std::FILE *file = argc > 2 ? std::fopen(argv[1], "rb") : nullptr;
    double count;
    if (!file || std::fread(&count, 8, 1, file) != 1) return 2;
    const int N = int(count), rounds = std::atoi(argv[2]);
    for (auto [array, size] : {std::pair{&S, m * l}, {&z, m}, {&y, l}, {&lower, l}, {&upper, l}}) {
        array->resize(N * size);
        if (std::fread(array->data(), 8, N * size, file) != size_t(N * size)) return 2;
    }
    tau.resize(N * l);
    status.resize(N);
    set_up();
    if (argc > 3) {
        for (int i = 0; i < N * rounds; ++i) all[std::atoi(argv[3])].run(i % N);
        return 0;
    }
    std::vector<std::vector<double>> best(std::size(all), std::vector<double>(N, 1e300));
    for (int round = 0; round < rounds; ++round)
        for (size_t c = 0; c < std::size(all); ++c)
            for (int i = 0; i < N; ++i) {
                all[c].run(i);
                const auto start = std::chrono::steady_clock::now();
                for (int k = 0; k < 3; ++k) all[c].run(i);
                const std::chrono::duration<double, std::nano> spent = std::chrono::steady_clock::now() - start;
                best[c][i] = std::min(best[c][i], spent.count() / 3);
            }
    std::printf("[");
    for (size_t c = 0; c < std::size(all); ++c) {
        int answered = 0;
        double own = 0, other = 0, least = 1e300;
        for (int i = 0; i < N; ++i) {
            all[c].run(i);
            if (!status[i]) continue;
            ++answered;
            own += best[0][i];
            other += best[c][i];
            least = std::min(least, best[c][i] / best[0][i]);
        }
        std::printf("%s{\"name\": \"%s\", \"answered\": %d, \"ns\": %.6g, \"ratio\": %.4g, \"least\": %.4g}", c ? ",\n " : "",
            all[c].name, answered, other / answered, other / own, least);
    }
    std::printf("]\n");
}
