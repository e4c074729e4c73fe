/* FNV-1a over the bits of SYSTEMS solves of a bare solver package, and of their infos: equal on every compiler, level and
   machine. Random, graded, near-singular, exactly singular and inconsistent systems, with and without y, from an integer
   generator; no libm. The build defines HEADER, ROWS, COLUMNS, REAL, SOLVE and INFO; and BATCH_HEADER and SOLVE_BATCH where
   a system is solved together with the 15 before it. */
#include HEADER
#ifdef BATCH_HEADER
#include BATCH_HEADER
#endif

#include <string.h>

#include "hal.h"
#include "print.h"

static uint32_t state = 12345u;

static uint32_t next(void)
{
    state ^= state << 13;
    state ^= state >> 17;
    state ^= state << 5;
    return state;
}

static REAL number(void)
{
    return (REAL)((int32_t)(next() >> 9) - 4194304) / (REAL)4194304; /* 23 bits: exact in either type */
}

/* 2^k, exact. */
static REAL power(int k)
{
    REAL result = 1;
    for (; k > 0; --k) {
        result *= (REAL)2;
    }
    for (; k < 0; ++k) {
        result *= (REAL)0.5;
    }
    return result;
}

static void add(uint32_t *hash, const void *data, unsigned size)
{
    const unsigned char *bytes = data;
    unsigned i;
    for (i = 0; i < size; ++i) {
        *hash = (*hash ^ bytes[i]) * 16777619u;
    }
}

static void solve(const REAL *S, const REAL *z, const REAL *y, REAL *tau, INFO *info)
{
#ifdef BATCH_HEADER
    enum { AT_ONCE = 16 };
    static REAL all_S[AT_ONCE * ROWS * COLUMNS], all_z[AT_ONCE * ROWS], all_y[AT_ONCE * COLUMNS], all_tau[AT_ONCE * COLUMNS];
    static INFO all_info[AT_ONCE];
    static unsigned called;
    const unsigned at = called++ % AT_ONCE;
    memcpy(all_S + at * ROWS * COLUMNS, S, ROWS * COLUMNS * sizeof *S);
    memcpy(all_z + at * ROWS, z, ROWS * sizeof *z);
    if (y != NULL) {
        memcpy(all_y + at * COLUMNS, y, COLUMNS * sizeof *y);
    }
    memcpy(all_tau + at * COLUMNS, tau, COLUMNS * sizeof *tau);
    (void)SOLVE_BATCH(all_S, all_z, y != NULL ? all_y : NULL, AT_ONCE, all_tau, all_info, NULL);
    memcpy(tau, all_tau + at * COLUMNS, COLUMNS * sizeof *tau);
    *info = all_info[at];
#else
    (void)SOLVE(S, z, y, tau, info);
#endif
}

static uint32_t hash_of(int systems)
{
    uint32_t hash = 2166136261u;
    int n, i, j;
    for (n = 0; n < systems; ++n) {
        REAL S[ROWS * COLUMNS], z[ROWS], y[COLUMNS], tau[COLUMNS];
        INFO info;
        for (i = 0; i < ROWS * COLUMNS; ++i) {
            S[i] = number();
        }
        for (i = 0; i < ROWS; ++i) {
            const REAL unit = power(n % 5 == 1 ? (int)(next() % 60u) - 30 : 0);
            z[i] = number() * unit;
            for (j = 0; j < COLUMNS; ++j) {
                S[COLUMNS * i + j] *= unit;
            }
        }
        if (n % 5 >= 2) { /* the last row near, at, or exactly the first; z consistent or not */
            const REAL apart = n % 5 == 2 ? power(-(int)(next() % 40u)) : (REAL)0;
            for (j = 0; j < COLUMNS; ++j) {
                S[COLUMNS * (ROWS - 1) + j] = S[j] + apart * number();
            }
            z[ROWS - 1] = n % 5 == 3 ? z[0] : z[ROWS - 1];
        }
        for (j = 0; j < COLUMNS; ++j) {
            y[j] = number();
            tau[j] = 0;
        }
        solve(S, z, n % 2 ? y : NULL, tau, &info);
        add(&hash, tau, sizeof tau);
        add(&hash, &info.status, sizeof(int) * 4u);
        add(&hash, &info.sigma_min, sizeof info.sigma_min);
        add(&hash, &info.residual, sizeof info.residual);
    }
    return hash;
}

int main(void)
{
    hal_init();
    print_text("bits hash=");
    print_hex(hash_of(SYSTEMS), 8);
    print_text("\n");
    print_flush();
    hal_exit(0);
    return 0;
}
