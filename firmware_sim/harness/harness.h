/*
 * What a vector header hands to the harness: one table of entry points.
 *
 * All arrays are flat and row-major, one row per vector. A stride is the distance between rows: the row's length, or
 * 0 where one row serves every vector.
 */
#ifndef SERVOGEN_HARNESS_H
#define SERVOGEN_HARNESS_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "scalar.h"

#define HARNESS_GUARD 4       /* guard words on each side of a guarded output */
#define HARNESS_MAX_OUTPUTS 8 /* of one entry point; servogen.verify.vectors knows this number too */
#define HARNESS_BINS 10u      /* of an output's histogram of errors; the last one is open */
#define HARNESS_ANY_ANSWER 127 /* expected status: any that is not negative */
#define HARNESS_ANY_STATUS (-127) /* any at all */
#define HARNESS_ANY_RANK (-1)  /* expected rank: not compared */

typedef struct {
    const char *name;
    uint32_t size;         /* reals in one answer */
    const real *hi;        /* expected value, rounded to the scalar ... */
    const real *lo;        /* ... and what the rounding left over */
    const real *tolerance; /* absolute; negative where not compared */
    uint32_t hi_stride, lo_stride, tolerance_stride;
    real ulp;      /* unit in the last place at the output's scale */
    real *guarded; /* HARNESS_GUARD + size + HARNESS_GUARD reals */
    real *exact;   /* size reals, an object of its own: AddressSanitizer sees the first real past its end */
} harness_output;

typedef struct {
    int status;
    int rank;
} harness_info;

/* What is measured around calls: two functions of the board. */
typedef struct {
    void (*start)(void);
    uint32_t (*stop)(void);
} harness_probe;

typedef struct {
    const char *name;
    uint32_t vectors;
    uint32_t domain; /* errors are measured in ulps over the first so many; what follows is judged by tolerance alone */
    uint32_t outputs;
    const harness_output *output;
    const int8_t *status; /* expected, one per vector; NULL: any that is not negative */
    const int8_t *rank;   /* expected, one per vector; NULL: not compared */
    int (*run)(uint32_t vector, real *const out[], harness_info *info); /* info NULL: so for the entry point, too */
    uint32_t (*repeat)(uint32_t vector, real *const out[], uint32_t times, const harness_probe *probe);
} harness_entry;

typedef struct {
    const char *prefix;
    int (*prepare)(void);
    uint32_t entries;
    const harness_entry *entry;
} harness_table;

/* Fails to compile unless `what` (a member, a struct) holds `count` reals, as an array or on its own. */
#define HARNESS_HOLDS(what, count) ((void)sizeof(char[sizeof(what) == (count) * sizeof(real) ? 1 : -1]))

const harness_table *harness_vectors(void);

#endif
