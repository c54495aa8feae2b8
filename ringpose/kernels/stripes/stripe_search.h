/* Ridge detection in cells that may contain a ridge. */
#ifndef RINGPOSE_STRIPE_SEARCH_H
#define RINGPOSE_STRIPE_SEARCH_H

#include "stripe_patches.h"

/* Rows of a cell of the coarse search. */
enum { CELL = 4 };

#define STRIPE_PARAMS(REAL, COUNT)                                                                                  \
    REAL(min_response, POSITIVE)                                                                                    \
    REAL(coarse_per_response, NOT_NEGATIVE)                                                                         \
    COUNT(full_dn, 1, UINT16_MAX)                                                                                   \
    REAL(begin_sigmas, NOT_NEGATIVE)                                                                                \
    REAL(continue_sigmas, NOT_NEGATIVE)                                                                             \
    COUNT(gap, 0, 1000)                                                                                             \
    COUNT(shortest, 1, INT32_MAX)                                                                                   \
    REAL(reach_sigmas, 2, 10)                                                                                       \
    REAL(max_speckle, 1, 1000)
RECORD_STRUCT(StripeParams, STRIPE_PARAMS);

/* First column, column after the last, first row, row after the last of each band; NULL for the whole image. */
typedef struct {
    const int32_t *sides;
    size_t count;
} Bands;
enum { SIDES = 4 };

/* Noise of the second derivative, one value for each area of NOISE_ROWS rows and NOISE_BLOCKS blocks, measured on
   demand. */
typedef struct {
    const StripeImage *image;
    const Filter *filter;
    size_t blocks, areas_across;
    float *figure; /* negative: not measured yet */
} Noise;

enum { NOISE_ROWS = 128, NOISE_BLOCKS = 4 };

float noise_at(const Noise *noise, size_t row, size_t block);

/* Smallest response of a ridge. */
static inline float min_response(const StripeParams *params, float noise) {
    float enough = (float)params->continue_sigmas * noise, minimum = (float)params->min_response;
    return enough > minimum ? enough : minimum;
}

/* Cells of a block that are to be smoothed. */
typedef struct {
    int32_t block, first, last;
} Run;

/* A ridge in one column: its pixel, sub-pixel ordinate, response (minus the second derivative), curvature of the
   response, and noise. On a flat top `curvature` is minus half its width. */
typedef struct {
    int32_t x, row;
    float y, response, curvature, noise;
    int32_t piece;
} Ridge;

/* Each returns 0 if there is no memory. Runs come from the top in each block, ridges column by column from the top;
   `found` is scratch. */
int find_runs(const Noise *noise, const StripeParams *params, const Bands *bands, List *runs);
int find_ridges(const Noise *noise, const StripeParams *params, const List *runs, List *found, List *ridges);

#endif
