/* The singular value decomposition inside one package, S = U diag(sigma) V^T, from the functions it is made of: the package
   is included below, so that its static functions are in reach. Built by core.py with -DREAL= -DROWS= -DCOLUMNS=. */
#include "pinv.c"

enum { SMALLER = ROWS < COLUMNS ? ROWS : COLUMNS };

/* U [n * SMALLER * ROWS] and V [n * SMALLER * COLUMNS], one vector after the other, sigma [n * SMALLER]; those of sigma that
   the solver would keep, the rest zero; rank [n]. */
void decompose(long n, const REAL *S, REAL *U, REAL *sigma, REAL *V, int *rank);
void decompose(long n, const REAL *S, REAL *U, REAL *sigma, REAL *V, int *rank)
{
    long at;
    for (at = 0; at < n; ++at) {
        pinv_factors f;
        REAL u[SMALLER * STRIDE];
        const int top = pinv_exponent(pinv_largest(S, ROWS * COLUMNS));
        int i, j, k;
        for (i = 0; i < ROWS; ++i) {
            f.exponent[i] = top;
        }
        pinv_scale(S, f.exponent, f.B);
        pinv_qr_factor(f.B, &f.qr);
        f.sweeps = 0;
        f.rank = 0;
        if (pinv_values(&f, u)) {
            for (k = 0; k < SMALLER; ++k) {
                f.rank += f.sigma[k] > (REAL)RTOL * f.sigma[0];
            }
            pinv_vectors(&f, u);
        }
        for (k = 0; k < f.rank; ++k) {
            sigma[k] = pinv_shift(f.sigma[k], top);
            for (i = 0; i < ROWS; ++i) {
                U[ROWS * k + i] = f.left[M_WIDTH * k + ROW_AT(i)];
            }
            for (j = 0; j < COLUMNS; ++j) {
                V[COLUMNS * k + j] = f.right[L_WIDTH * k + COLUMN_AT(j)];
            }
        }
        *rank++ = f.rank;
        S += ROWS * COLUMNS;
        U += SMALLER * ROWS;
        V += SMALLER * COLUMNS;
        sigma += SMALLER;
    }
}
