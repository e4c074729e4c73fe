/* FNV-1a over the bits of 20,000 solves, and of their infos: equal on every compiler, level and machine. Random, graded,
   near-singular, exactly singular and inconsistent systems, with and without y, from an integer generator; no libm.
     cc -std=c99 -ffp-contract=off -DROWS=3 -DCOLUMNS=7 -DREAL=double -DSOURCE='"pinv.c"' -I<package> bits.c -lm */
#include SOURCE

static uint32_t bits_state = 12345u;

static uint32_t bits_next(void)
{
    bits_state ^= bits_state << 13;
    bits_state ^= bits_state >> 17;
    bits_state ^= bits_state << 5;
    return bits_state;
}

static REAL bits_number(void)
{
    return (REAL)((int32_t)(bits_next() >> 9) - 4194304) / (REAL)4194304; /* 23 bits: exact in either type */
}

static void bits_add(uint32_t *hash, const void *data, unsigned size)
{
    const unsigned char *bytes = data;
    unsigned i;
    for (i = 0; i < size; ++i) {
        *hash = (*hash ^ bytes[i]) * 16777619u;
    }
}

uint32_t bits_hash(int systems);
uint32_t bits_hash(int systems)
{
    uint32_t hash = 2166136261u;
    int n, i, j;
    for (n = 0; n < systems; ++n) {
        REAL S[ROWS * COLUMNS], z[ROWS], y[COLUMNS], tau[COLUMNS];
        pinv_info info;
        for (i = 0; i < ROWS * COLUMNS; ++i) {
            S[i] = bits_number();
        }
        for (i = 0; i < ROWS; ++i) {
            const REAL unit = pinv_power(n % 5 == 1 ? (int)(bits_next() % 60u) - 30 : 0);
            z[i] = bits_number() * unit;
            for (j = 0; j < COLUMNS; ++j) {
                S[COLUMNS * i + j] *= unit;
            }
        }
        if (n % 5 >= 2) { /* the last row near, at, or exactly the first; z consistent or not */
            const REAL apart = n % 5 == 2 ? pinv_power(-(int)(bits_next() % 40u)) : (REAL)0;
            for (j = 0; j < COLUMNS; ++j) {
                S[COLUMNS * (ROWS - 1) + j] = S[j] + apart * bits_number();
            }
            z[ROWS - 1] = n % 5 == 3 ? z[0] : z[ROWS - 1];
        }
        for (j = 0; j < COLUMNS; ++j) {
            y[j] = bits_number();
            tau[j] = 0;
        }
        (void)pinv_solve(S, z, n % 2 ? y : NULL, tau, &info);
        bits_add(&hash, tau, sizeof tau);
        bits_add(&hash, &info.status, sizeof(int) * 4u);
        bits_add(&hash, &info.sigma_min, sizeof info.sigma_min);
        bits_add(&hash, &info.residual, sizeof info.residual);
    }
    return hash;
}

#ifndef BITS_NO_MAIN
#include <stdio.h>
int main(void)
{
    printf("%08lx\n", (unsigned long)bits_hash(20000));
    return 0;
}
#endif
