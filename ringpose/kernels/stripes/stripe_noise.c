/* Noise of the second derivative, clutter included.

   An area is so tall that stripes fill the lesser part of it; a low one of a few samples down it is free of them. */
#include "stripes.h"

#include <math.h>

/* Rows of a block, spread over the area, some of them worked on together; samples are a few columns of them. */
enum { STRIPS = 8, GROUP = 4, PIXELS = GROUP * BLOCK };
enum { COLUMNS = 4, SAMPLES = STRIPS * BLOCK / COLUMNS, RANK = 6 };

/* Expected value of the sample of that rank for white noise with a response of 1. */
#define RANK_VALUE 0.542f

/* Standard deviation of rounding to whole grey values. */
#define ROUNDING_NOISE 0.289

/* Sums of the pixels that one tap of the filter weighs, as far above a row as below it; numbers so small are exact.
   Not unrolled, the loop over a block becomes vectors. */
#define FOLD(name, Pixel, value)                                                                                   \
    VECTOR_LOOP                                                                                                    \
    static void name(const Pixel *restrict lit, const Pixel *restrict dark, size_t reach, size_t width,            \
                     float *restrict out) {                                                                        \
        (void)dark;                                                                                                \
        for (size_t k = 0, up = reach * width, down = up; k <= reach; k++, up -= width, down += width)             \
            _Pragma("GCC unroll 1") for (size_t i = 0; i < BLOCK; i++)                                             \
                out[k * PIXELS + i] = (float)(value);                                                              \
    }

FOLD(fold_8, uint8_t, lit[up + i] + lit[down + i])
FOLD(fold_16, uint16_t, lit[up + i] + lit[down + i])
FOLD(fold_differences_8, uint8_t, (lit[up + i] - dark[up + i]) + (lit[down + i] - dark[down + i]))
FOLD(fold_differences_16, uint16_t, (lit[up + i] - dark[up + i]) + (lit[down + i] - dark[down + i]))

static void fold_border(const StripeImage *image, ptrdiff_t middle, size_t column, size_t reach, float *out) {
    for (size_t k = 0; k <= reach; k++) {
        size_t up = clamped(middle - (ptrdiff_t)k, image->height), down = clamped(middle + (ptrdiff_t)k, image->height);
        for (size_t i = 0; i < BLOCK; i++) {
            size_t x = clamped((ptrdiff_t)(column + i), image->width);
            out[k * PIXELS + i] = pixel_at(image, up * image->width + x) + pixel_at(image, down * image->width + x);
        }
    }
}

static void fold(const StripeImage *image, ptrdiff_t middle, size_t column, size_t reach, float *out) {
    ptrdiff_t top = middle - (ptrdiff_t)reach;
    size_t width = image->width, at = (size_t)(top < 0 ? 0 : top) * width + column;
    const uint8_t *lit_8 = image->lit, *dark_8 = image->dark;
    const uint16_t *lit_16 = image->lit, *dark_16 = image->dark;
    if (!is_inside(image, top, column, 2 * reach + 1))
        fold_border(image, middle, column, reach, out);
    else if (image->wide && image->dark)
        fold_differences_16(lit_16 + at, dark_16 + at, reach, width, out);
    else if (image->wide)
        fold_16(lit_16 + at, NULL, reach, width, out);
    else if (image->dark)
        fold_differences_8(lit_8 + at, dark_8 + at, reach, width, out);
    else
        fold_8(lit_8 + at, NULL, reach, width, out);
    for (size_t i = 0; i < BLOCK; i++) out[i] *= 0.5f; /* the middle counts once */
}

/* Second derivative. */
VECTOR_LOOP
static void bend_folded(const Filter *filter, const float *restrict folded, float *restrict bend) {
    const float *restrict tap = filter->bend;
    for (size_t i = 0; i < PIXELS; i++) bend[i] = tap[0] * folded[i];
    for (size_t k = 1; k <= filter->reach; k++)
        for (size_t i = 0; i < PIXELS; i++) bend[i] += tap[k] * folded[k * PIXELS + i];
}

/* Mean absolute responses of GROUP rows of a block, four columns each. */
static void sample(const Noise *noise, size_t row, size_t block, size_t first, float *value) {
    const StripeImage *image = noise->image;
    size_t rows = image->height - row < NOISE_ROWS ? image->height - row : NOISE_ROWS;
    size_t blocks = noise->blocks - block < NOISE_BLOCKS ? noise->blocks - block : NOISE_BLOCKS;
    float folded[(MOST_REACH + 1) * PIXELS] __attribute__((aligned(64))), all[PIXELS], *bend = all;
    for (size_t i = 0; i < GROUP; i++) {
        ptrdiff_t middle = (ptrdiff_t)(row + (2 * (first + i) + 1) * rows / (2 * STRIPS));
        fold(image, middle, (block + (first + i) % blocks) * BLOCK, noise->filter->reach, folded + i * BLOCK);
    }
    bend_folded(noise->filter, folded, bend);
    for (size_t i = 0; i < PIXELS / COLUMNS; i++, bend += COLUMNS)
        value[i] = ((fabsf(bend[0]) + fabsf(bend[1])) + (fabsf(bend[2]) + fabsf(bend[3]))) / COLUMNS;
}

/* The sample of that rank: the largest of which no more than so many are smaller. Counting needs no branches. */
VECTOR_LOOP
static float ranked(const float *restrict value) {
    int32_t smaller[SAMPLES] = {0};
    float found = 0;
    for (size_t j = 0; j < SAMPLES; j++)
        for (size_t i = 0; i < SAMPLES; i++) smaller[i] += value[j] < value[i];
    for (size_t i = 0; i < SAMPLES; i++) found = smaller[i] <= RANK && value[i] > found ? value[i] : found;
    return found;
}

static float area_noise(const Noise *noise, size_t area) {
    size_t row = area / noise->areas_across * NOISE_ROWS, block = area % noise->areas_across * NOISE_BLOCKS;
    float value[SAMPLES];
    for (size_t i = 0; i < STRIPS; i += GROUP) sample(noise, row, block, i, value + i * BLOCK / COLUMNS);
    float rounding = (float)(ROUNDING_NOISE * noise->filter->bend_norm), figure = ranked(value) / RANK_VALUE;
    return figure > rounding ? figure : rounding;
}

float noise_at(const Noise *noise, size_t row, size_t block) {
    size_t area = row / NOISE_ROWS * noise->areas_across + block / NOISE_BLOCKS;
    if (noise->figure[area] < 0) noise->figure[area] = area_noise(noise, area);
    return noise->figure[area];
}
