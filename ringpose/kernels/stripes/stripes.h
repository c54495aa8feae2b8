/* What the steps of the stripe kernel share. No Python in here. */
#ifndef RINGPOSE_STRIPES_H
#define RINGPOSE_STRIPES_H

#include "kernels.h"

/* Columns that are worked on together, and rows of a cell of the coarse search. */
enum { BLOCK = 16, CELL = 4 };

/* Largest number of taps on one side of a filter. */
enum { MOST_REACH = 40 };

/* Rows of a block that are smoothed together at most. */
enum { CHUNK = 64, PATCH = BLOCK * (CHUNK + 2 + 2 * MOST_REACH) };

/* 8 or, if `wide`, 16 bits a pixel; `dark` may be NULL. */
typedef struct {
    const void *lit, *dark;
    size_t height, width;
    int wide;
} StripeImage;

/* First (odd) and second (even) derivative of a Gaussian: the taps from the middle on. */
typedef struct {
    const float *slope, *bend;
    size_t reach; /* taps beyond the middle */
    double sigma, slope_norm, bend_norm; /* norms: response to white noise of 1 DN */
} Filter;

typedef struct {
    float begin_sigmas, continue_sigmas; /* response over its noise: of a piece's best columns, and of any */
    float least_response;
    float coarse_per_response; /* what the coarse search sees of a ridge with a response of 1 */
    float full;                /* grey value of a saturated pixel */
    size_t gap, shortest;      /* columns */
} StripeRules;

/* For each band its first column, the one after the last, and likewise its rows; NULL for the whole image. */
typedef struct {
    const int32_t *sides;
    size_t count;
} Bands;
enum { SIDES = 4 };

/* Pixels of a block, from `reach` rows above what is differentiated. A row is a line of the cache. */
typedef struct {
    float pixel[PATCH], bend[PATCH], slope[PATCH];
} __attribute__((aligned(64))) Patch;

/* Loads rows of a block; beyond the border the outermost pixels are repeated. */
void load_pixels(const StripeImage *image, ptrdiff_t row, size_t column, size_t rows, Patch *patch);

/* Second derivative down the columns of `count` pixels, in pairs of whole rows; the first as well, in whole rows. */
void bend_pixels(const Filter *filter, size_t count, Patch *patch);
void differentiate_pixels(const Filter *filter, size_t count, Patch *patch);

/* Noise of the second derivative, one figure for areas of some rows and blocks, measured when asked for. */
typedef struct {
    const StripeImage *image;
    const Filter *filter;
    size_t blocks, areas_across;
    float *figure; /* negative: not yet known */
} Noise;

enum { NOISE_ROWS = 128, NOISE_BLOCKS = 4 };

float noise_at(const Noise *noise, size_t row, size_t block);

/* What a ridge must have at least to continue a piece. */
static inline float least_response(const StripeRules *rules, float noise) {
    float enough = rules->continue_sigmas * noise;
    return enough > rules->least_response ? enough : rules->least_response;
}

/* Cells of a block that are to be smoothed. */
typedef struct {
    int32_t block, first, last;
} Run;

/* A ridge in one column: its pixel; where between the pixels; minus the second derivative there, how fast that falls
   off on both sides, and its noise. On a flat top `bend` is minus half its width. */
typedef struct {
    int32_t x, row;
    float y, response, bend, noise;
    int32_t piece;
} Ridge;

typedef struct {
    int32_t columns, strong_columns;
} StripePiece;

/* Columns of the image with their centres, piece after piece; as much room as there are ridges in kept pieces. */
typedef struct {
    double *position, *sigma, *peak; /* position: x and y */
    int64_t *piece;
    size_t count;
} Centers;

/* Each returns 0 if there is no memory. Runs come from the top in each block, ridges column by column from the top;
   `found` is scratch. */
int find_runs(const Noise *noise, const StripeRules *rules, const Bands *bands, List *runs);
int find_ridges(const Noise *noise, const StripeRules *rules, const List *runs, List *found, List *ridges);
int link_ridges(const StripeImage *image, const Filter *filter, const StripeRules *rules, List *ridges, List *pieces);

/* How many ridges the pieces have that are long and strong enough. */
size_t kept_ridges(const StripeRules *rules, const List *pieces);
int find_centers(const StripeImage *image, const Filter *filters, size_t filter_count, const StripeRules *rules,
                 const List *ridges, const List *pieces, Centers *centers);

static inline size_t clamped(ptrdiff_t index, size_t size) {
    return index < 0 ? 0 : (size_t)index < size ? (size_t)index : size - 1;
}

/* Whether rows of a block lie within the image. */
static inline int is_inside(const StripeImage *image, ptrdiff_t row, size_t column, size_t rows) {
    return row >= 0 && (size_t)row + rows <= image->height && column + BLOCK <= image->width;
}

static inline float lit_at(const StripeImage *image, size_t index) {
    return image->wide ? ((const uint16_t *)image->lit)[index] : ((const uint8_t *)image->lit)[index];
}

static inline float pixel_at(const StripeImage *image, size_t index) {
    if (image->wide) {
        const uint16_t *lit = image->lit, *dark = image->dark;
        return (float)(lit[index] - (dark ? dark[index] : 0));
    }
    const uint8_t *lit = image->lit, *dark = image->dark;
    return (float)(lit[index] - (dark ? dark[index] : 0));
}

#endif
