/*
 * Runs every entry point of one package over its vectors, and judges the answers.
 *
 * Each vector is run twice. First into outputs between guard words, prefilled with a NaN, and with an info; then into
 * outputs of the exact size, prefilled with another pattern, and without. The two must agree bit for bit: so a value
 * that is not written, that depends on what the output held, or that depends on an earlier call, is found whether or
 * not it has a tolerance.
 *
 * One line of key=value words per output; floats are printed as the hexadecimal of their bits.
 */
#include "hal.h"
#include "harness.h"
#include "print.h"

typedef struct {
    uint32_t compared; /* reals held against an expected value */
    uint32_t outside;  /* of these, beyond their tolerance */
    real error;        /* largest, in ulps of the scale; NaN counts as infinite */
    uint32_t histogram[HARNESS_BINS]; /* of the errors in ulps, over the domain */
    real ratio;        /* largest error / tolerance */
    uint32_t worst;    /* vector and element of that ratio */
    uint32_t element;
    uint32_t touched;  /* reals changed although the status was negative */
    uint32_t overruns; /* guard words changed */
    uint32_t drift;    /* reals that differ between the two runs */
    uint64_t hash;     /* FNV-1a over statuses and bits of the answers */
} tally;

typedef struct {
    uint32_t status; /* mismatches */
    uint32_t rank;
} entry_tally;

static real_bits bits_of(const real *value)
{
    real_bits bits;
    memcpy(&bits, value, sizeof bits);
    return bits;
}

static void fill(real *to, uint32_t count, real_bits pattern)
{
    for (uint32_t i = 0; i < count; ++i) {
        memcpy(&to[i], &pattern, sizeof pattern);
    }
}

static uint32_t count_changed(const real *from, uint32_t count, real_bits pattern)
{
    uint32_t changed = 0;
    for (uint32_t i = 0; i < count; ++i) {
        changed += bits_of(&from[i]) != pattern;
    }
    return changed;
}

static uint64_t fnv1a(uint64_t hash, uint64_t word, int bytes)
{
    for (int i = 0; i < bytes; ++i) {
        hash = (hash ^ ((word >> (8 * i)) & 255u)) * UINT64_C(0x100000001b3);
    }
    return hash;
}

/* |(value - hi) - lo|, infinite for whatever is not a number. */
static real deviation(real value, real hi, real lo)
{
    real error = (value - hi) - lo;
    if (error < 0) {
        error = -error;
    }
    return error <= REAL_LARGEST ? error : REAL_INFINITY;
}

static real ratio_of(real error, real tolerance)
{
    if (tolerance > 0) {
        return error / tolerance;
    }
    return error > 0 ? REAL_INFINITY : 0;
}

/* Bin k holds errors up to 2^(k - 1) ulps, bin 0 those up to half an ulp, the last all that are larger. */
static uint32_t bin_of(real ulps)
{
    real limit = (real)0.5;
    uint32_t bin = 0;
    while (bin < HARNESS_BINS - 1u && ulps > limit) {
        limit *= 2;
        ++bin;
    }
    return bin;
}

static void compare(const harness_output *output, const real *value, uint32_t vector, int in_domain, tally *t)
{
    const real *hi = output->hi + (size_t)vector * output->hi_stride;
    const real *lo = output->lo + (size_t)vector * output->lo_stride;
    const real *tolerance = output->tolerance + (size_t)vector * output->tolerance_stride;
    for (uint32_t i = 0; i < output->size; ++i) {
        if (tolerance[i] < 0) {
            continue;
        }
        const real error = deviation(value[i], hi[i], lo[i]);
        const real ulps = error / output->ulp;
        const real ratio = ratio_of(error, tolerance[i]);
        if (in_domain) {
            t->error = ulps > t->error ? ulps : t->error;
            ++t->histogram[bin_of(ulps)];
        }
        if (ratio > t->ratio || t->compared == 0) {
            t->ratio = ratio;
            t->worst = vector;
            t->element = i;
        }
        t->outside += !(error <= tolerance[i]);
        ++t->compared;
    }
}

