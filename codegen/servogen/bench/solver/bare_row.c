/* tau = y + s^T (z - s y) / (s s^T), as one would write it by hand: nothing checked, nothing scaled. */
#include <stddef.h>

void bare(const REAL *S, const REAL *z, const REAL *y, REAL *tau);
void bare_refined(const REAL *S, const REAL *z, const REAL *y, REAL *tau);

void bare(const REAL *S, const REAL *z, const REAL *y, REAL *tau)
{
    REAL rest = z[0];
    REAL square = 0;
    int j;
#pragma GCC unroll 16
    for (j = 0; j < COLUMNS; ++j) {
        square += S[j] * S[j];
    }
    if (y != NULL) {
#pragma GCC unroll 16
        for (j = 0; j < COLUMNS; ++j) {
            rest -= S[j] * y[j];
        }
    }
    rest /= square;
#pragma GCC unroll 16
    for (j = 0; j < COLUMNS; ++j) {
        tau[j] = y != NULL ? y[j] + S[j] * rest : S[j] * rest;
    }
}

/* The same, and once more where y cancels, as ours. */
void bare_refined(const REAL *S, const REAL *z, const REAL *y, REAL *tau)
{
    REAL square = 0, rest = z[0], left = z[0];
    int j;
#pragma GCC unroll 16
    for (j = 0; j < COLUMNS; ++j) {
        square += S[j] * S[j];
        rest -= S[j] * y[j];
    }
    if (rest * rest <= z[0] * z[0]) {
        rest /= square;
#pragma GCC unroll 16
        for (j = 0; j < COLUMNS; ++j) {
            tau[j] = y[j] + S[j] * rest;
        }
        return;
    }
    square = 1 / square;
    rest *= square;
#pragma GCC unroll 16
    for (j = 0; j < COLUMNS; ++j) {
        tau[j] = y[j] + S[j] * rest;
        left -= S[j] * tau[j];
    }
    left *= square;
#pragma GCC unroll 16
    for (j = 0; j < COLUMNS; ++j) {
        tau[j] += S[j] * left;
    }
}
