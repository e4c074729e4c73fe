/* Whether a certificate was ever given in vain: counts systems that NORMAL or QR accept, and among them those whose
   smallest singular value is, exactly, not above what the certificate promises. One package, included below so that its
   static functions are in reach. Built by false_certificates.py with

     -DSOURCE="pinv.c" -DROWS= -DCOLUMNS= -DREAL= -DRTOL= -DNORMAL_LIMIT= -DNORMAL_ROUNDING= -DEPSILON=

   Promised by NORMAL, with G = S S^T: G - (1/limit - rounding) diag(G) is positive definite (rows of length 1).
   Promised by QR, with rows scaled by powers of two to B: B B^T - (rtol |B|_F)^2 I is. Decided by the signs of the pivots
   of LDL^T in 113 bits; products of two doubles are exact in them, and (rtol |B|_F)^2 is some 10^3 times its rounding. */
#include SOURCE

#include <stdio.h>
#include <stdlib.h>

typedef __float128 wide;

static uint64_t state;

static double uniform(void) /* splitmix64, in (0, 1) */
{
    uint64_t x = (state += UINT64_C(0x9e3779b97f4a7c15));
    x = (x ^ (x >> 30)) * UINT64_C(0xbf58476d1ce4e5b9);
    x = (x ^ (x >> 27)) * UINT64_C(0x94d049bb133111eb);
    return ((double)((x ^ (x >> 31)) >> 11) + 0.5) * 0x1p-53;
}

static double symmetric(void) /* bell-shaped enough */
{
    return uniform() + uniform() + uniform() - uniform() - uniform() - uniform();
}

/* kappa log-uniform up to 10 / eps: X diag(sigma) Y, rows that differ from one another by 1/kappa, or a Kahan triangle */
static void draw(uint64_t index, REAL *S)
{
    double X[ROWS * ROWS], sigma[ROWS];
    const double largest = log(10 / EPSILON);
    const double kappa = exp(largest * uniform());
    int i, j, k;
    if (index % 4 == 3) {
        const double c = 1 / kappa > 0.9 ? 0.9 : pow(kappa, -1.0 / (ROWS > 1 ? ROWS : 1));
        const double s = sqrt(1 - c * c);
        for (i = 0; i < ROWS; ++i) {
            for (j = 0; j < COLUMNS; ++j) {
                S[COLUMNS * i + j] = (REAL)(j > i ? 0.0 : pow(c, ROWS - 1 - i) * (j == i ? 1.0 : -s) * (1 + 1e-3 * symmetric()));
            }
        }
        return;
    }
    for (k = 0; k < ROWS; ++k) {
        sigma[k] = index % 4 == 0 ? pow(kappa, -uniform()) : index % 4 == 1 ? pow(kappa, -(double)k / (ROWS - 1)) : k ? 1 / kappa : 1.0;
    }
    for (i = 0; i < ROWS * ROWS; ++i) {
        X[i] = symmetric();
    }
    for (i = 0; i < ROWS * COLUMNS; ++i) {
        S[i] = 0;
    }
    for (k = 0; k < ROWS; ++k) {
        for (j = 0; j < COLUMNS; ++j) {
            const double y = sigma[k] * symmetric();
            for (i = 0; i < ROWS; ++i) {
                S[COLUMNS * i + j] = (REAL)((double)S[COLUMNS * i + j] + X[ROWS * i + k] * y);
            }
        }
    }
}

/* Whether A A^T - bound (I, or diag(A A^T)) is positive definite. */
static int proven(const REAL *A, wide bound, int own)
{
    wide G[ROWS * ROWS];
    int i, j, k;
    for (i = 0; i < ROWS; ++i) {
        for (j = 0; j <= i; ++j) {
            wide sum = 0;
            for (k = 0; k < COLUMNS; ++k) {
                sum += (wide)A[COLUMNS * i + k] * (wide)A[COLUMNS * j + k];
            }
            G[ROWS * i + j] = sum;
        }
    }
    for (i = 0; i < ROWS; ++i) {
        G[ROWS * i + i] -= own ? bound * G[ROWS * i + i] : bound;
    }
    for (k = 0; k < ROWS; ++k) {
        if (!(G[ROWS * k + k] > 0)) {
            return 0;
        }
        for (i = k + 1; i < ROWS; ++i) {
            const wide factor = G[ROWS * i + k] / G[ROWS * k + k];
            for (j = k + 1; j <= i; ++j) {
                G[ROWS * i + j] -= factor * G[ROWS * j + k];
            }
        }
    }
    return 1;
}

