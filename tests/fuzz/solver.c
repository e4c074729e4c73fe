/* libFuzzer target: any bits as S, z, y for one generated pseudo-inverse. Build with
     clang -g -O1 -fsanitize=fuzzer,address,undefined -fno-sanitize-recover=all -ffp-contract=off
       -DM=3 -DL=7 -DREAL=double -DHEADER='"pinv_3x7.h"' -DP=pinv_3x7 -DQ=PINV_3X7 solver.c pinv_3x7.c -lm
   Checked: it returns; nothing outside the outputs is written (AddressSanitizer, buffers of exact size); a status is one of
   the documented; below zero every output is as it was, at and above zero every output is finite; the answer does not
   depend on whether info is asked for; what is not finite is refused as NONFINITE. */
#include HEADER
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define MEMBER(name) JOIN(FUZZ_P, name)
#define STATUS(name) JOIN(FUZZ_Q, name)
#define CHECK(what) do { if (!(what)) { abort(); } } while (0)

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

static void check_info(const MEMBER(_info) *info, int status)
{
    CHECK(info->status == status);
    CHECK(status >= -4 && status <= 3);
    CHECK(status != STATUS(_NOT_CONVERGED) && status != STATUS(_SINGULAR_MASS) && status != STATUS(_REGULARISED));
    CHECK(info->rank >= 0 && info->rank <= (FUZZ_M < FUZZ_L ? FUZZ_M : FUZZ_L));
    if (status < 0) {
        CHECK(info->path == 0 && info->rank == 0 && info->sweeps == 0 && info->sigma_min == 0 && info->residual == 0);
    } else {
        CHECK(info->path >= 1 && info->path <= 4);
        CHECK(info->sigma_min >= 0 && info->residual >= 0); /* infinite where the true value is beyond the type */
        CHECK((status == STATUS(_OK)) == (info->rank == FUZZ_M));
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    const size_t needed = (FUZZ_M * FUZZ_L + FUZZ_M + FUZZ_L) * sizeof(REAL) + 1;
    uint8_t *padded = calloc(1, needed);
    REAL *S, *z, *y, *tau, *again, *X, before[FUZZ_L * FUZZ_M];
    MEMBER(_info) info;
    int status, finite, i, with_y;
    CHECK(padded != NULL);
    memcpy(padded, data, size < needed ? size : needed);
    with_y = padded[needed - 1] & 1;
    S = exact_copy(padded, FUZZ_M * FUZZ_L);
    z = exact_copy(padded + FUZZ_M * FUZZ_L * sizeof(REAL), FUZZ_M);
    y = exact_copy(padded + (FUZZ_M * FUZZ_L + FUZZ_M) * sizeof(REAL), FUZZ_L);
    if (padded[needed - 1] & 2) { /* a copy of a row: rank loss is rare among arbitrary bits */
        memcpy(S + (FUZZ_M - 1) * FUZZ_L, S, FUZZ_L * sizeof(REAL));
    }
    if (padded[needed - 1] & 4) { /* rows of moderate integers: ties, zeros and exact cancellation */
        for (i = 0; i < FUZZ_M * FUZZ_L; ++i) {
            S[i] = (REAL)((int8_t)padded[i * (int)sizeof(REAL)] % 4);
        }
    }
    for (i = 0; i < FUZZ_L * FUZZ_M; ++i) {
        before[i] = (REAL)(i + 1) / 7;
    }
    tau = exact_copy(before, FUZZ_L);
    again = exact_copy(before, FUZZ_L);
    X = exact_copy(before, FUZZ_L * FUZZ_M);
    memset(&info, 0x5a, sizeof info);
    status = MEMBER(_solve)(S, z, with_y ? y : NULL, tau, &info);
    finite = finite_all(S, FUZZ_M * FUZZ_L) && finite_all(z, FUZZ_M) && (!with_y || finite_all(y, FUZZ_L));
    check_info(&info, status);
    CHECK((status == STATUS(_NONFINITE)) == !finite);
    CHECK(status < 0 ? memcmp(tau, before, FUZZ_L * sizeof(REAL)) == 0 : finite_all(tau, FUZZ_L));
    CHECK(MEMBER(_solve)(S, z, with_y ? y : NULL, again, NULL) == status);
    CHECK(memcmp(tau, again, FUZZ_L * sizeof(REAL)) == 0);
    memset(&info, 0x5a, sizeof info);
    status = MEMBER(_pinv)(S, X, &info);
    check_info(&info, status);
    CHECK((status == STATUS(_NONFINITE)) == !finite_all(S, FUZZ_M * FUZZ_L));
    CHECK(status < 0 ? memcmp(X, before, FUZZ_L * FUZZ_M * sizeof(REAL)) == 0 : finite_all(X, FUZZ_L * FUZZ_M));
    free(padded); free(S); free(z); free(y); free(tau); free(again); free(X);
    return 0;
}
