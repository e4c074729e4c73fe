/*
 * Back to back: SERVOGEN_CAMPAIGN states made on the target itself, the same on every target, and one hash for each
 * entry point over the statuses, the bits of all answers and of what is told about them.
 *
 * States: first the table's, boundary states included; then by turns from the domain's box, near and on states of the
 * table, at the box's corners, with entries at zero, tiny, huge, and with one special number (NaN and infinity, too).
 * Beside the hash a line tells how often each status occurred, the most instructions a call took (to within two ticks
 * of the board's clock, and the probe's own), those of all calls together, and the deepest stack, at every eighth state.
 */
#include "campaign.h"

#include "hal.h"
#include "print.h"
#include SERVOGEN_CAMPAIGN_HEADER

enum { LOWEST = CAMPAIGN_LOWEST, STATUSES = CAMPAIGN_STATUSES, PAINT_EVERY = 8 };

/* A bijection of 32 bits without pattern (Wellons' lowbias32). */
static uint32_t mix(uint32_t x)
{
    x = (x ^ (x >> 16)) * 0x7feb352du;
    x = (x ^ (x >> 15)) * 0x846ca68bu;
    return x ^ (x >> 16);
}

static uint32_t draw(uint32_t k, uint32_t i)
{
    return mix(mix(k + 1u) + i);
}

/* In [0, 1), exact in the scalar. */
static real unit(uint32_t k, uint32_t i)
{
#if SERVOGEN_SCALAR_BITS == 64
    return ((real)(draw(k, 2u * i) >> 5) * 67108864.0 + (real)(draw(k, 2u * i + 1u) >> 6)) * 0x1p-53;
#else
    return (real)(draw(k, 2u * i) >> 8) * 0x1p-24f;
#endif
}

static real power(int exponent)
{
    real value = 1;
    while (exponent > 0) {
        value *= 2;
        --exponent;
    }
    while (exponent < 0) {
        value *= (real)0.5;
        ++exponent;
    }
    return value;
}

static real special(uint32_t which)
{
    static const real values[] = {0, (real)-0.0, 1, -1, (real)1.5707963267948966, (real)-3.141592653589793,
                                  REAL_LARGEST, -REAL_LARGEST, REAL_NAN, REAL_INFINITY, -REAL_INFINITY};
    const uint32_t count = sizeof values / sizeof values[0];
    return which % (count + 1u) < count ? values[which % (count + 1u)] : power(SERVOGEN_SCALAR_BITS == 64 ? -1070 : -147);
}

static void make_state(const campaign_table *table, uint32_t k, real *x)
{
    const uint32_t kind = mix(k) % 16u;
    const uint32_t chosen = draw(k, 1000u);
    const real *row = table->state + (size_t)(chosen % table->drawn) * table->width;
    if (k < table->states) {
        memcpy(x, table->state + (size_t)k * table->width, table->width * sizeof(real));
        return;
    }
    for (uint32_t i = 0; i < table->width; ++i) {
        const real span = table->high[i] - table->low[i];
        const real inside = table->low[i] + span * unit(k, i);
        const uint32_t coin = draw(k, 2000u + i) & 1u;
        switch (kind) {
        case 9: case 10: x[i] = row[i] + span * ((unit(k, i) - (real)0.5) * power(-10)); break;
        case 11: x[i] = coin ? row[i] : 0; break;
        case 12: x[i] = coin ? table->low[i] : table->high[i]; break;
        case 13: x[i] = inside * power(-(int)(chosen % 60u) - 1); break;
        case 14: x[i] = inside * power((int)(chosen % 40u) + 1); break;
        default: x[i] = inside; break;
        }
    }
    if (kind == 15) {
        x[chosen % table->width] = special(chosen >> 8);
    }
}

static uint64_t fnv1a(uint64_t hash, const void *data, size_t bytes)
{
    const unsigned char *byte = data;
    while (bytes-- > 0) {
        hash = (hash ^ *byte++) * UINT64_C(0x100000001b3);
    }
    return hash;
}

/* The words of an answer; a NaN among them counts as one, whatever its bits. */
static uint64_t hash_reals(uint64_t hash, const real *value, uint32_t count)
{
    for (uint32_t i = 0; i < count; ++i) {
        const real canonical = value[i] == value[i] ? value[i] : REAL_NAN;
        hash = fnv1a(hash, &canonical, sizeof canonical);
    }
    return hash;
}

