/* The stages of the stripe detector: search, links, centres, sigmas. */
#ifndef RINGPOSE_STRIPES_H
#define RINGPOSE_STRIPES_H

#include "kernels.h"

/* Columns that are processed together, and rows of a cell of the coarse search. */
enum { BLOCK = 16, CELL = 4 };

/* Largest number of taps on one side of a filter. */
enum { MAX_REACH = 40 };

/* Largest number of rows of a block that are smoothed together. */
enum { CHUNK = 64, PATCH = BLOCK * (CHUNK + 2 + 2 * MAX_REACH) };

/* 8 or, if `wide`, 16 bits a pixel; `dark` may be NULL. */
typedef struct {
    const void *lit, *dark;
    size_t height, width;
    int wide;
} StripeImage;

/* First (odd) and second (even) derivative of a Gaussian: the taps from the middle on. */
typedef struct {
    const float *slope, *curvature;
    size_t reach; /* taps beyond the middle */
    double sigma, slope_norm, bend_norm; /* norms: response to white noise of 1 DN */
} Filter;

typedef struct {
    float begin_sigmas, continue_sigmas; /* response over its noise: of the strong columns of a piece, of all columns */
    float min_response;
    float coarse_per_response; /* window sum of a ridge with a response of 1 */
    float full;                /* grey value of a saturated pixel */
    size_t gap, shortest;      /* columns */
} StripeParams;

/* First column, column after the last, first row, row after the last of each band; NULL for the whole image. */
typedef struct {
    const int32_t *sides;
    size_t count;
} Bands;
enum { SIDES = 4 };

/* Pixels of a block, from `reach` rows above the differentiated ones. A row is one cache line. */
typedef struct {
    float pixel[PATCH], curvature[PATCH], slope[PATCH];
} __attribute__((aligned(64))) Patch;

/* Loads rows of a block; beyond the border the outermost pixels are repeated. */
void load_pixels(const StripeImage *image, ptrdiff_t row, size_t column, size_t rows, Patch *patch);

/* Second derivative down the columns of `count` pixels, in pairs of whole rows; the first as well, in whole rows. */
void bend_pixels(const Filter *filter, size_t count, Patch *patch);
void differentiate_pixels(const Filter *filter, size_t count, Patch *patch);

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
    float enough = params->continue_sigmas * noise;
    return enough > params->min_response ? enough : params->min_response;
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

typedef struct {
    int32_t columns, strong_columns;
} StripePiece;

/* Centres, piece after piece; there is room for all ridges of the kept pieces. */
typedef struct {
    double *position, *sigma, *peak; /* position: x and y */
    int64_t *piece;
    size_t count;
} Centers;

/* Partial sums, as a vector register holds them. */
enum { PARTS = 4 };

/* The columns of one piece: ridges, filter responses, centres, and scratch memory. */
typedef struct {
    size_t count;
    int32_t *x, *row;
    float *ridge_y, *half_width, *noise, *slope, *curvature;
    double *y, *variance, *peak, *square, *ratio;
} Columns;

/* Scatter of centres by second differences at a near lag, or at a far one if that is much larger. */
typedef struct {
    double sum;     /* of the squared differences over the variance expected from sensor noise */
    size_t count;   /* number of differences */
    size_t lag;     /* columns between the centres */
    int background; /* true for the far lag */
} Scatter;

Scatter scatter(Columns *columns);

/* Scatter of centres by second differences at a given lag. */
Scatter scatter_at(Columns *columns, size_t lag);

/* Mean of the terms of `Scatter.sum` (reduced chi-square), shrunk towards `expected`. */
double excess(Scatter of, double expected);

/* Variance of a centre according to the second differences. */
double scatter_variance(Columns *columns, Scatter of);

/* A measured piece: its scatter, and that with the filter matched to its width. */
typedef struct {
    Scatter of, first;
    size_t columns;
} PieceScatter;

/* Weighted median of the excess of all pieces; sorts them. 1 if there are none. */
double pooled_excess(PieceScatter *pieces, size_t count);

/* Raises the variances to the scatter around each column, shrunk towards that of the piece and of the frame. */
void raise_variances(Columns *columns, Scatter of, double pooled);

/* Each returns 0 if there is no memory. Runs come from the top in each block, ridges column by column from the top;
   `found` is scratch. */
int find_runs(const Noise *noise, const StripeParams *params, const Bands *bands, List *runs);
int find_ridges(const Noise *noise, const StripeParams *params, const List *runs, List *found, List *ridges);
int link_ridges(const StripeImage *image, const Filter *filter, const StripeParams *params, List *ridges, List *pieces);

/* Number of ridges in pieces that are long and strong enough. */
size_t kept_ridges(const StripeParams *params, const List *pieces);
int find_centers(const StripeImage *image, const Filter *filters, size_t filter_count, const StripeParams *params,
                 const List *ridges, const List *pieces, Centers *centers);

static inline size_t clamped(ptrdiff_t index, size_t size) {
    return index < 0 ? 0 : (size_t)index < size ? (size_t)index : size - 1;
}

/* True if rows of a block lie within the image. */
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
