/* Noise of the second derivative, clutter included; twin: reference_stripe_search.noise_figures.

   An area is so tall that stripes fill the lesser part of it; a low one of a few samples down it is free of them. */
#include "stripes.h"

#include <math.h>

/* Rows of a block, spread over the area; samples are a few columns of them. */
enum { STRIPS = 8, COLUMNS = 4, SAMPLES = STRIPS * BLOCK / COLUMNS, RANK = 6 };

/* Expected value of the sample of that rank for white noise with a response of 1. */
#define RANK_VALUE 0.542f

/* Standard deviation of rounding to whole grey values. */
#define ROUNDING_NOISE 0.289

/* Mean absolute responses of GROUP rows of a block, four columns each. */
static void sample(const Noise *noise, size_t row, size_t block, size_t first, float *value) {
    const StripeImage *image = noise->image;
    size_t rows = image->height - row < NOISE_ROWS ? image->height - row : NOISE_ROWS;
    size_t blocks = noise->blocks - block < NOISE_BLOCKS ? noise->blocks - block : NOISE_BLOCKS;
    size_t reach = noise->filter->reach;
    for (size_t i = 0; i < GROUP; i++) {
        ptrdiff_t middle = (ptrdiff_t)(row + (2 * (first + i) + 1) * rows / (2 * STRIPS));
        load_pixels(image, middle - (ptrdiff_t)reach, (block + (first + i) % blocks) * BLOCK, 2 * reach + 1,
                    GROUP * BLOCK, noise->patch->pixel + i * BLOCK);
    }
    bend_pixels(noise->filter, GROUP * BLOCK, GROUP * BLOCK, noise->patch);
    const float *bend = noise->patch->bend;
    for (size_t i = 0; i < GROUP * BLOCK / COLUMNS; i++, bend += COLUMNS)
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
