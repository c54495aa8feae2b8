/* Centres of speckled stripes, whose light scatters by a share of itself.

   Least squares, each row weighed by the inverse of its light's variance: the flanks say most. */
#include "stripe_columns.h"

#include <math.h>

#include "cholesky.h"

/* What is fitted to the rows about a centre: what lies beneath the stripe (a constant and a slope), how bright it is,
   and how far it lies off. The last two are wanted. */
enum { CONSTANT, SLOPE, BRIGHTNESS, OFFSET, SHAPES };

/* Rows on either side, in widths of the stripe: the outer ones show what lies beneath it. */
#define REACH_PER_WIDTH 5.0

/* Speckle over noise that is believed at most: the fainter the light that counts, the more a skewed section draws it.
   There are weights for that, and for a half, a quarter and an eighth of it. */
#define MOST_SPECKLE 12.0
enum { LEVELS = 4 };

/* And weights for some places of the centre in its pixel. */
enum { PHASES = 8 };

/* No centre moves farther at once, in pixels; where the last step would, there is none. So many more rows are read.
   After a short first step a second one changes nothing. */
#define LONGEST_STEP 0.75
#define SHORT_STEP 0.125
enum { SPARE_ROWS = 1 };

/* Rows from the upper or lower border from which on too little is missing to matter, in widths. */
#define WHOLE_WIDTHS 3.0

/* Rows at most, as vectors take them. */
enum { ROWS = (2 * MOST_REACH + PARTS) / PARTS * PARTS };

/* What weighs the rows, from `reach` above a centre's pixel on: a stripe's brightness, and how far it lies off times
   that. Behind the last row is nothing. */
typedef struct {
    size_t reach; /* 0: not yet known */
    double brightness[PHASES][ROWS], offset[PHASES][ROWS];
    double square; /* sum of the squares of the latter */
} Weights;

/* ---- weights ---- */

static double phase_offset(size_t phase) { return ((double)phase + 0.5) / PHASES - 0.5; }

/* A row of the inverse of the equations whose triangle this is. */
static void invert_row(double triangle[SHAPES][SHAPES], size_t row, double inverse[SHAPES]) {
    for (size_t i = 0; i < SHAPES; i++) inverse[i] = i == row;
    solve(triangle[0], SHAPES, inverse, 1);
}

/* What is fitted, each row weighed, for a stripe that lies off the middle row; and the equations. */
static void shape_rows(double width, double speckle, double offset, size_t reach, double shape[][SHAPES],
                       double equation[SHAPES][SHAPES]) {
    for (size_t k = 0; k <= 2 * reach; k++) {
        double off = (double)k - (double)reach - offset, u = off / width, light = exp(-0.5 * u * u);
        double of[SHAPES] = {1, off / (double)reach, light, light * u / width};
        double grains = speckle * light, weight = 1 / (1 + grains * grains);
        for (size_t i = 0; i < SHAPES; i++) {
            shape[k][i] = weight * of[i];
            for (size_t j = 0; j <= i; j++) equation[i][j] += shape[k][i] * of[j];
        }
    }
}

static double product(const double *inverse, const double *shape) {
    return (inverse[0] * shape[0] + inverse[1] * shape[1]) + (inverse[2] * shape[2] + inverse[3] * shape[3]);
}

/* Half of the places mirror the others. */
static void find_weights(double width, double speckle, size_t reach, Weights *weights) {
    double shape[2 * MOST_REACH + 1][SHAPES], brightness[SHAPES], offset[SHAPES];
    size_t last = 2 * reach;
    *weights = (Weights){.reach = reach};
    for (size_t j = 0, mirrored = PHASES - 1; j < mirrored; j++, mirrored--) {
        double equation[SHAPES][SHAPES] = {{0}};
        shape_rows(width, speckle, phase_offset(j), reach, shape, equation);
        factorised(equation[0], SHAPES);
        invert_row(equation, BRIGHTNESS, brightness);
        invert_row(equation, OFFSET, offset);
        for (size_t k = 0; k <= last; k++) {
            double off = product(offset, shape[k]);
            weights->offset[j][k] = off;
            weights->offset[mirrored][last - k] = -off;
            weights->brightness[j][k] = weights->brightness[mirrored][last - k] = product(brightness, shape[k]);
            weights->square += off * off / (PHASES / 2);
        }
    }
}

/* ---- centres ---- */

