/* Small patches of the image, differentiated down the columns. */
#ifndef RINGPOSE_STRIPE_PATCHES_H
#define RINGPOSE_STRIPE_PATCHES_H

#include "kernels.h"

/* Columns that are processed together. */
enum { BLOCK = 16 };

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

/* Pixels of a block, from `reach` rows above the differentiated ones. A row is one cache line. */
typedef struct {
    float pixel[PATCH], curvature[PATCH], slope[PATCH];
} __attribute__((aligned(64))) Patch;

/* Loads rows of a block; beyond the border the outermost pixels are repeated. */
void load_pixels(const StripeImage *image, ptrdiff_t row, size_t column, size_t rows, Patch *patch);

/* Second derivative down the columns of `count` pixels, in pairs of whole rows; the first as well, in whole rows. */
void bend_pixels(const Filter *filter, size_t count, Patch *patch);
void differentiate_pixels(const Filter *filter, size_t count, Patch *patch);

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