static uint64_t hash_info(uint64_t hash, const campaign_info *info)
{
    const int32_t words[3] = {info->rank, info->path, info->sweeps};
    const real reals[2] = {info->sigma_min, info->residual};
    return hash_reals(fnv1a(hash, words, sizeof words), reals, 2);
}

static uint32_t changed(const real *value, uint32_t count)
{
    const real_bits pattern = BITS_UNWRITTEN;
    uint32_t found = 0;
    for (uint32_t i = 0; i < count; ++i) {
        found += memcmp(&value[i], &pattern, sizeof pattern) != 0;
    }
    return found;
}

#ifdef SERVOGEN_DUMP
static void show(const char *key, const real *value, uint32_t count)
{
    print_text(key);
    for (uint32_t i = 0; i < count; ++i) {
        real_bits bits;
        memcpy(&bits, &value[i], sizeof bits);
        print_text(i == 0 ? "" : ",");
        print_hex(bits, REAL_HEX_DIGITS);
    }
}
#endif

static int run_entry(const campaign_table *table, const campaign_entry *entry)
{
    static const harness_probe counter = {hal_count_start, hal_count_stop};
    static const harness_probe painter = {hal_stack_paint, hal_stack_used};
    static real out[CAMPAIGN_LARGEST], state[CAMPAIGN_WIDTH];
    uint32_t statuses[STATUSES] = {0}, worst = 0, at = 0, stack = 0, touched = 0;
    uint64_t hash = UINT64_C(0xcbf29ce484222325), total = 0;
    for (uint32_t k = 0; k < SERVOGEN_CAMPAIGN; ++k) {
        const real_bits pattern = BITS_UNWRITTEN;
        campaign_info info = {0, 0, 0, 0, 0};
        uint32_t measured = 0;
        make_state(table, k, state);
        if (k % PAINT_EVERY == 0) {
            (void)entry->run(state, out, &info, &painter, &measured);
            stack = measured > stack ? measured : stack;
        }
        for (uint32_t i = 0; i < CAMPAIGN_LARGEST; ++i) {
            memcpy(&out[i], &pattern, sizeof pattern);
        }
        const int32_t status = entry->run(state, out, &info, &counter, &measured);
        total += measured;
        if (measured > worst) {
            worst = measured;
            at = k;
        }
#ifdef SERVOGEN_DUMP
        print_text("answer entry=");
        print_text(entry->name);
        print_count(" vector=", k);
        print_number(" status=", status);
        show(" state=", state, table->width);
        show(" bits=", out, entry->size);
        print_text("\n");
#endif
        hash = fnv1a(hash, &status, sizeof status);
        if (status >= 0) {
            hash = hash_reals(hash, out, entry->size);
        } else {
            touched += changed(out, entry->size);
        }
        if (entry->has_info) {
            hash = hash_info(hash, &info);
        }
        if (status >= LOWEST && status < LOWEST + STATUSES) {
            ++statuses[status - LOWEST];
        }
    }
    print_text("campaign entry=");
    print_text(entry->name);
    print_count(" vectors=", SERVOGEN_CAMPAIGN);
    print_text(" hash=");
    print_hex(hash, 16);
    print_count(" touched=", touched);
    print_count(" worst=", worst);
    print_count(" vector=", at);
    print_text(" total=");
    print_hex(total, 16);
    print_count(" stack=", stack);
    for (uint32_t s = 0; s < STATUSES; ++s) {
        print_count(s == 0 ? " statuses=" : ",", statuses[s]);
    }
    print_text("\n");
    print_flush();
    return touched == 0;
}

int main(void)
{
    const campaign_table *table = &campaign;
    int good;
    hal_init();
    good = table->prepare() >= 0;
    print_text("harness prefix=");
    print_text(table->prefix);
    print_text("\n");
    for (uint32_t i = 0; i < table->entries && good; ++i) {
        good = run_entry(table, &table->entry[i]) && good;
    }
    print_number("verdict pass=", good);
    print_text("\n");
    print_flush();
    hal_exit(good ? 0 : 1);
    return 1;
}
