/* A row's closed form beside the bare formula, nanoseconds a solve: y = NULL, a y that needs no refinement, a random y;
   the last two also beside the bare formula with that refinement. */
#include OURS_HEADER
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { N = 64 }; /* systems: their data stays in the first-level cache */
enum { BARE, REFINED, OURS, CONTENDERS };
enum { WITHOUT_Y, MILD_Y, RANDOM_Y, KINDS };

void bare(const REAL *S, const REAL *z, const REAL *y, REAL *tau);
void bare_refined(const REAL *S, const REAL *z, const REAL *y, REAL *tau);

static REAL S[N * COLUMNS], z[N], y[KINDS][N * COLUMNS], tau[N * COLUMNS];

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

static double once(int contender, int kind, int repeats)
{
    const double start = now();
    int i, k;
    for (k = 0; k < repeats; ++k) {
        for (i = 0; i < N; ++i) {
            const REAL *given = kind == WITHOUT_Y ? NULL : &y[kind][i * COLUMNS];
            if (contender == OURS) {
                ours_solve(&S[i * COLUMNS], &z[i], given, &tau[i * COLUMNS], NULL);
            } else if (contender == REFINED) {
                bare_refined(&S[i * COLUMNS], &z[i], given, &tau[i * COLUMNS]);
            } else {
                bare(&S[i * COLUMNS], &z[i], given, &tau[i * COLUMNS]);
            }
        }
    }
    return (now() - start) / (double)repeats / N;
}

static REAL uniform(void)
{
    return (REAL)(rand() / (double)RAND_MAX - 0.5);
}

int main(int argc, char **argv)
{
    const int rounds = argc > 1 ? atoi(argv[1]) : 300;
    double best[CONTENDERS][KINDS];
    int round, contender, kind, i, j;
    srand(1);
    for (i = 0; i < N; ++i) {
        REAL dot = 0;
        z[i] = uniform();
        for (j = 0; j < COLUMNS; ++j) {
            S[i * COLUMNS + j] = uniform();
            y[RANDOM_Y][i * COLUMNS + j] = uniform();
            dot += S[i * COLUMNS + j] * y[RANDOM_Y][i * COLUMNS + j];
        }
        for (j = 0; j < COLUMNS; ++j) { /* s y = z / 4: tau comes out no smaller than what it is made of */
            y[MILD_Y][i * COLUMNS + j] = y[RANDOM_Y][i * COLUMNS + j] * (REAL)0.25 * z[i] / dot;
        }
    }
    for (round = 0; round < rounds; ++round) {
        for (contender = 0; contender < CONTENDERS; ++contender) {
            for (kind = contender == REFINED ? MILD_Y : WITHOUT_Y; kind < KINDS; ++kind) {
                const double spent = once(contender, kind, 200);
                if (round == 0 || spent < best[contender][kind]) {
                    best[contender][kind] = spent;
                }
            }
        }
    }
    for (kind = 0; kind < KINDS; ++kind) {
        printf("%.4g %.4g\n", best[BARE][kind], best[OURS][kind]);
    }
    for (kind = MILD_Y; kind < KINDS; ++kind) {
        printf("%.4g %.4g\n", best[REFINED][kind], best[OURS][kind]);
    }
    return 0;
}
