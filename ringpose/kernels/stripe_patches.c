/* Small patches of the image, differentiated down the columns; twin: reference_stripe_patches.py. */
#include "stripes.h"

#include <string.h>

/* GNU C's vectors keep sums in registers: the compilers do not see that they may, in loops over 16 columns. */
typedef float Floats __attribute__((vector_size(32), aligned(4), may_alias));
enum { LANES = sizeof(Floats) / sizeof(float) };
#define FLOATS(address) (*(Floats *)(address))
#define FIXED_FLOATS(address) (*(const Floats *)(address))

/* Rows of a block in whole numbers. */
enum { MOST_ROWS = CHUNK + 2 + 2 * MOST_REACH };

#define NUMBERS(name, Pixel, value)                                                                                \
    VECTOR_LOOP                                                                                                    \
    static void name(const Pixel *restrict lit, const Pixel *restrict dark, size_t count, float *restrict out) {   \
        (void)dark;                                                                                                \
        for (size_t i = 0; i < count; i++) out[i] = (float)(value);                                                \
    }

NUMBERS(numbers_8, uint8_t, lit[i])
NUMBERS(numbers_16, uint16_t, lit[i])
NUMBERS(differences_8, uint8_t, lit[i] - dark[i])
NUMBERS(differences_16, uint16_t, lit[i] - dark[i])

/* Rows of a block below each other. */
static void gather_8(const uint8_t *restrict pixels, size_t width, size_t rows, uint8_t *restrict out) {
    for (size_t y = 0; y < rows; y++) memcpy(out + y * BLOCK, pixels + y * width, BLOCK);
}

static void gather_16(const uint16_t *restrict pixels, size_t width, size_t rows, uint16_t *restrict out) {
    for (size_t y = 0; y < rows; y++) memcpy(out + y * BLOCK, pixels + y * width, BLOCK * sizeof *out);
}

static void load_8(const uint8_t *lit, const uint8_t *dark, size_t width, size_t rows, float *out) {
    uint8_t pixels[2][MOST_ROWS * BLOCK];
    gather_8(lit, width, rows, pixels[0]);
    if (dark) {
        gather_8(dark, width, rows, pixels[1]);
        differences_8(pixels[0], pixels[1], rows * BLOCK, out);
    } else {
        numbers_8(pixels[0], NULL, rows * BLOCK, out);
    }
}

static void load_16(const uint16_t *lit, const uint16_t *dark, size_t width, size_t rows, float *out) {
    uint16_t pixels[2][MOST_ROWS * BLOCK];
    gather_16(lit, width, rows, pixels[0]);
    if (dark) {
        gather_16(dark, width, rows, pixels[1]);
        differences_16(pixels[0], pixels[1], rows * BLOCK, out);
    } else {
        numbers_16(pixels[0], NULL, rows * BLOCK, out);
    }
}

/* Where the block reaches beyond the border. */
static void load_border(const StripeImage *image, ptrdiff_t row, size_t column, size_t rows, float *out) {
    for (size_t y = 0; y < rows; y++)
        for (size_t i = 0; i < BLOCK; i++) {
            size_t at = clamped(row + (ptrdiff_t)y, image->height), x = clamped((ptrdiff_t)(column + i), image->width);
            out[y * BLOCK + i] = pixel_at(image, at * image->width + x);
        }
}

void load_pixels(const StripeImage *image, ptrdiff_t row, size_t column, size_t rows, Patch *patch) {
    size_t width = image->width, at = (size_t)(row < 0 ? 0 : row) * width + column;
    if (!is_inside(image, row, column, rows))
        load_border(image, row, column, rows, patch->pixel);
    else if (image->wide)
        load_16((const uint16_t *)image->lit + at, image->dark ? (const uint16_t *)image->dark + at : NULL, width, rows,
                patch->pixel);
    else
        load_8((const uint8_t *)image->lit + at, image->dark ? (const uint8_t *)image->dark + at : NULL, width, rows,
               patch->pixel);
}

/* Two rows share what lies above the one and below the other. */
VECTOR_LOOP
void bend_pixels(const Filter *filter, size_t count, Patch *patch) {
    const float *tap = filter->bend, *middle = patch->pixel + filter->reach * BLOCK;
    for (size_t i = 0; i < count; i += i % BLOCK + LANES < BLOCK ? LANES : BLOCK + LANES) {
        const float *top = middle + i, *bottom = top + BLOCK;
        Floats above = FIXED_FLOATS(top), below = FIXED_FLOATS(bottom);
        Floats one = tap[0] * above, two = tap[0] * below;
        for (size_t k = 1; k <= filter->reach; k++) {
            top -= BLOCK;
            bottom += BLOCK;
            Floats next_above = FIXED_FLOATS(top), next_below = FIXED_FLOATS(bottom);
            one += tap[k] * (next_above + below);
            two += tap[k] * (above + next_below);
            above = next_above;
            below = next_below;
        }
        FLOATS(patch->bend + i) = one;
        FLOATS(patch->bend + i + BLOCK) = two;
    }
}

VECTOR_LOOP
void differentiate_pixels(const Filter *filter, size_t count, Patch *patch) {
    const float *even = filter->bend, *odd = filter->slope, *middle = patch->pixel + filter->reach * BLOCK;
    for (size_t i = 0; i < count; i += LANES) {
        const float *up = middle + i, *down = up;
        Floats bend = even[0] * FIXED_FLOATS(up), slope = {0};
        for (size_t k = 1; k <= filter->reach; k++) {
            up -= BLOCK;
            down += BLOCK;
            Floats above = FIXED_FLOATS(up), below = FIXED_FLOATS(down);
            bend += even[k] * (above + below);
            slope += odd[k] * (below - above);
        }
        FLOATS(patch->bend + i) = bend;
        FLOATS(patch->slope + i) = slope;
    }
}
