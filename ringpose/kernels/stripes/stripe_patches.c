/* Small patches of the image, differentiated down the columns. */
#include "stripes.h"

#include <string.h>

/* GNU C vectors keep the sums over 16 columns in registers, which compilers do not do by themselves. There is a version
   for each vector size; the one that the processor supports is selected at run time. */
typedef float FourFloats __attribute__((vector_size(16), aligned(4), may_alias));
typedef float EightFloats __attribute__((vector_size(32), aligned(4), may_alias));
#if defined(__x86_64__) && !defined(RINGPOSE_PORTABLE)
#define HAS_EIGHT __builtin_cpu_supports("avx2")
#define WITH_EIGHT __attribute__((target("avx2")))
#else
#define HAS_EIGHT 0
#define WITH_EIGHT
#endif

/* Rows of a block in whole numbers. */
enum { MAX_ROWS = CHUNK + 2 + 2 * MAX_REACH };

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
    uint8_t pixels[2][MAX_ROWS * BLOCK];
    gather_8(lit, width, rows, pixels[0]);
    if (dark) {
        gather_8(dark, width, rows, pixels[1]);
        differences_8(pixels[0], pixels[1], rows * BLOCK, out);
    } else {
        numbers_8(pixels[0], NULL, rows * BLOCK, out);
    }
}

static void load_16(const uint16_t *lit, const uint16_t *dark, size_t width, size_t rows, float *out) {
    uint16_t pixels[2][MAX_ROWS * BLOCK];
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
#define BEND(name, Floats)                                                                                         \
    static void name(const Filter *filter, size_t count, Patch *patch) {                                           \
        const size_t lanes = sizeof(Floats) / sizeof(float);                                                       \
        const float *tap = filter->curvature, *middle = patch->pixel + filter->reach * BLOCK;                      \
        for (size_t i = 0; i < count; i += i % BLOCK + lanes < BLOCK ? lanes : BLOCK + lanes) {                    \
            const float *top = middle + i, *bottom = top + BLOCK;                                                  \
            Floats above = *(const Floats *)top, below = *(const Floats *)bottom;                                  \
            Floats one = tap[0] * above, two = tap[0] * below;                                                     \
            for (size_t k = 1; k <= filter->reach; k++) {                                                          \
                top -= BLOCK;                                                                                      \
                bottom += BLOCK;                                                                                   \
                Floats next_above = *(const Floats *)top, next_below = *(const Floats *)bottom;                    \
                one += tap[k] * (next_above + below);                                                              \
                two += tap[k] * (above + next_below);                                                              \
                above = next_above;                                                                                \
                below = next_below;                                                                                \
            }                                                                                                      \
            *(Floats *)(patch->curvature + i) = one;                                                               \
            *(Floats *)(patch->curvature + i + BLOCK) = two;                                                       \
        }                                                                                                          \
    }

#define DIFFERENTIATE(name, Floats)                                                                                \
    static void name(const Filter *filter, size_t count, Patch *patch) {                                           \
        const float *even = filter->curvature, *odd = filter->slope;                                               \
        const float *middle = patch->pixel + filter->reach * BLOCK;                                                \
        for (size_t i = 0; i < count; i += sizeof(Floats) / sizeof(float)) {                                       \
            const float *up = middle + i, *down = up;                                                              \
            Floats curvature = even[0] * *(const Floats *)up, slope = {0};                                         \
            for (size_t k = 1; k <= filter->reach; k++) {                                                          \
                up -= BLOCK;                                                                                       \
                down += BLOCK;                                                                                     \
                Floats above = *(const Floats *)up, below = *(const Floats *)down;                                 \
                curvature += even[k] * (above + below);                                                            \
                slope += odd[k] * (below - above);                                                                 \
            }                                                                                                      \
            *(Floats *)(patch->curvature + i) = curvature;                                                         \
            *(Floats *)(patch->slope + i) = slope;                                                                 \
        }                                                                                                          \
    }

BEND(bend_by_four, FourFloats)
DIFFERENTIATE(differentiate_by_four, FourFloats)
WITH_EIGHT BEND(bend_by_eight, EightFloats)
WITH_EIGHT DIFFERENTIATE(differentiate_by_eight, EightFloats)

void bend_pixels(const Filter *filter, size_t count, Patch *patch) {
    (HAS_EIGHT ? bend_by_eight : bend_by_four)(filter, count, patch);
}

void differentiate_pixels(const Filter *filter, size_t count, Patch *patch) {
    (HAS_EIGHT ? differentiate_by_eight : differentiate_by_four)(filter, count, patch);
}
