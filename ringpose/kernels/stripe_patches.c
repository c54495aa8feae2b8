/* Small patches of the image, differentiated down the columns; twin: reference_stripe_patches.py. */
#include "stripes.h"

/* GNU C's vectors keep sums in registers: the compilers do not see that they may, in loops over 16 columns. */
typedef float Floats __attribute__((vector_size(32), aligned(4), may_alias));
enum { LANES = sizeof(Floats) / sizeof(float) };
#define FLOATS(address) (*(Floats *)(address))
#define FIXED_FLOATS(address) (*(const Floats *)(address))

/* Not unrolled, the loop over a block becomes vectors. */
#define LOAD_ROWS(name, Pixel, value)                                                                              \
    VECTOR_LOOP                                                                                                    \
    static void name(const Pixel *lit, const Pixel *dark, size_t width, size_t rows, size_t step, float *out) {    \
        (void)dark;                                                                                                \
        for (size_t y = 0; y < rows; y++) {                                                                        \
            const Pixel *restrict a = lit + y * width, *restrict b = dark ? dark + y * width : NULL;               \
            float *restrict to = out + y * step;                                                                   \
            (void)b;                                                                                               \
            _Pragma("GCC unroll 1") for (size_t i = 0; i < BLOCK; i++) to[i] = (float)(value);                     \
        }                                                                                                          \
    }

LOAD_ROWS(load_8, uint8_t, a[i])
LOAD_ROWS(load_16, uint16_t, a[i])
LOAD_ROWS(load_difference_8, uint8_t, a[i] - b[i])
LOAD_ROWS(load_difference_16, uint16_t, a[i] - b[i])

/* Where the block reaches beyond the border. */
static void load_border(const StripeImage *image, ptrdiff_t row, size_t column, size_t rows, size_t step, float *out) {
    for (size_t y = 0; y < rows; y++)
        for (size_t i = 0; i < BLOCK; i++) {
            size_t at = clamped(row + (ptrdiff_t)y, image->height), x = clamped((ptrdiff_t)(column + i), image->width);
            out[y * step + i] = pixel_at(image, at * image->width + x);
        }
}

void load_pixels(const StripeImage *image, ptrdiff_t row, size_t column, size_t rows, size_t step, float *out) {
    size_t width = image->width, at = (size_t)(row < 0 ? 0 : row) * width + column;
    const uint8_t *lit_8 = image->lit, *dark_8 = image->dark;
    const uint16_t *lit_16 = image->lit, *dark_16 = image->dark;
    if (row < 0 || (size_t)row + rows > image->height || column + BLOCK > width)
        load_border(image, row, column, rows, step, out);
    else if (image->wide && image->dark)
        load_difference_16(lit_16 + at, dark_16 + at, width, rows, step, out);
    else if (image->wide)
        load_16(lit_16 + at, NULL, width, rows, step, out);
    else if (image->dark)
        load_difference_8(lit_8 + at, dark_8 + at, width, rows, step, out);
    else
        load_8(lit_8 + at, NULL, width, rows, step, out);
}

VECTOR_LOOP
void bend_pixels(const Filter *filter, size_t step, size_t count, Patch *patch) {
    const float *tap = filter->bend, *middle = patch->pixel + filter->reach * step;
    for (size_t i = 0; i < count; i += 2 * LANES) {
        const float *up = middle + i, *down = up;
        Floats one = tap[0] * FIXED_FLOATS(up), two = tap[0] * FIXED_FLOATS(up + LANES);
        for (size_t k = 1; k <= filter->reach; k++) {
            up -= step;
            down += step;
            one += tap[k] * (FIXED_FLOATS(up) + FIXED_FLOATS(down));
            two += tap[k] * (FIXED_FLOATS(up + LANES) + FIXED_FLOATS(down + LANES));
        }
        FLOATS(patch->bend + i) = one;
        FLOATS(patch->bend + i + LANES) = two;
    }
}

VECTOR_LOOP
void differentiate_pixels(const Filter *filter, size_t step, size_t count, Patch *patch) {
    const float *even = filter->bend, *odd = filter->slope, *middle = patch->pixel + filter->reach * step;
    for (size_t i = 0; i < count; i += LANES) {
        const float *up = middle + i, *down = up;
        Floats bend = even[0] * FIXED_FLOATS(up), slope = {0};
        for (size_t k = 1; k <= filter->reach; k++) {
            up -= step;
            down += step;
            Floats above = FIXED_FLOATS(up), below = FIXED_FLOATS(down);
            bend += even[k] * (above + below);
            slope += odd[k] * (below - above);
        }
        FLOATS(patch->bend + i) = bend;
        FLOATS(patch->slope + i) = slope;
    }
}
