/* Sub-pixel centres of one piece. */
#include "stripe_columns.h"

#include <math.h>
#include <stdlib.h>

/* A centre farther than this from its pixel is looked for again from the pixel nearest to it. */
#define NEAR_PX 1.0
enum { ROUNDS = 2 };

/* And one this far from where the ridge was is none. */
#define STRAYED_PX 2.5

/* Nearer to the upper or lower border than so many sigmas of the stripe's response a centre is drawn to it: rows beyond
   are taken as the outermost one. From here on by less than a hundredth of the stripe's sigma. */
#define WHOLE_SPREADS 1.5

/* Rows that are worked on together. */
enum { MOST_ROWS = 6 };

void *allocate_columns(Columns *columns, size_t count) {
    size_t n = count + PARTS;
    double *value = malloc(n * (5 * sizeof(double) + 5 * sizeof(float) + 2 * sizeof(int32_t)));
    if (value == NULL) return NULL;
    double **doubles[] = {&columns->y, &columns->variance, &columns->peak, &columns->square, &columns->ratio};
    float **floats[] = {&columns->ridge_y, &columns->half_width, &columns->noise, &columns->slope, &columns->bend};
    for (size_t i = 0; i < 5; i++) *doubles[i] = value + i * n;
    for (size_t i = 0; i < 5; i++) *floats[i] = (float *)(void *)(value + 5 * n) + i * n;
    columns->x = (int32_t *)(void *)(columns->bend + n);
    columns->row = columns->x + n;
    return value;
}

void take_ridges(const Ridge *ridges, const int32_t *order, size_t count, Columns *columns) {
    columns->count = count;
    for (size_t i = 0; i < count; i++) {
        const Ridge *ridge = ridges + order[i];
        columns->x[i] = ridge->x;
        columns->row[i] = ridge->row;
        columns->ridge_y[i] = ridge->y;
        columns->noise[i] = ridge->noise;
        columns->half_width[i] = ridge->bend < 0 ? -ridge->bend : 0;
    }
}

/* Both derivatives in rows of 16 columns. */
static void differentiate(const Measure *how, ptrdiff_t row, size_t x, size_t rows) {
    size_t reach = how->filter->reach;
    load_pixels(how->image, row - (ptrdiff_t)reach, x, rows + 2 * reach, how->patch);
    differentiate_pixels(how->filter, rows * BLOCK, how->patch);
}

size_t neighbours(const Columns *columns, size_t first, int32_t *top, int32_t *bottom) {
    const int32_t *row = columns->row + first, *x = columns->x + first;
    size_t count = columns->count - first, i = 1;
    *top = *bottom = row[0];
    for (; i < count && x[i] < x[0] + BLOCK; i++) {
        int32_t above = row[i] < *top ? row[i] : *top, below = row[i] > *bottom ? row[i] : *bottom;
        if (below - above >= MOST_ROWS) break;
        *top = above;
        *bottom = below;
    }
    return i;
}

static void differentiate_all(const Measure *how, Columns *columns) {
    for (size_t first = 0, close; first < columns->count; first += close) {
        int32_t top, bottom, left = columns->x[first];
        close = neighbours(columns, first, &top, &bottom);
        differentiate(how, top, (size_t)left, (size_t)(bottom - top + 1));
        for (size_t i = first; i < first + close; i++) {
            int32_t at = (columns->row[i] - top) * BLOCK + (columns->x[i] - left);
            columns->slope[i] = how->patch->slope[at];
            columns->bend[i] = how->patch->bend[at];
        }
    }
}

/* From the pixel to the zero of the first derivative of a Gaussian ridge: 2 t / (1 + sqrt(1 + 4 t^2 / S^2)), where t is
   Newton's step, as a quotient of polynomials that is within 1e-4 px. No ridge: a variance of nothing. Returns how many
   columns are not so easily done. */
static int64_t step_to_centers(const Measure *how, size_t from, size_t to, Columns *columns) {
    const int32_t *restrict row = columns->row;
    const float *restrict slope = columns->slope, *restrict bend = columns->bend, *restrict noise = columns->noise;
    double *restrict y = columns->y, *restrict variance = columns->variance, *restrict peak = columns->peak;
    double inverse_spread = how->inverse_spread, per_noise = how->sigma_per_noise;
    double per_response = how->peak_per_response, top = how->whole, bottom = (double)how->image->height - 1 - top;
    int64_t odd = 0;
    for (size_t i = from; i < to; i++) {
        double curve = bend[i], fall = curve < 0 ? -curve : 1;
        double newton = slope[i] / fall, q = newton * newton * inverse_spread;
        double step = newton * (1 + 3 * q + q * q) / (1 + 4 * q + 3 * q * q);
        double crest = fall * (1 + 1.5 * step * step * inverse_spread);
        double sigma = per_noise * noise[i] / crest;
        y[i] = row[i] + step;
        variance[i] = curve < 0 ? sigma * sigma : 0;
        peak[i] = crest * per_response;
        odd += (curve >= 0) | (step > NEAR_PX) | (step < -NEAR_PX) | (y[i] < top) | (y[i] > bottom);
    }
    return odd;
}

/* Moves on to the pixels nearest to a centre. */
static void step_again(const Measure *how, size_t i, Columns *columns) {
    for (int round = 0; round < ROUNDS && fabs(columns->y[i] - columns->row[i]) > NEAR_PX; round++) {
        double nearest = floor(columns->y[i] + 0.5), last = (double)(how->image->height - 1);
        columns->row[i] = (int32_t)(nearest < 0 ? 0 : nearest < last ? nearest : last);
        differentiate(how, columns->row[i], (size_t)columns->x[i], 1);
        columns->slope[i] = how->patch->slope[0];
        columns->bend[i] = how->patch->bend[0];
        step_to_centers(how, i, i + 1, columns);
        if (columns->variance[i] == 0) return;
    }
}

double whole_from(const Filter *filter, double width) { return WHOLE_SPREADS * hypot(filter->sigma, width); }

/* Whether a column shows a ridge near by, and the whole of it. */
static int is_center(const Measure *how, size_t i, const Columns *columns) {
    double y = columns->y[i], bottom = (double)how->image->height - 1 - how->whole;
    double strayed = fabs(y - columns->ridge_y[i]);
    return columns->variance[i] > 0 && strayed < STRAYED_PX + columns->half_width[i] && y >= how->whole && y <= bottom;
}

void measure_columns(const Measure *how, Columns *columns) {
    size_t kept = 0;
    differentiate_all(how, columns);
    if (!step_to_centers(how, 0, columns->count, columns)) return;
    for (size_t i = 0; i < columns->count; i++) {
        if (columns->variance[i] == 0) continue;
        if (fabs(columns->y[i] - columns->row[i]) > NEAR_PX) step_again(how, i, columns);
        if (!is_center(how, i, columns)) continue;
        columns->x[kept] = columns->x[i];
        columns->y[kept] = columns->y[i];
        columns->variance[kept] = columns->variance[i];
        columns->peak[kept++] = columns->peak[i];
    }
    columns->count = kept;
}