#ifdef SERVOGEN_MEASURE
#define TIMES 100u /* calls of one vector at most: the counter's tick is many instructions long */
#define ENOUGH 1000000u /* instructions beside which a tick is nothing: longer calls are made fewer times */

/* Instructions of one call, its arguments and its place in a loop included: the worst and the mean over all vectors;
   and the deepest stack below the caller's. */
static void measure(const harness_entry *entry)
{
    static const harness_probe counter = {hal_count_start, hal_count_stop};
    static const harness_probe painter = {hal_stack_paint, hal_stack_used};
    real *out[HARNESS_MAX_OUTPUTS] = {0};
    uint32_t worst = 0, at = 0, missing = 0, stack = 0;
    uint64_t sum = 0;
    for (uint32_t j = 0; j < entry->outputs; ++j) {
        out[j] = entry->output[j].exact;
    }
    for (uint32_t k = 0; k < entry->vectors; ++k) {
        const uint32_t once = entry->repeat(k, out, 1, &counter);
        const uint32_t times = once > ENOUGH / TIMES ? ENOUGH / once + 1 : TIMES;
        const uint32_t count = (uint32_t)((uint64_t)entry->repeat(k, out, times, &counter) * TIMES / times);
        const uint32_t depth = entry->repeat(k, out, 1, &painter);
        stack = depth > stack ? depth : stack;
        missing += count == 0;
        sum += count;
        if (count > worst) {
            worst = count;
            at = k;
        }
    }
    print_text("cost entry=");
    print_text(entry->name);
    print_count(" vectors=", entry->vectors);
    print_count(" missing=", missing);
    print_count(" worst=", (worst + TIMES - 1) / TIMES);
    print_count(" vector=", at);
    print_count(" mean=", entry->vectors != 0 ? (uint32_t)(sum / TIMES / entry->vectors) : 0);
    print_count(" stack=", stack);
    print_text("\n");
    print_flush();
}
#endif

#ifdef SERVOGEN_DUMP
static void dump(const harness_entry *entry, uint32_t j, const real *value, uint32_t vector, int status)
{
    const harness_output *output = &entry->output[j];
    print_text("value entry=");
    print_text(entry->name);
    print_text(" output=");
    print_text(output->name);
    print_count(" vector=", vector);
    print_number(" status=", status);
    print_text(" bits=");
    for (uint32_t i = 0; i < output->size; ++i) {
        print_text(i == 0 ? "" : ",");
        print_hex(bits_of(&value[i]), REAL_HEX_DIGITS);
    }
    print_text("\n");
}
#endif

static void judge(const harness_entry *entry, uint32_t j, uint32_t vector, int expected, int status, int again,
                  tally *t)
{
    const harness_output *output = &entry->output[j];
    const uint32_t size = output->size;
    const real *value = output->guarded + HARNESS_GUARD;
    t->overruns += count_changed(output->guarded, HARNESS_GUARD, BITS_GUARD);
    t->overruns += count_changed(value + size, HARNESS_GUARD, BITS_GUARD);
    t->hash = fnv1a(t->hash, (uint32_t)status, 4);
    if (status != again) {
        t->drift += size;
        return;
    }
    if (status < 0) {
        t->touched += count_changed(value, size, BITS_UNWRITTEN);
        t->touched += count_changed(output->exact, size, BITS_UNWRITTEN_AGAIN);
        return;
    }
    for (uint32_t i = 0; i < size; ++i) {
        t->hash = fnv1a(t->hash, bits_of(&value[i]), (int)sizeof(real));
        t->drift += bits_of(&value[i]) != bits_of(&output->exact[i]);
    }
    if (expected >= 0) {
        compare(output, value, vector, vector < entry->domain, t);
    }
}

