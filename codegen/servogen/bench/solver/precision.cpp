// Run time against error: every contender on the same systems in one process, each system timed on its own.
//   argv: file of systems (all S, then all z, as doubles), their count, rounds. stdout: the contenders' names; file argv[4]:
//   as doubles, for each contender the nanoseconds of every system in every round, then its tau of every system.
// OURS names the header with the generated contenders: their prototypes, and OUR_CONTENDERS.
#include "rivals.hpp"
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include OURS

static const Contender all[] = {
    OUR_CONTENDERS
#ifdef HAVE_EIGEN
    {"Eigen COD", cod}, {"Eigen JacobiSVD", jacobi}, {"Eigen LLT of S S^T, unchecked", bare},
#endif
#ifdef HAVE_LAPACK
    {"LAPACK gelsd", gelsd}, {"LAPACK gelsy", gelsy}, {"LAPACK gesvj", gesvj},
#endif
};

static double once(void (*run)(int), int i, int repeats)
{
    const auto start = std::chrono::steady_clock::now();
    for (int k = 0; k < repeats; ++k) run(i);
    const std::chrono::duration<double, std::nano> spent = std::chrono::steady_clock::now() - start;
    return spent.count() / repeats;
}

int main(int argc, char **argv)
{
    if (argc < 5) return 2;
    const int count = std::atoi(argv[2]), rounds = std::atoi(argv[3]);
    std::FILE *in = std::fopen(argv[1], "rb"), *out = std::fopen(argv[4], "wb");
    if (!in || !out) return 2;
#ifdef HAVE_LAPACK
    openblas_set_num_threads(1);
#endif
    S.resize(std::size_t(count) * ROWS * COLUMNS);
    z.resize(std::size_t(count) * ROWS);
    tau.resize(std::size_t(count) * COLUMNS);
    double x;
    for (Real &s : S) { if (std::fread(&x, 8, 1, in) != 1) return 2; s = Real(x); }
    for (Real &s : z) { if (std::fread(&x, 8, 1, in) != 1) return 2; s = Real(x); }
    std::fclose(in);
    const std::size_t contenders = std::size(all);
    std::vector<std::vector<double>> times(contenders);
    std::vector<int> repeats;
    for (const Contender &c : all) repeats.push_back(std::max(1, int(4000 / std::max(once(c.run, 0, 20), 5.0))));
    for (int round = 0; round < rounds; ++round)
        for (std::size_t c = 0; c < contenders; ++c)
            for (int i = 0; i < count; ++i) {
                all[c].run(i);  // its data and code in the cache, its branches learnt: a controller's next tick
                times[c].push_back(once(all[c].run, i, repeats[c]));
            }
    for (std::size_t c = 0; c < contenders; ++c) {
        std::fwrite(times[c].data(), 8, times[c].size(), out);
        std::fill(tau.begin(), tau.end(), std::numeric_limits<Real>::quiet_NaN());
        for (int i = 0; i < count; ++i) all[c].run(i);
        const std::vector<double> answers(tau.begin(), tau.end());
        std::fwrite(answers.data(), 8, answers.size(), out);
        std::printf("%s\n", all[c].name);
    }
    std::fclose(out);
}
