/*
 * Sums of float64 in software, rounded correctly. libgcc's for Armv7-M and Armv8-M (ieee754-df.S, seen in GCC 12.2) loses
 * a bit where the exponents differ by 33 and the difference lies below the larger operand's power of two: of the
 * smaller operand's low word it keeps only that it is not zero, and after the shift that normalises the result this
 * is one bit too few. The last bit of some one sum in 10^4 is then wrong. Those sums are made here, all others there:
 *
 *     -Wl,--wrap=__aeabi_dadd,--wrap=__aeabi_dsub
 *
 * Words instead of doubles, since these functions take their arguments in core registers under every ABI.
 */
#include <stdint.h>

#define SIGN UINT64_C(0x8000000000000000)
#define HIDDEN UINT64_C(0x0010000000000000)

enum { GUARD = 10, DISTANCE = 33, NOT_FINITE = 0x7ff };

uint64_t __real___aeabi_dadd(uint64_t a, uint64_t b);
uint64_t __real___aeabi_dsub(uint64_t a, uint64_t b);
uint64_t __wrap___aeabi_dadd(uint64_t a, uint64_t b);
uint64_t __wrap___aeabi_dsub(uint64_t a, uint64_t b);

static uint32_t exponent(uint64_t x)
{
    const uint32_t e = (uint32_t)(x >> 52) & NOT_FINITE;
    return e == 0 ? 1 : e;
}

static uint64_t significand(uint64_t x)
{
    const uint64_t fraction = x & (HIDDEN - 1);
    return (((x >> 52) & NOT_FINITE) == 0 ? fraction : fraction | HIDDEN) << GUARD;
}

/* |x| - |y| with the sign of x, whose exponent is DISTANCE above that of y. */
static uint64_t difference(uint64_t x, uint64_t y)
{
    const uint64_t small = significand(y);
    const uint64_t lost = small & ((UINT64_C(1) << DISTANCE) - 1);
    uint64_t e = exponent(x);
    uint64_t d = significand(x) - ((small >> DISTANCE) | (lost != 0));
    uint64_t rest, m;
    if (d < HIDDEN << GUARD) {
        d <<= 1;
        e -= 1;
    }
    rest = d & ((1u << GUARD) - 1);
    m = d >> GUARD;
    m += rest > 1u << (GUARD - 1) || (rest == 1u << (GUARD - 1) && (m & 1) != 0);
    return (x & SIGN) | (((e - 1) << 52) + m);
}

/* Whether a + b is one of the sums that libgcc may round wrongly. */
static int affected(uint64_t a, uint64_t b)
{
    const uint32_t apart = exponent(a) - exponent(b);
    return ((a ^ b) & SIGN) != 0 && (apart == DISTANCE || apart == 0u - DISTANCE) && exponent(a) != NOT_FINITE &&
           exponent(b) != NOT_FINITE;
}

uint64_t __wrap___aeabi_dadd(uint64_t a, uint64_t b)
{
    if (!affected(a, b)) {
        return __real___aeabi_dadd(a, b);
    }
    return exponent(a) > exponent(b) ? difference(a, b) : difference(b, a);
}

uint64_t __wrap___aeabi_dsub(uint64_t a, uint64_t b)
{
    return affected(a, b ^ SIGN) ? __wrap___aeabi_dadd(a, b ^ SIGN) : __real___aeabi_dsub(a, b);
}
