// Rivals of the generated solver, tau = S+ z for system i, with S (row-major), z and tau of every system in a row.
// Before it: ROWS, COLUMNS, SINGLE (float32) or not; -DHAVE_EIGEN, -DHAVE_LAPACK for what there is on this machine.
#pragma once
#include <algorithm>
#include <cstring>
#include <limits>
#include <vector>
#ifdef HAVE_EIGEN
#include <Eigen/Dense>
#endif
#ifdef HAVE_LAPACK
#include <lapacke.h>
extern "C" void openblas_set_num_threads(int);
#endif

#ifdef SINGLE
#define LAPACK_(name) LAPACKE_s##name##_work
using Real = float;
#else
#define LAPACK_(name) LAPACKE_d##name##_work
using Real = double;
#endif

constexpr int K = ROWS < COLUMNS ? ROWS : COLUMNS;
constexpr int LONG = ROWS < COLUMNS ? COLUMNS : ROWS;

static std::vector<Real> S, z, tau;

struct Contender { const char *name; void (*run)(int); };

#ifdef HAVE_EIGEN
using Matrix = Eigen::Matrix<Real, ROWS, COLUMNS, Eigen::RowMajor>;
using Vector = Eigen::Matrix<Real, ROWS, 1>;
using Answer = Eigen::Matrix<Real, COLUMNS, 1>;

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
static void bare(int i)  // S^T (S S^T)^-1 z by Cholesky, nothing checked
{
    const Eigen::Map<const Matrix> A(&S[i * ROWS * COLUMNS]);
    const Eigen::Map<const Vector> b(&z[i * ROWS]);
    const Eigen::Matrix<Real, ROWS, ROWS> G = A * A.transpose();
    Eigen::Map<Answer> answer(&tau[i * COLUMNS]);
    answer = A.transpose() * G.llt().solve(b);
}
#endif

#ifdef HAVE_LAPACK
static void gelsd(int i)
{
    Real a[ROWS * COLUMNS], b[LONG] = {}, s[K], work[8192];
    lapack_int iwork[1024], rank;
    for (int r = 0; r < ROWS; ++r)
        for (int c = 0; c < COLUMNS; ++c) a[c * ROWS + r] = S[i * ROWS * COLUMNS + r * COLUMNS + c];
    std::memcpy(b, &z[i * ROWS], ROWS * sizeof(Real));
    LAPACK_(gelsd)(LAPACK_COL_MAJOR, ROWS, COLUMNS, 1, a, ROWS, b, LONG, s, Real(-1), &rank, work, 8192, iwork);
    std::memcpy(&tau[i * COLUMNS], b, COLUMNS * sizeof(Real));
}
static void gelsy(int i)
{
    Real a[ROWS * COLUMNS], b[LONG] = {}, work[8192];
    lapack_int jpvt[COLUMNS] = {}, rank;
    for (int r = 0; r < ROWS; ++r)
        for (int c = 0; c < COLUMNS; ++c) a[c * ROWS + r] = S[i * ROWS * COLUMNS + r * COLUMNS + c];
    std::memcpy(b, &z[i * ROWS], ROWS * sizeof(Real));
    const Real rcond = std::numeric_limits<Real>::epsilon();
    LAPACK_(gelsy)(LAPACK_COL_MAJOR, ROWS, COLUMNS, 1, a, ROWS, b, LONG, jpvt, rcond, &rank, work, 8192);
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
        if (s[k] <= LONG * std::numeric_limits<Real>::epsilon() * s[0]) break;
        Real along = 0;
        for (int r = 0; r < ROWS; ++r) along += v[k * K + r] * z[i * ROWS + r];
        along /= s[k] * scale;
        for (int c = 0; c < COLUMNS; ++c) t[c] += a[k * COLUMNS + c] * along;
    }
    std::memcpy(&tau[i * COLUMNS], t, sizeof t);
}
#endif
