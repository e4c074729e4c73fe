// Ours against Eigen and LAPACK on the same systems, in one process: nanoseconds a solve, best of many rounds.
// One build a shape and scalar: -DM= -DL= -DREAL= -DOURS= (prefix of the package) -DFORCED= (prefix of method="svd").
#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <lapacke.h>
#include <vector>
#ifdef CALLGRIND
#include <valgrind/callgrind.h>
#endif

extern "C" {
#include OURS_HEADER
#include FORCED_HEADER
}

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#ifdef SINGLE
#define LAPACK_(name) LAPACKE_s##name##_work
using Real = float;
#else
#define LAPACK_(name) LAPACKE_d##name##_work
using Real = double;
#endif
extern "C" void openblas_set_num_threads(int);

constexpr int K = ROWS < COLUMNS ? ROWS : COLUMNS;
constexpr int N = 64;  // systems: their data stays in the first-level cache
using Matrix = Eigen::Matrix<Real, ROWS, COLUMNS, Eigen::RowMajor>;
using Vector = Eigen::Matrix<Real, ROWS, 1>;
using Answer = Eigen::Matrix<Real, COLUMNS, 1>;

static std::vector<Real> S, z, tau;

static void ours(int i) { JOIN(OURS, _solve)(&S[i * ROWS * COLUMNS], &z[i * ROWS], nullptr, &tau[i * COLUMNS], nullptr); }
static void with_info(int i)
{
    JOIN(OURS, _info) info;
    JOIN(OURS, _solve)(&S[i * ROWS * COLUMNS], &z[i * ROWS], nullptr, &tau[i * COLUMNS], &info);
}
static void forced(int i) { JOIN(FORCED, _solve)(&S[i * ROWS * COLUMNS], &z[i * ROWS], nullptr, &tau[i * COLUMNS], nullptr); }

static void cod(int i)
{
    const Eigen::Map<const Matrix> A(&S[i * ROWS * COLUMNS]);
    const Eigen::Map<const Vector> b(&z[i * ROWS]);
    Eigen::Map<Answer> answer(&tau[i * COLUMNS]);
    answer = Eigen::CompleteOrthogonalDecomposition<Eigen::Matrix<Real, ROWS, COLUMNS>>(A).solve(b);
}
static void jacobi(int i)
{
    // all sizes fixed and a QR preconditioner that takes them: thin factors of a wide matrix need its full V in Eigen 3.4
    const Eigen::Map<const Matrix> A(&S[i * ROWS * COLUMNS]);
    const Eigen::Map<const Vector> b(&z[i * ROWS]);
    Eigen::JacobiSVD<Eigen::Matrix<Real, Eigen::Dynamic, Eigen::Dynamic, 0, ROWS, COLUMNS>> svd(A, Eigen::ComputeThinU | Eigen::ComputeThinV);
    Eigen::Map<Answer> answer(&tau[i * COLUMNS]);
    answer = svd.solve(b);
}
static void gelsd(int i)
{
    Real a[ROWS * COLUMNS], b[COLUMNS > ROWS ? COLUMNS : ROWS] = {}, s[K], work[8192];
    lapack_int iwork[1024], rank;
    for (int r = 0; r < ROWS; ++r)
        for (int c = 0; c < COLUMNS; ++c) a[c * ROWS + r] = S[i * ROWS * COLUMNS + r * COLUMNS + c];
    std::memcpy(b, &z[i * ROWS], ROWS * sizeof(Real));
    LAPACK_(gelsd)(LAPACK_COL_MAJOR, ROWS, COLUMNS, 1, a, ROWS, b, COLUMNS > ROWS ? COLUMNS : ROWS, s, Real(-1), &rank, work, 8192, iwork);
    std::memcpy(&tau[i * COLUMNS], b, COLUMNS * sizeof(Real));
}
static void gelsy(int i)
{
    Real a[ROWS * COLUMNS], b[COLUMNS > ROWS ? COLUMNS : ROWS] = {}, work[8192];
    lapack_int jpvt[COLUMNS] = {}, rank;
    for (int r = 0; r < ROWS; ++r)
        for (int c = 0; c < COLUMNS; ++c) a[c * ROWS + r] = S[i * ROWS * COLUMNS + r * COLUMNS + c];
    std::memcpy(b, &z[i * ROWS], ROWS * sizeof(Real));
    const Real rcond = std::numeric_limits<Real>::epsilon();
    LAPACK_(gelsy)(LAPACK_COL_MAJOR, ROWS, COLUMNS, 1, a, ROWS, b, COLUMNS > ROWS ? COLUMNS : ROWS, jpvt, rcond, &rank, work, 8192);
    std::memcpy(&tau[i * COLUMNS], b, COLUMNS * sizeof(Real));
}
static void gesvj(int i)
{
    // the SVD of S^T, which LAPACK wants tall: S^T = U s V^T, tau = U s^-1 V^T z
    Real a[ROWS * COLUMNS], s[K], v[K * K], work[256];
    std::memcpy(a, &S[i * ROWS * COLUMNS], sizeof a);  // row-major S is column-major S^T
    LAPACK_(gesvj)(LAPACK_COL_MAJOR, 'G', 'U', 'V', COLUMNS, ROWS, a, COLUMNS, s, 0, v, K, work, 256);
    const Real scale = work[0];
    Real t[COLUMNS] = {};
    for (int k = 0; k < K; ++k) {
        if (s[k] <= (ROWS > COLUMNS ? ROWS : COLUMNS) * std::numeric_limits<Real>::epsilon() * s[0]) break;
        Real along = 0;
        for (int r = 0; r < ROWS; ++r) along += v[k * K + r] * z[i * ROWS + r];
        along /= s[k] * scale;
        for (int c = 0; c < COLUMNS; ++c) t[c] += a[k * COLUMNS + c] * along;
    }
    std::memcpy(&tau[i * COLUMNS], t, sizeof t);
}
static void bare(int i)  // S^T (S S^T)^-1 z by Cholesky, nothing checked
{
    const Eigen::Map<const Matrix> A(&S[i * ROWS * COLUMNS]);
    const Eigen::Map<const Vector> b(&z[i * ROWS]);
    const Eigen::Matrix<Real, ROWS, ROWS> G = A * A.transpose();
    Eigen::Map<Answer> answer(&tau[i * COLUMNS]);
    answer = A.transpose() * G.llt().solve(b);
}

struct Contender { const char *name; void (*run)(int); };
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
