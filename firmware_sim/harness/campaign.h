/* What a campaign header hands to campaign.c: where states come from, and the entry points to call at each. */
#ifndef SERVOGEN_CAMPAIGN_H
#define SERVOGEN_CAMPAIGN_H

#include "harness.h"

typedef struct {
    int rank, path, sweeps;
    real sigma_min, residual;
} campaign_info;

typedef struct {
    const char *name;
    uint32_t size; /* reals in all outputs together */
    int has_info;
    int (*run)(const real *state, real *out, campaign_info *info, const harness_probe *probe, uint32_t *measured);
} campaign_entry;

typedef struct {
    const char *prefix;
    int (*prepare)(void);
    uint32_t width;         /* reals in the input struct */
    uint32_t drawn, states; /* rows of `state`: those drawn from the domain, then the boundary states */
    const real *state;      /* [states * width] */
    const real *low, *high; /* [width], the domain's box */
    uint32_t entries;
    const campaign_entry *entry;
} campaign_table;

#endif