static void run_vector(const harness_entry *entry, uint32_t vector, tally *tallies, entry_tally *counts)
{
    real *first[HARNESS_MAX_OUTPUTS] = {0};
    real *second[HARNESS_MAX_OUTPUTS] = {0};
    for (uint32_t j = 0; j < entry->outputs; ++j) {
        const harness_output *output = &entry->output[j];
        fill(output->guarded, output->size + 2 * HARNESS_GUARD, BITS_GUARD);
        fill(output->guarded + HARNESS_GUARD, output->size, BITS_UNWRITTEN);
        fill(output->exact, output->size, BITS_UNWRITTEN_AGAIN);
        first[j] = output->guarded + HARNESS_GUARD;
        second[j] = output->exact;
    }
    harness_info info = {0, 0};
    const int status = entry->run(vector, first, &info);
    const int again = entry->run(vector, second, NULL);

    const int expected = entry->status != NULL ? entry->status[vector] : HARNESS_ANY_ANSWER;
    const int rank = entry->rank != NULL ? entry->rank[vector] : HARNESS_ANY_RANK;
    const int as_expected =
        expected == HARNESS_ANY_STATUS || (expected == HARNESS_ANY_ANSWER ? status >= 0 : status == expected);
    counts->status += !as_expected || info.status != status;
    counts->rank += rank != HARNESS_ANY_RANK && info.rank != rank;
    for (uint32_t j = 0; j < entry->outputs; ++j) {
        judge(entry, j, vector, expected, status, again, &tallies[j]);
#ifdef SERVOGEN_DUMP
        dump(entry, j, first[j], vector, status);
#endif
    }
}

static int report(const harness_entry *entry, const harness_output *output, const tally *t, const entry_tally *counts)
{
    const int good = t->compared > 0 && t->outside == 0 && t->touched == 0 && t->overruns == 0 && t->drift == 0 &&
                     counts->status == 0 && counts->rank == 0;
    print_text("result entry=");
    print_text(entry->name);
    print_text(" output=");
    print_text(output->name);
    print_count(" vectors=", entry->vectors);
    print_count(" compared=", t->compared);
    print_count(" outside=", t->outside);
    print_text(" ulps=");
    print_hex(bits_of(&t->error), REAL_HEX_DIGITS);
    print_text(" ratio=");
    print_hex(bits_of(&t->ratio), REAL_HEX_DIGITS);
    print_count(" worst=", t->worst);
    print_count(" element=", t->element);
    print_count(" status=", counts->status);
    print_count(" rank=", counts->rank);
    print_count(" touched=", t->touched);
    print_count(" overruns=", t->overruns);
    print_count(" drift=", t->drift);
    print_text(" hash=");
    print_hex(t->hash, 16);
    for (uint32_t k = 0; k < HARNESS_BINS; ++k) {
        print_count(k == 0 ? " histogram=" : ",", t->histogram[k]);
    }
    print_number(" pass=", good);
    print_text("\n");
    print_flush();
    return good;
}

static int check_entry(const harness_entry *entry)
{
    tally tallies[HARNESS_MAX_OUTPUTS];
    entry_tally counts = {0, 0};
    int good = entry->outputs > 0;
    memset(tallies, 0, sizeof tallies);
    for (uint32_t j = 0; j < entry->outputs; ++j) {
        tallies[j].hash = UINT64_C(0xcbf29ce484222325);
    }
    for (uint32_t k = 0; k < entry->vectors; ++k) {
        run_vector(entry, k, tallies, &counts);
    }
    for (uint32_t j = 0; j < entry->outputs; ++j) {
        good &= report(entry, &entry->output[j], &tallies[j], &counts);
    }
    return good;
}

int main(void)
{
    hal_init();
    const harness_table *table = harness_vectors();
    const int prepared = table->prepare();
    print_text("harness prefix=");
    print_text(table->prefix);
    print_count(" bits=", SERVOGEN_SCALAR_BITS);
    print_count(" entries=", table->entries);
    print_number(" prepare=", prepared);
    print_text("\n");
    print_flush();

    int good = prepared >= 0 && table->entries > 0;
    for (uint32_t i = 0; i < table->entries && prepared >= 0; ++i) {
        good &= check_entry(&table->entry[i]);
#ifdef SERVOGEN_MEASURE
        measure(&table->entry[i]);
#endif
    }
    print_number("verdict pass=", good);
    print_text("\n");
    print_flush();
    hal_exit(good ? 0 : 1);
    return 1;
}
