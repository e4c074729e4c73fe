/* The scalar of one image, and the bit patterns the harness plants in outputs. */
#ifndef SERVOGEN_SCALAR_H
#define SERVOGEN_SCALAR_H

#include <float.h>
#include <math.h> /* NAN and INFINITY only: nothing is called, nothing is linked */
#include <stdint.h>

#if SERVOGEN_SCALAR_BITS == 64
typedef double real;
typedef uint64_t real_bits;
#define REAL_HEX_DIGITS 16
#define REAL_LARGEST DBL_MAX
#define BITS_UNWRITTEN UINT64_C(0x7ff8dead5eed0001) /* a NaN: an output left unwritten is infinitely wrong */
#define BITS_UNWRITTEN_AGAIN UINT64_C(0x40b57a1e5eed0002) /* finite, so that the two calls cannot agree by chance */
#define BITS_GUARD UINT64_C(0x7ff8cafe5eed0003)
#elif SERVOGEN_SCALAR_BITS == 32
typedef float real;
typedef uint32_t real_bits;
#define REAL_HEX_DIGITS 8
#define REAL_LARGEST FLT_MAX
#define BITS_UNWRITTEN UINT32_C(0x7fc0dead)
#define BITS_UNWRITTEN_AGAIN UINT32_C(0x45abd1e5)
#define BITS_GUARD UINT32_C(0x7fc0cafe)
#else
#error "SERVOGEN_SCALAR_BITS must be 32 or 64"
#endif

#define REAL_NAN ((real)NAN)
#define REAL_INFINITY ((real)INFINITY)

#endif
