/* libFuzzer target: any bits as S, z, y for one generated pseudo-inverse; built by fuzz/__init__.py with

     -DHEADER='"pinv.h"' -DREAL= -DROWS= -DCOLUMNS= -DDAMPED=0|1

   Checked: it returns; nothing outside the outputs is written (AddressSanitizer, buffers of exact size); a status is one of
   the documented; below zero every output is as it was, at and above zero every output is finite; the answer does not
   depend on whether info is asked for or tau is y; what is not finite is refused as NONFINITE; the inputs stay as they were. */
#include HEADER
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { SMALLER = ROWS < COLUMNS ? ROWS : COLUMNS, SIZE = ROWS * COLUMNS };

#define CHECK(what) do { if (!(what)) { abort(); } } while (0)

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static int finite_all(const REAL *x, int n)
{
    int i;
    for (i = 0; i < n; ++i) {
        if (!(x[i] - x[i] == 0)) {
            return 0;
        }
    }
    return 1;
}

static REAL *exact_copy(const void *bytes, size_t n)
{
    REAL *copy = malloc(n * sizeof(REAL));
    CHECK(copy != NULL);
    memcpy(copy, bytes, n * sizeof(REAL));
    return copy;
}

static void check_info(const pinv_info *info, int status)
{
    CHECK(info->status == status);
    CHECK(status >= PINV_OVERFLOW && status <= PINV_REGULARISED);
    CHECK(status != PINV_NOT_CONVERGED && status != PINV_SINGULAR_MASS && (DAMPED || status != PINV_REGULARISED));
    CHECK(info->rank >= 0 && info->rank <= SMALLER);
    if (status < 0) {
        CHECK(info->path == PINV_PATH_NONE && info->rank == 0 && info->sweeps == 0 && info->sigma_min == 0 && info->residual == 0);
    } else {
        CHECK(info->path >= PINV_PATH_CLOSED_FORM && info->path <= PINV_PATH_SVD);
        CHECK(info->sigma_min >= 0 && info->residual >= 0); /* infinite where the true value is beyond the type */
        CHECK(status != PINV_OK || info->rank == ROWS);
        CHECK(status != PINV_RANK_DEFICIENT_CONSISTENT || info->rank < ROWS);
        CHECK(status != PINV_RANK_DEFICIENT_INCONSISTENT || info->rank < ROWS);
    }
}

/* Arbitrary bits are seldom singular, and seldom of one size: by the last byte's bits, a row copied, a row copied but for
   its last bits, small integers (ties, zeros, exact cancellation), entries between 2^-8 and 2^8, z of S's row sums. */
static void shape(uint8_t how, const uint8_t *bytes, REAL *S, REAL *z)
{
    int i, j;
    for (i = 0; i < SIZE; ++i) {
        const int8_t byte = (int8_t)bytes[(size_t)i * sizeof(REAL)];
        if (how & 4) {
            S[i] = (REAL)(byte % 4);
        } else if (how & 8) {
            S[i] = (REAL)byte * (REAL)((1 << (bytes[(size_t)i * sizeof(REAL) + 1] % 16)) / 65536.0);
        }
    }
    if (how & 2) {
        memcpy(S + SIZE - COLUMNS, S, COLUMNS * sizeof(REAL));
        if (how & 16) {
            uint8_t word[sizeof(REAL)];
            memcpy(word, S + SIZE - 1, sizeof word);
            word[0] ^= bytes[0]; /* the lowest bits where bytes are little-endian */
            memcpy(S + SIZE - 1, word, sizeof word);
        }
    }
    if (how & 32) {
        for (i = 0; i < ROWS; ++i) {
            z[i] = 0;
            for (j = 0; j < COLUMNS; ++j) {
                z[i] += S[COLUMNS * i + j];
            }
        }
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    const size_t needed = (SIZE + ROWS + COLUMNS) * sizeof(REAL) + 1;
    uint8_t *padded = calloc(1, needed);
    REAL *S, *z, *y, *tau, *again, *X, S_before[SIZE], z_before[ROWS], before[SIZE];
    pinv_info info;
    int status, finite, i;
    uint8_t how;
    CHECK(padded != NULL);
    if (size > 0) {
        memcpy(padded, data, size < needed ? size : needed);
    }
    how = padded[needed - 1];
    S = exact_copy(padded, SIZE);
    z = exact_copy(padded + SIZE * sizeof(REAL), ROWS);
    y = exact_copy(padded + (SIZE + ROWS) * sizeof(REAL), COLUMNS);
    shape(how, padded, S, z);
    memcpy(S_before, S, sizeof S_before);
    memcpy(z_before, z, sizeof z_before);
    for (i = 0; i < SIZE; ++i) {
        before[i] = (REAL)(i + 1) / 7;
    }
    finite = finite_all(S, SIZE) && finite_all(z, ROWS) && (!(how & 1) || finite_all(y, COLUMNS));

    tau = exact_copy(before, COLUMNS);
    memset(&info, 0x5a, sizeof info);
    status = pinv_solve(S, z, how & 1 ? y : NULL, tau, &info);
    check_info(&info, status);
    CHECK((status == PINV_NONFINITE) == !finite);
    CHECK(status < 0 ? memcmp(tau, before, COLUMNS * sizeof(REAL)) == 0 : finite_all(tau, COLUMNS));

    again = exact_copy(before, COLUMNS);
    CHECK(pinv_solve(S, z, how & 1 ? y : NULL, again, NULL) == status);
    CHECK(memcmp(tau, again, COLUMNS * sizeof(REAL)) == 0);
    if (how & 1) { /* tau may be y */
        memcpy(again, y, COLUMNS * sizeof(REAL));
        CHECK(pinv_solve(S, z, again, again, NULL) == status);
        CHECK(memcmp(status < 0 ? y : tau, again, COLUMNS * sizeof(REAL)) == 0);
    }

    X = exact_copy(before, SIZE);
    memset(&info, 0x5a, sizeof info);
    status = pinv_pinv(S, X, &info);
    check_info(&info, status);
    CHECK((status == PINV_NONFINITE) == !finite_all(S, SIZE));
    CHECK(status < 0 ? memcmp(X, before, SIZE * sizeof(REAL)) == 0 : finite_all(X, SIZE));

    CHECK(memcmp(S, S_before, sizeof S_before) == 0 && memcmp(z, z_before, sizeof z_before) == 0);
    free(padded);
    free(S);
    free(z);
    free(y);
    free(tau);
    free(again);
    free(X);
    return 0;
}
