/* Small patches of the image, differentiated down the columns. */
#include "stripe_patches.h"

#include <string.h>

/* GNU C vectors keep the sums over 16 columns in registers, which compilers do not do by themselves. */
enum { LANES = 8 };
typedef float Floats __attribute__((vector_size(4 * LANES), aligned(4), may_alias));
#define FLOATS(address) (*(Floats *)(address))

/* Rows of a block in whole numbers. */
enum { MAX_ROWS = CHUNK + 2 + 2 * MAX_REACH };

/* Rows are gathered first: a single loop over all of them is vectorised better. */
#define LOAD(name, Pixel)                                                                                          \
    VECTOR_LOOP                                                                                                    \
    static void name(const StripeImage *image, size_t at, size_t rows, float *restrict out) {                      \
        Pixel lit[MAX_ROWS * BLOCK], dark[MAX_ROWS * BLOCK];                                                       \
        for (size_t y = 0; y < rows; y++, at += image->width) {                                                    \
            memcpy(lit + y * BLOCK, (const Pixel *)image->lit + at, BLOCK * sizeof *lit);                          \
            if (image->dark) memcpy(dark + y * BLOCK, (const Pixel *)image->dark + at, BLOCK * sizeof *dark);      \
        }                                                                                                          \
        if (image->dark)                                                                                           \
            for (size_t i = 0; i < rows * BLOCK; i++) out[i] = (float)(lit[i] - dark[i]);                          \
        else                                                                                                       \
            for (size_t i = 0; i < rows * BLOCK; i++) out[i] = (float)lit[i];                                      \
    }

LOAD(load_8, uint8_t)
LOAD(load_16, uint16_t)

/* Where the block reaches beyond the border. */
static void load_border(const StripeImage *image, ptrdiff_t row, size_t column, size_t rows, float *out) {
    for (size_t y = 0; y < rows; y++)
        for (size_t i = 0; i < BLOCK; i++) {
            size_t at = clamped(row + (ptrdiff_t)y, image->height), x = clamped((ptrdiff_t)(column + i), image->width);
            out[y * BLOCK + i] = pixel_at(image, at * image->width + x);
        }
}

void load_pixels(const StripeImage *image, ptrdiff_t row, size_t column, size_t rows, Patch *patch) {
    if (!is_inside(image, row, column, rows))
        load_border(image, row, column, rows, patch->pixel);
    else
        (image->wide ? load_16 : load_8)(image, (size_t)row * image->width + column, rows, patch->pixel);
}

/* Two rows share what lies above the one and below the other. */
VECTOR_LOOP
void bend_pixels(const Filter *filter, size_t count, Patch *patch) {
    const float *tap = filter->curvature, *middle = patch->pixel + filter->reach * BLOCK;
    for (size_t i = 0; i < count; i += i % BLOCK + LANES < BLOCK ? LANES : BLOCK + LANES) {
        const float *top = middle + i, *bottom = top + BLOCK;
        Floats above = FLOATS(top), below = FLOATS(bottom), one = tap[0] * above, two = tap[0] * below;
        for (size_t k = 1; k <= filter->reach; k++) {
            top -= BLOCK;
            bottom += BLOCK;
            Floats next_above = FLOATS(top), next_below = FLOATS(bottom);
            one += tap[k] * (next_above + below);
            two += tap[k] * (above + next_below);
            above = next_above;
            below = next_below;
        }
        FLOATS(patch->curvature + i) = one;
        FLOATS(patch->curvature + i + BLOCK) = two;
    }
}

VECTOR_LOOP
void differentiate_pixels(const Filter *filter, size_t count, Patch *patch) {
    const float *even = filter->curvature, *odd = filter->slope, *middle = patch->pixel + filter->reach * BLOCK;
    for (size_t i = 0; i < count; i += LANES) {
        const float *up = middle + i, *down = up;
        Floats curvature = even[0] * FLOATS(up), slope = {0};
        for (size_t k = 1; k <= filter->reach; k++) {
            up -= BLOCK;
            down += BLOCK;
            Floats above = FLOATS(up), below = FLOATS(down);
            curvature += even[k] * (above + below);
            slope += odd[k] * (below - above);
        }
        FLOATS(patch->curvature + i) = curvature;
        FLOATS(patch->slope + i) = slope;
    }
}