/* A product of rows and their weights. */
static double weighed_sum(const double *restrict weight, const double *restrict row, size_t rows) {
    double sum[PARTS] = {0};
    for (size_t k = 0; k < rows; k += PARTS)
        for (size_t j = 0; j < PARTS; j++) sum[j] += weight[k + j] * row[k + j];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* How far off the centre is that the rows from a pixel on show, at most LONGEST_STEP; that if they show no stripe. */
static double step_from(const Weights *weights, size_t phase, const float *pixel) {
    double row[ROWS];
    size_t rows = 2 * weights->reach + 1;
    for (size_t k = 0; k < rows; k++) row[k] = pixel[k * BLOCK];
    for (size_t k = rows; k % PARTS; k++) row[k] = 0;
    double light = weighed_sum(weights->brightness[phase], row, rows);
    double step = light > 0 ? weighed_sum(weights->offset[phase], row, rows) / light : LONGEST_STEP;
    return step < -LONGEST_STEP ? -LONGEST_STEP : step < LONGEST_STEP ? step : LONGEST_STEP;
}

/* Moves to the centre near y, in pixels whose first row is `top`. Returns by how much. */
static double step_to_center(const Weights *weights, const float *pixel, ptrdiff_t top, double *y) {
    double row = floor(*y + 0.5), place = (*y - row + 0.5) * PHASES;
    size_t phase = place < 1 ? 0 : place < PHASES ? (size_t)place : PHASES - 1;
    double step = step_from(weights, phase, pixel + ((ptrdiff_t)row - (ptrdiff_t)weights->reach - top) * BLOCK);
    *y = row + phase_offset(phase) + step;
    return fabs(step);
}

/* That centre; no number if there is none. */
static double weighed_center(const Weights *weights, const float *pixel, ptrdiff_t top, double y) {
    double step = step_to_center(weights, pixel, top, &y);
    if (step > SHORT_STEP) step = step_to_center(weights, pixel, top, &y);
    return step < LONGEST_STEP ? y : NAN;
}

/* How a piece's columns are weighed. */
typedef struct {
    const Measure *how;
    size_t reach;
    ptrdiff_t top;        /* first row of the pixels */
    double most_speckled; /* variance that noise makes of a centre whose stripe has MOST_SPECKLE */
    Weights weights[LEVELS];
} Weigher;

/* Of a noisy Gaussian ridge the filter lets through a share of what it lets through of noise: that, times the square of
   speckle over noise, is the excess. */
static double most_speckled(const Measure *how, Scatter of, const Columns *columns) {
    double width = how->width * how->width, share = width / (width + how->filter->sigma * how->filter->sigma);
    double precision = 0, square = (excess(of, 1) - 1) / (share * sqrt(share));
    for (size_t i = 0; i < columns->count; i++) precision += 1 / columns->variance[i];
    return square * (double)columns->count / (precision * MOST_SPECKLE * MOST_SPECKLE);
}

/* The weights for a column in which noise makes that variance. */
static const Weights *weights_of(Weigher *weigher, double variance) {
    double square = variance / weigher->most_speckled;
    size_t level = square < 2 ? 0 : square < 8 ? 1 : square < 32 ? 2 : LEVELS - 1;
    Weights *weights = weigher->weights + level;
    if (weights->reach == 0)
        find_weights(weigher->how->width, MOST_SPECKLE / (double)(1 << level), weigher->reach, weights);
    return weights;
}

/* Columns whose pixels lie in the patch, from the one on that lies leftmost. */
static void weigh_neighbours(Weigher *weigher, const Columns *columns, size_t first, size_t count, Columns *weighed) {
    double whole = WHOLE_WIDTHS * weigher->how->width, last = (double)weigher->how->image->height - 1 - whole;
    for (size_t i = first; i < first + count; i++) {
        const float *pixel = weigher->how->patch->pixel + (columns->x[i] - columns->x[first]);
        const Weights *weights = weights_of(weigher, columns->variance[i]);
        double y = weighed_center(weights, pixel, weigher->top, columns->y[i]);
        if (!(y >= whole && y <= last)) continue;
        weighed->x[weighed->count] = columns->x[i];
        weighed->y[weighed->count] = y;
        weighed->variance[weighed->count] = columns->variance[i];
        weighed->peak[weighed->count++] = columns->peak[i];
    }
}

/* From the filter's variances to those of the weights. */
static void turn_variances(Weigher *weigher, Columns *weighed) {
    double norm = weigher->how->filter->slope_norm * weigher->how->peak_per_response;
    for (size_t i = 0; i < weighed->count; i++)
        weighed->variance[i] *= weights_of(weigher, weighed->variance[i])->square / (norm * norm);
}

Scatter weigh_columns(const Measure *how, Scatter of, Columns *columns, Columns *weighed) {
    Weigher weigher = {.how = how, .most_speckled = most_speckled(how, of, columns)};
    size_t reach = (size_t)ceil(REACH_PER_WIDTH * how->width);
    weigher.reach = reach < MOST_REACH ? reach : MOST_REACH;
    weighed->count = 0;
    for (size_t i = 0; i < columns->count; i++) columns->row[i] = (int32_t)floor(columns->y[i] + 0.5);
    for (size_t first = 0, close; first < columns->count; first += close) {
        int32_t top, bottom;
        close = neighbours(columns, first, &top, &bottom);
        weigher.top = top - (ptrdiff_t)weigher.reach - SPARE_ROWS;
        size_t rows = (size_t)(bottom - top) + 1 + 2 * (weigher.reach + SPARE_ROWS);
        load_pixels(how->image, weigher.top, (size_t)columns->x[first], rows, how->patch);
        weigh_neighbours(&weigher, columns, first, close, weighed);
    }
    Scatter left = scatter_at(weighed, of.lag);
    turn_variances(&weigher, weighed);
    return left;
}