/* Rows in units of their own, which is what sigma_min of the raw S depends on. Adds to counts[0] if info tells a lower bound of
   it, to [1] if that is above sigma_min, and to [2] if it is below a tenth. */
static void judge_bound(const REAL *S, uint64_t *counts)
{
    REAL graded[ROWS * COLUMNS], z[ROWS], tau[COLUMNS];
    pinv_info info;
    int i, j;
    for (i = 0; i < ROWS; ++i) {
        const int unit = (int)(40 * uniform()) - 20;
        z[i] = 1;
        for (j = 0; j < COLUMNS; ++j) {
            graded[COLUMNS * i + j] = (REAL)ldexp((double)S[COLUMNS * i + j], unit);
        }
    }
    (void)pinv_solve(graded, z, NULL, tau, &info);
    if (info.path == PINV_PATH_NORMAL || info.path == PINV_PATH_QR) {
        const wide square = (wide)info.sigma_min * (wide)info.sigma_min;
        ++counts[0];
        counts[1] += !proven(graded, square, 0);
        counts[2] += proven(graded, 100 * square, 0);
    }
}

int main(int argc, char **argv)
{
    const uint64_t systems = strtoull(argc > 1 ? argv[1] : "1000", NULL, 10);
    uint64_t bounds[3] = {0, 0, 0};
    uint64_t index, normal = 0, qr = 0, quick = 0, false_normal = 0, false_qr = 0, false_quick = 0;
    state = strtoull(argc > 2 ? argv[2] : "1", NULL, 10);
    for (index = 0; index < systems; ++index) {
        REAL S[ROWS * COLUMNS], scaled[ROWS * COLUMNS];
        double total = 0;
        pinv_factors f;
        int i, j;
        draw(index, S);
        judge_bound(S, bounds);
        if (pinv_factorise(S, &f, PINV_PATH_NORMAL) < 0) {
            return 3;
        }
        if (f.path == PINV_PATH_NORMAL) {
            ++normal;
            false_normal += !proven(S, 1 / (wide)NORMAL_LIMIT - (wide)NORMAL_ROUNDING, 1);
        }
        /* QR's own certificate, whether it was asked for or not */
        for (i = 0; i < ROWS; ++i) {
            for (j = 0; j < COLUMNS; ++j) {
                scaled[COLUMNS * i + j] = pinv_shift(S[COLUMNS * i + j], -f.exponent[i]);
                total += (double)scaled[COLUMNS * i + j] * (double)scaled[COLUMNS * i + j];
            }
        }
        pinv_qr_factor(f.B, &f.qr);
        if (pinv_qr_certified(&f.qr)) {
            ++qr;
            false_qr += !proven(scaled, (wide)RTOL * (wide)RTOL * (wide)total, 0);
        }
        /* that of solve, whose rows have a length of 1 to 2 */
        if (pinv_qr_scaled(f.B, &f.qr)) {
            total = 0;
            for (i = 0; i < ROWS; ++i) {
                for (j = 0; j < COLUMNS; ++j) {
                    scaled[COLUMNS * i + j] *= f.qr.line[i].unit;
                    total += (double)scaled[COLUMNS * i + j] * (double)scaled[COLUMNS * i + j];
                }
            }
            ++quick;
            false_quick += !proven(scaled, (wide)RTOL * (wide)RTOL * (wide)total, 0);
        }
    }
    printf("%llu %llu %llu %llu %llu %llu %llu ", (unsigned long long)systems, (unsigned long long)normal,
        (unsigned long long)false_normal, (unsigned long long)qr, (unsigned long long)false_qr, (unsigned long long)quick,
        (unsigned long long)false_quick);
    printf("%llu %llu %llu\n", (unsigned long long)bounds[0], (unsigned long long)bounds[1], (unsigned long long)bounds[2]);
    return 0;
}
