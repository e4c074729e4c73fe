// Ours against Eigen and LAPACK on the same systems, in one process: nanoseconds a solve, best of many rounds.
// One build a shape and scalar: -DROWS= -DCOLUMNS= [-DSINGLE] -DOURS= (prefix of the package) -DFORCED= (that of
// method="svd") -DOURS_HEADER= -DFORCED_HEADER= [-DCALLGRIND].
#define HAVE_EIGEN
#define HAVE_LAPACK
#include "rivals.hpp"
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#ifdef CALLGRIND
#include <valgrind/callgrind.h>
#endif

extern "C" {
#include OURS_HEADER
#include FORCED_HEADER
}

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)

constexpr int N = 64;  // systems: their data stays in the first-level cache

static void ours(int i) { JOIN(OURS, _solve)(&S[i * ROWS * COLUMNS], &z[i * ROWS], nullptr, &tau[i * COLUMNS], nullptr); }
static void with_info(int i)
{
    JOIN(OURS, _info) info;
    JOIN(OURS, _solve)(&S[i * ROWS * COLUMNS], &z[i * ROWS], nullptr, &tau[i * COLUMNS], &info);
}
static void forced(int i) { JOIN(FORCED, _solve)(&S[i * ROWS * COLUMNS], &z[i * ROWS], nullptr, &tau[i * COLUMNS], nullptr); }

static const Contender all[] = {{"auto", ours}, {"auto with info", with_info}, {"forced svd", forced}, {"COD", cod},
    {"JacobiSVD", jacobi}, {"gelsd", gelsd}, {"gelsy", gelsy}, {"gesvj", gesvj}, {"uncertified Cholesky", bare}};

static double once(void (*run)(int), int repeats)
{
    const auto start = std::chrono::steady_clock::now();
    for (int k = 0; k < repeats; ++k)
        for (int i = 0; i < N; ++i) run(i);
    const std::chrono::duration<double, std::nano> spent = std::chrono::steady_clock::now() - start;
    return spent.count() / (double(repeats) * N);
}

// argv: file of systems (N of S then z, as doubles), rounds, then for callgrind the index of one contender
int main(int argc, char **argv)
{
    openblas_set_num_threads(1);
    S.resize(N * ROWS * COLUMNS); z.resize(N * ROWS); tau.resize(N * COLUMNS);
    std::FILE *file = argc > 1 ? std::fopen(argv[1], "rb") : nullptr;
    if (!file) return 2;
    double x;
    for (Real &s : S) { if (std::fread(&x, 8, 1, file) != 1) return 2; s = Real(x); }
    for (Real &s : z) { if (std::fread(&x, 8, 1, file) != 1) return 2; s = Real(x); }
    std::fclose(file);
    const int rounds = argc > 2 ? std::atoi(argv[2]) : 40;
#ifdef CALLGRIND
    const Contender &c = all[std::atoi(argv[3])];
    c.run(0);
    CALLGRIND_START_INSTRUMENTATION;
    for (int i = 0; i < N; ++i) c.run(i);
    CALLGRIND_STOP_INSTRUMENTATION;
    return 0;
#endif
    std::vector<std::vector<double>> times(std::size(all));
    std::vector<int> repeats;
    for (const Contender &c : all) repeats.push_back(std::max(1, int(2e5 / (N * std::max(once(c.run, 1), 5.0)))));
    for (int round = 0; round < rounds; ++round)
        for (std::size_t c = 0; c < std::size(all); ++c) times[c].push_back(once(all[c].run, repeats[c]));
    std::printf("{");
    for (std::size_t c = 0; c < std::size(all); ++c) {
        std::sort(times[c].begin(), times[c].end());
        const std::vector<double> &t = times[c];
        for (int i = 0; i < N; ++i) all[c].run(i);
        std::printf("%s\"%s\": {\"best\": %.4g, \"median\": %.4g, \"p999\": %.4g, \"worst\": %.4g, \"tau\": [", c ? ",\n " : "",
            all[c].name, t[0], t[t.size() / 2], t[std::size_t(0.999 * double(t.size() - 1) + 0.5)], t.back());
        for (int i = 0; i < N * COLUMNS; ++i) {
            if (std::isfinite(tau[i])) std::printf("%s%.17g", i ? "," : "", double(tau[i]));
            else std::printf("%snull", i ? "," : "");
        }
        std::printf("]}");
    }
    std::printf("}\n");
}
