/* Sub-pixel centres with variances of linked ridges: zero of the first derivative of a matched Gaussian filter; on
   speckled stripes, whose noise is proportional to the light, weighted least squares, in which the flanks have the
   largest weight. */
#include "stripe_centers.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "stripe_sigmas.h"

/* A filter for a stripe of that width (sigma), or for a flat top (0). */
typedef struct {
    const StripeImage *image;
    Patch *patch;
    const Filter *filter;
    double width, inverse_spread; /* inverse_spread: 1 / sigma^2 of the response; 0 for a flat top */
    double peak_per_response, sigma_per_noise;
    double whole; /* distance from the upper or lower border from which on the stripe is complete */
} Measure;

/* A centre farther than this from its pixel is looked for again from the pixel nearest to it. */
#define NEAR_PX 1.0
enum { ROUNDS = 2 };

/* A centre farther than this from its ridge is rejected. */
#define STRAYED_PX 2.5

/* Distance from the upper or lower border, in sigmas of the response, from which on replicating the outermost row
   biases a centre by less than 0.01 sigma of the stripe. */
#define WHOLE_SPREADS 1.5

/* Rows that are worked on together. */
enum { MAX_ROWS = 6 };

/* Memory for this number of columns; NULL if there is none. */
static void *allocate_columns(Columns *columns, size_t count) {
    size_t n = count + PARTS;
    double *value = malloc(n * (5 * sizeof(double) + 5 * sizeof(float) + 2 * sizeof(int32_t)));
    if (value == NULL) return NULL;
    double **doubles[] = {&columns->y, &columns->variance, &columns->peak, &columns->square, &columns->ratio};
    float **floats[] = {&columns->ridge_y, &columns->half_width, &columns->noise, &columns->slope, &columns->curvature};
    for (size_t i = 0; i < 5; i++) *doubles[i] = value + i * n;
    for (size_t i = 0; i < 5; i++) *floats[i] = (float *)(void *)(value + 5 * n) + i * n;
    columns->x = (int32_t *)(void *)(columns->curvature + n);
    columns->row = columns->x + n;
    return value;
}

static void take_ridges(const Ridge *ridges, const int32_t *order, size_t count, Columns *columns) {
    columns->count = count;
    for (size_t i = 0; i < count; i++) {
        const Ridge *ridge = ridges + order[i];
        columns->x[i] = ridge->x;
        columns->row[i] = ridge->row;
        columns->ridge_y[i] = ridge->y;
        columns->noise[i] = ridge->noise;
        columns->half_width[i] = ridge->curvature < 0 ? -ridge->curvature : 0;
    }
}

/* Both derivatives in rows of 16 columns, from column x on. */
static void differentiate(const Measure *how, ptrdiff_t row, size_t x, size_t rows) {
    size_t reach = how->filter->reach;
    load_pixels(how->image, row - (ptrdiff_t)reach, x, rows + 2 * reach, how->patch);
    differentiate_pixels(how->filter, rows * BLOCK, how->patch);
}

/* Number of columns from `first` on whose rows are near enough to be processed together; sets their outermost rows. */
static size_t neighbours(const Columns *columns, size_t first, int32_t *top, int32_t *bottom) {
    const int32_t *row = columns->row + first, *x = columns->x + first;
    size_t count = columns->count - first, i = 1;
    *top = *bottom = row[0];
    for (; i < count && x[i] < x[0] + BLOCK; i++) {
        int32_t above = row[i] < *top ? row[i] : *top, below = row[i] > *bottom ? row[i] : *bottom;
        if (below - above >= MAX_ROWS) break;
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
            columns->curvature[i] = how->patch->curvature[at];
        }
    }
}

/* Step from the pixel to the zero of the first derivative of a Gaussian ridge: 2 t / (1 + sqrt(1 + 4 t^2 / S^2)), where
   t is the Newton step, approximated by a rational function to 1e-4 px. The variance is 0 if there is no ridge. Returns
   the number of columns that need a second look. */
static int64_t newton_steps(const Measure *how, size_t from, size_t to, Columns *columns) {
    const int32_t *restrict row = columns->row;
    const float *restrict slope = columns->slope, *restrict curvature = columns->curvature;
    const float *restrict noise = columns->noise;
    double *restrict y = columns->y, *restrict variance = columns->variance, *restrict peak = columns->peak;
    double inverse_spread = how->inverse_spread, per_noise = how->sigma_per_noise;
    double per_response = how->peak_per_response, top = how->whole, bottom = (double)how->image->height - 1 - top;
    int64_t irregular = 0;
    for (size_t i = from; i < to; i++) {
        double second = curvature[i], sharpness = second < 0 ? -second : 1;
        double newton = slope[i] / sharpness, q = newton * newton * inverse_spread;
        double step = newton * (1 + 3 * q + q * q) / (1 + 4 * q + 3 * q * q);
        double peak_value = sharpness * (1 + 1.5 * step * step * inverse_spread);
        double sigma = per_noise * noise[i] / peak_value;
        y[i] = row[i] + step;
        variance[i] = second < 0 ? sigma * sigma : 0;
        peak[i] = peak_value * per_response;
        irregular += (second >= 0) | (step > NEAR_PX) | (step < -NEAR_PX) | (y[i] < top) | (y[i] > bottom);
    }
    return irregular;
}

/* Repeats the Newton step from the pixel nearest to the centre, until the centre lies near its pixel. */
static void step_again(const Measure *how, size_t i, Columns *columns) {
    for (int round = 0; round < ROUNDS && fabs(columns->y[i] - columns->row[i]) > NEAR_PX; round++) {
        double nearest = floor(columns->y[i] + 0.5), last = (double)(how->image->height - 1);
        columns->row[i] = (int32_t)(nearest < 0 ? 0 : nearest < last ? nearest : last);
        differentiate(how, columns->row[i], (size_t)columns->x[i], 1);
        columns->slope[i] = how->patch->slope[0];
        columns->curvature[i] = how->patch->curvature[0];
        newton_steps(how, i, i + 1, columns);
        if (columns->variance[i] == 0) return;
    }
}

/* True if a column has a complete stripe near its ridge. */
static int is_center(const Measure *how, size_t i, const Columns *columns) {
    double y = columns->y[i], bottom = (double)how->image->height - 1 - how->whole;
    double deviation = fabs(y - columns->ridge_y[i]);
    return columns->variance[i] > 0 && deviation < STRAYED_PX + columns->half_width[i] && y >= how->whole &&
           y <= bottom;
}

/* The centres, with the variances that the sensor's noise explains; columns in which the filter sees no ridge near by
   are dropped. */
static void measure_columns(const Measure *how, Columns *columns) {
    size_t kept = 0;
    differentiate_all(how, columns);
    if (!newton_steps(how, 0, columns->count, columns)) return;
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

/* Unknowns of the fit to the rows about a centre: background (constant and slope), amplitude and offset. */
enum { CONSTANT, SLOPE, BRIGHTNESS, OFFSET, SHAPES };

/* There are weights for the largest ratio of speckle to noise, a half, a quarter and an eighth of it. */
enum { LEVELS = 4 };

/* Weights are tabulated for this many positions of the centre within its pixel. */
enum { PHASES = 8 };

/* Largest step in pixels; a centre whose last step reaches it is rejected. After a first step below SHORT_STEP there is
   no second one. SPARE_ROWS more rows are loaded. */
#define MAX_STEP 0.75
#define SHORT_STEP 0.125
enum { SPARE_ROWS = 1 };

/* Distance from the upper or lower border, in widths, from which on the missing rows do not matter. */
#define WHOLE_WIDTHS 3.0

/* Rows at most, as vectors take them. */
enum { ROWS = (2 * MAX_REACH + PARTS) / PARTS * PARTS };

/* Linear estimators for the rows from `reach` above a centre's pixel on: amplitude, and amplitude times offset. Padded
   with 0. */
typedef struct {
    size_t reach; /* 0: not yet known */
    double brightness[PHASES][ROWS], offset[PHASES][ROWS];
    double square; /* sum of the squares of `offset`, mean over the phases */
} Weights;

/* ---- weights ---- */

static double phase_offset(size_t phase) { return ((double)phase + 0.5) / PHASES - 0.5; }

/* Cholesky factor L of a symmetric positive matrix L L^T; it replaces the lower triangle. */
static void factorise(double a[SHAPES][SHAPES]) {
    for (size_t j = 0; j < SHAPES; j++) {
        for (size_t k = 0; k < j; k++)
            for (size_t i = j; i < SHAPES; i++) a[i][j] -= a[i][k] * a[j][k];
        double root = sqrt(a[j][j]);
        for (size_t i = j; i < SHAPES; i++) a[i][j] /= root;
    }
}

/* A row of the inverse of L L^T. */
static void invert_row(double factor[SHAPES][SHAPES], size_t row, double inverse[SHAPES]) {
    for (size_t i = 0; i < SHAPES; i++) {
        inverse[i] = i == row;
        for (size_t k = 0; k < i; k++) inverse[i] -= factor[i][k] * inverse[k];
        inverse[i] /= factor[i][i];
    }
    for (size_t i = SHAPES; i-- > 0;) {
        for (size_t k = i + 1; k < SHAPES; k++) inverse[i] -= factor[k][i] * inverse[k];
        inverse[i] /= factor[i][i];
    }
}

/* Weighted design matrix of a stripe with an offset from the middle row, and the normal equations; the weights are the
   inverse variances of Eq. (3.3) of ringpose-method(7), in units of that of the noise. */
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

/* Weights for each position (phase) of the centre in its pixel; half of the positions mirror the others. */
static void find_weights(double width, double speckle, size_t reach, Weights *weights) {
    double shape[2 * MAX_REACH + 1][SHAPES], brightness[SHAPES], offset[SHAPES];
    size_t last = 2 * reach;
    *weights = (Weights){.reach = reach};
    for (size_t j = 0, mirrored = PHASES - 1; j < mirrored; j++, mirrored--) {
        double equation[SHAPES][SHAPES] = {{0}};
        shape_rows(width, speckle, phase_offset(j), reach, shape, equation);
        factorise(equation);
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
static double weighted_sum(const double *restrict weight, const double *restrict row, size_t rows) {
    double sum[PARTS] = {0};
    for (size_t k = 0; k < rows; k += PARTS)
        for (size_t j = 0; j < PARTS; j++) sum[j] += weight[k + j] * row[k + j];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* Offset of the centre in the rows from a pixel on, limited to MAX_STEP; MAX_STEP if they show no stripe. */
static double step_from(const Weights *weights, size_t phase, const float *pixel) {
    double row[ROWS];
    size_t rows = 2 * weights->reach + 1;
    for (size_t k = 0; k < rows; k++) row[k] = pixel[k * BLOCK];
    for (size_t k = rows; k % PARTS; k++) row[k] = 0;
    double light = weighted_sum(weights->brightness[phase], row, rows);
    double step = light > 0 ? weighted_sum(weights->offset[phase], row, rows) / light : MAX_STEP;
    return step < -MAX_STEP ? -MAX_STEP : step < MAX_STEP ? step : MAX_STEP;
}

/* Moves y to the centre near it, in pixels whose first row is `top`; returns the length of the step. */
static double step_to_center(const Weights *weights, const float *pixel, ptrdiff_t top, double *y) {
    double row = floor(*y + 0.5), place = (*y - row + 0.5) * PHASES;
    size_t phase = place < 1 ? 0 : place < PHASES ? (size_t)place : PHASES - 1;
    double step = step_from(weights, phase, pixel + ((ptrdiff_t)row - (ptrdiff_t)weights->reach - top) * BLOCK);
    *y = row + phase_offset(phase) + step;
    return fabs(step);
}

/* The centre near y after one or two steps; NaN if there is none. */
static double weighted_center(const Weights *weights, const float *pixel, ptrdiff_t top, double y) {
    double step = step_to_center(weights, pixel, top, &y);
    if (step > SHORT_STEP) step = step_to_center(weights, pixel, top, &y);
    return step < MAX_STEP ? y : NAN;
}

/* State of the speckle-weighted fit of one piece. */
typedef struct {
    const Measure *how;
    size_t reach;                      /* rows on either side; the outer ones determine the background */
    ptrdiff_t top;                     /* first row of the pixels */
    double max_speckle, most_speckled; /* most_speckled: variance by noise of a centre at that ratio */
    Weights weights[LEVELS];
} Weigher;

/* Variance of a centre at which speckle over noise is `max_speckle`, Eq. (3.4): the excess is (speckle / noise)^2 times
   the filter's response to speckle over that to white noise. */
static double most_speckled(const Measure *how, Scatter of, double max_speckle, const Columns *columns) {
    double width = how->width * how->width, share = width / (width + how->filter->sigma * how->filter->sigma);
    double precision = 0, square = (excess(of, 1) - 1) / (share * sqrt(share));
    for (size_t i = 0; i < columns->count; i++) precision += 1 / columns->variance[i];
    return square * (double)columns->count / (precision * max_speckle * max_speckle);
}

/* The weights for a column in which noise causes this variance of the centre. */
static const Weights *weights_of(Weigher *weigher, double variance) {
    double square = variance / weigher->most_speckled;
    size_t level = square < 2 ? 0 : square < 8 ? 1 : square < 32 ? 2 : LEVELS - 1;
    Weights *weights = weigher->weights + level;
    if (weights->reach == 0)
        find_weights(weigher->how->width, weigher->max_speckle / (double)(1 << level), weigher->reach, weights);
    return weights;
}

/* Measures the columns whose pixels lie in the patch; `first` is the leftmost one. */
static void weight_neighbours(Weigher *weigher, const Columns *columns, size_t first, size_t count, Columns *weighted) {
    double whole = WHOLE_WIDTHS * weigher->how->width, last = (double)weigher->how->image->height - 1 - whole;
    for (size_t i = first; i < first + count; i++) {
        const float *pixel = weigher->how->patch->pixel + (columns->x[i] - columns->x[first]);
        const Weights *weights = weights_of(weigher, columns->variance[i]);
        double y = weighted_center(weights, pixel, weigher->top, columns->y[i]);
        if (!(y >= whole && y <= last)) continue;
        weighted->x[weighted->count] = columns->x[i];
        weighted->y[weighted->count] = y;
        weighted->variance[weighted->count] = columns->variance[i];
        weighted->peak[weighted->count++] = columns->peak[i];
    }
}

/* Converts variances of the filter's centres to those of the weighted centres. */
static void turn_variances(Weigher *weigher, Columns *weighted) {
    double norm = weigher->how->filter->slope_norm * weigher->how->peak_per_response;
    for (size_t i = 0; i < weighted->count; i++)
        weighted->variance[i] *= weights_of(weigher, weighted->variance[i])->square / (norm * norm);
}

/* Measures the centres again by weighted least squares, from those that the filter found, with weights for the speckle
   of each column. Columns without a centre near by are dropped. Returns the scatter of the new centres, relative to the
   variance that noise causes in the filter's centres. */
static Scatter speckle_weighted_centers(const Measure *how, Scatter of, const StripeParams *params, Columns *columns,
                                        Columns *weighted) {
    Weigher weigher = {.how = how,
                       .max_speckle = params->max_speckle,
                       .most_speckled = most_speckled(how, of, params->max_speckle, columns)};
    size_t reach = (size_t)ceil(params->reach_sigmas * how->width);
    weigher.reach = reach < MAX_REACH ? reach : MAX_REACH;
    weighted->count = 0;
    for (size_t i = 0; i < columns->count; i++) columns->row[i] = (int32_t)floor(columns->y[i] + 0.5);
    for (size_t first = 0, close; first < columns->count; first += close) {
        int32_t top, bottom;
        close = neighbours(columns, first, &top, &bottom);
        weigher.top = top - (ptrdiff_t)weigher.reach - SPARE_ROWS;
        size_t rows = (size_t)(bottom - top) + 1 + 2 * (weigher.reach + SPARE_ROWS);
        load_pixels(how->image, weigher.top, (size_t)columns->x[first], rows, how->patch);
        weight_neighbours(&weigher, columns, first, close, weighted);
    }
    Scatter left = scatter_at(weighted, of.lag);
    turn_variances(&weigher, weighted);
    return left;
}

/* Filter over stripe: a little wider than matched costs 5 % in white noise, and speckle asks for more. */
#define FILTER_PER_WIDTH 1.3

/* The same for a flat top, over its half width: the flanks weigh most. */
#define FILTER_PER_HALF_WIDTH 0.82

/* Peak of a flat top over its response, for a filter of that width and sigma 1. */
#define FLAT_PEAK_PER_RESPONSE 2.162

/* Narrowest stripe sigma believed, and the widest, in sigmas of the ridge filter. */
#define MIN_WIDTH_PX 0.7
#define MAX_WIDTH 2.0

/* Sigma of the flanks of a flat top. */
#define FLANK_PX 1.5

/* An excess above these is due to clutter or bends, or to speckle; shot noise of bright stripes causes up to 9. */
#define CLUTTERED 8.0
#define SPECKLED 10.0

/* Then a filter narrower by this many, or speckle weights, are tried on pieces of at least this many columns, and
   accepted if the variance falls below this share. */
enum { NARROWER = 3, MIN_CLUTTERED_COLUMNS = 24, MIN_SPECKLED_COLUMNS = 14 };
#define BETTER 0.95

/* Ridges at a distance in this range, in widths of the stripe, belong to something else; nearer ones are its speckle.
   They distort the background of the stripe unless they are fainter than FAINT_SHARE of it. Speckle weights are not
   used if one of CROWDED_ONE_IN columns has such a neighbour. */
#define OTHERS_FROM 3.0
#define OTHERS_TO 8.0
#define FAINT_SHARE 0.05f
enum { CROWDED_ONE_IN = 10 };

/* Nor if one of FULL_ONE_IN columns is saturated on both sides of its middle, at this share of a width: the flanks of a
   clipped, skewed section determine its middle less well than the filter does. */
#define FULL_WIDTHS 0.75
enum { FULL_ONE_IN = 3 };

/* Largest share of columns, one in LOST_ONE_IN, that an alternative may lose. */
enum { LOST_ONE_IN = 10 };

typedef struct {
    const StripeImage *image;
    const Filter *filters; /* the first is that of the ridges */
    size_t filter_count;
    const StripeParams *params;
    const Ridge *ridges;
    size_t ridge_count;
    Patch *patch;
    Columns columns[2];
} Job;

/* Squared sigma of the response from the relative curvature at its peak, averaged over sub-pixel positions. */
static double response_spread(double sharpness) {
    double b = 3 + 0.125 * sharpness, root = b * b - 7.5 * sharpness;
    return 3.75 / (b - sqrt(root > 0 ? root : 0));
}

/* Number of the filter with the nearest sigma. */
static size_t nearest_filter(const Job *job, double sigma) {
    size_t best = 1;
    for (size_t i = 2; i < job->filter_count; i++)
        if (fabs(job->filters[i].sigma - sigma) < fabs(job->filters[best].sigma - sigma)) best = i;
    return best;
}

static Measure measure_with(const Job *job, size_t filter, double width) {
    Measure how = {.image = job->image, .patch = job->patch, .filter = job->filters + filter, .width = width};
    double sigma = how.filter->sigma, spread = sigma * sigma + width * width;
    how.inverse_spread = width > 0 ? 1 / spread : 0;
    how.peak_per_response = width > 0 ? spread * sqrt(spread) / width : FLAT_PEAK_PER_RESPONSE * sigma * sigma;
    how.whole = WHOLE_SPREADS * hypot(sigma, width);
    how.sigma_per_noise = how.filter->slope_norm / job->filters[0].bend_norm;
    return how;
}

/* Filter matched to the mean width of a piece's ridges, or of its flat tops if there are many. */
static size_t suited_filter(const Job *job, const int32_t *order, size_t count, double *width) {
    double response = 0, curvature = 0, half_width = 0, own = job->filters[0].sigma;
    size_t flat = 0;
    for (size_t i = 0; i < count; i++) {
        const Ridge *ridge = job->ridges + order[i];
        response += ridge->response;
        curvature += ridge->curvature > 0 ? ridge->curvature : 0;
        half_width -= ridge->curvature < 0 ? ridge->curvature : 0;
        flat += ridge->curvature < 0;
    }
    if (3 * flat > count) {
        *width = 0;
        double half = half_width / (double)flat + sqrt(own * own + FLANK_PX * FLANK_PX);
        return nearest_filter(job, FILTER_PER_HALF_WIDTH * half);
    }
    *width = sqrt(fmax(response_spread(curvature / response) - own * own, MIN_WIDTH_PX * MIN_WIDTH_PX));
    *width = fmin(*width, MAX_WIDTH * own);
    return nearest_filter(job, FILTER_PER_WIDTH * *width);
}

/* Measures ridges with a filter. */
static Scatter measure_piece_with(const Job *job, size_t filter, double width, const int32_t *order, size_t count,
                                  Columns *columns) {
    Measure how = measure_with(job, filter, width);
    take_ridges(job->ridges, order, count, columns);
    measure_columns(&how, columns);
    return scatter(columns);
}

/* Adds centres; the sigmas are variances for now. */
static void append_columns(const Columns *columns, int64_t number, Centers *centers) {
    size_t at = centers->count;
    for (size_t i = 0; i < columns->count; i++) {
        centers->position[2 * (at + i)] = columns->x[i];
        centers->position[2 * (at + i) + 1] = columns->y[i];
        centers->sigma[at + i] = columns->variance[i];
        centers->peak[at + i] = columns->peak[i];
        centers->piece[at + i] = number;
    }
    centers->count += columns->count;
}

/* True if another ridge of the column is near, above (-1) or below (1). */
static int has_other(const Job *job, size_t number, ptrdiff_t side, double width) {
    const Ridge *own = job->ridges + number;
    for (size_t i = number + (size_t)side; i < job->ridge_count && job->ridges[i].x == own->x; i += (size_t)side) {
        double apart = fabsf(job->ridges[i].y - own->y);
        if (apart > OTHERS_TO * width) return 0;
        if (apart > OTHERS_FROM * width && job->ridges[i].response > FAINT_SHARE * own->response) return 1;
    }
    return 0;
}

/* True if a ridge is full on both sides of its middle. */
static int is_saturated_beside(const Job *job, const Ridge *ridge, double width) {
    const StripeImage *image = job->image;
    ptrdiff_t rows = (ptrdiff_t)(FULL_WIDTHS * width + 0.5);
    size_t above = clamped(ridge->row - rows, image->height), below = clamped(ridge->row + rows, image->height);
    size_t x = (size_t)ridge->x;
    return lit_at(image, above * image->width + x) >= (float)job->params->full_dn &&
           lit_at(image, below * image->width + x) >= (float)job->params->full_dn;
}

/* True if the flanks of a piece are neither disturbed by other ridges nor saturated. */
static int shows_flanks(const Job *job, const int32_t *order, size_t count, double width) {
    size_t others = 0, full = 0;
    for (size_t i = 0; i < count; i++) {
        size_t number = (size_t)order[i];
        others += has_other(job, number, -1, width) || has_other(job, number, 1, width);
        full += (size_t)is_saturated_beside(job, job->ridges + number, width);
    }
    return CROWDED_ONE_IN * others <= count && FULL_ONE_IN * full <= count;
}

/* True if hardly any column is lost. */
static int keeps_columns(const Columns *columns, const Columns *other) {
    size_t lost = columns->count > other->count ? columns->count - other->count : 0;
    return LOST_ONE_IN * lost <= columns->count;
}

/* Measures a piece with the filter matched to its width; if the background disturbs it, with a narrower one; if speckle
   does, by weighted least squares. The alternative is accepted if the centres scatter less. */
static const Columns *measure_piece(Job *job, const int32_t *order, size_t count, Scatter *of, Scatter *first) {
    double width;
    size_t filter = suited_filter(job, order, count, &width);
    Columns *columns = job->columns, *other = columns + 1;
    *of = *first = measure_piece_with(job, filter, width, order, count, columns);
    if (width == 0 || count < MIN_SPECKLED_COLUMNS || excess(*of, 1) < CLUTTERED) return columns;
    if (of->background && count >= MIN_CLUTTERED_COLUMNS) {
        size_t narrower = filter > NARROWER ? filter - NARROWER : 1;
        Scatter tried = measure_piece_with(job, narrower, width, order, count, other);
        if (keeps_columns(columns, other) && scatter_variance(other, tried) < BETTER * scatter_variance(columns, *of)) {
            *of = tried;
            return other;
        }
    }
    if (excess(*of, 1) < SPECKLED || !shows_flanks(job, order, count, width)) return columns;
    Measure how = measure_with(job, filter, width);
    Scatter tried = speckle_weighted_centers(&how, *of, job->params, columns, other);
    if (!keeps_columns(columns, other) || excess(tried, 1) >= BETTER * excess(*of, 1)) return columns;
    *of = scatter(other);
    return other;
}

/* ---- pieces ---- */

static int is_kept(const StripePiece *piece, const StripeParams *params) {
    return piece->columns >= params->shortest && piece->strong_columns >= params->shortest;
}

size_t kept_ridges(const StripeParams *params, const List *pieces) {
    const StripePiece *piece = pieces->data;
    size_t total = 0;
    for (size_t i = 0; i < pieces->used; i++) total += is_kept(piece + i, params) ? (size_t)piece[i].columns : 0;
    return total;
}

/* Numbers of the ridges, piece after piece, and where each piece that is kept ends; of the others -1. */
static int32_t *ridges_by_piece(const StripeParams *params, const List *ridges, const List *pieces, int32_t *end) {
    const StripePiece *piece = pieces->data;
    const Ridge *ridge = ridges->data;
    int32_t total = 0;
    for (size_t i = 0; i < pieces->used; i++) {
        end[i] = is_kept(piece + i, params) ? total : -1;
        total += end[i] < 0 ? 0 : piece[i].columns;
    }
    int32_t *order = malloc(((size_t)total + 1) * sizeof *order);
    for (size_t i = 0; order && i < ridges->used; i++)
        if (end[ridge[i].piece] >= 0) order[end[ridge[i].piece]++] = (int32_t)i;
    return order;
}

static size_t longest_piece(const List *pieces) {
    const StripePiece *piece = pieces->data;
    int32_t longest = 0;
    for (size_t i = 0; i < pieces->used; i++) longest = piece[i].columns > longest ? piece[i].columns : longest;
    return (size_t)longest;
}

static int64_t measure_pieces(Job *job, const List *pieces, const int32_t *order, const int32_t *end,
                              PieceScatter *measured, Centers *centers) {
    const StripePiece *piece = pieces->data;
    int64_t number = 0;
    for (size_t i = 0; i < pieces->used; i++) {
        if (end[i] < 0) continue;
        size_t count = (size_t)piece[i].columns;
        PieceScatter *own = measured + number;
        const Columns *columns = measure_piece(job, order + ((size_t)end[i] - count), count, &own->of, &own->first);
        if ((int64_t)columns->count < job->params->shortest) continue;
        own->columns = columns->count;
        append_columns(columns, number++, centers);
    }
    return number;
}

/* Sigmas from variances, when all pieces are known; `sorted` is scratch. */
static void find_sigmas(Columns *columns, const PieceScatter *measured, size_t count, PieceScatter *sorted,
                        Centers *centers) {
    memcpy(sorted, measured, count * sizeof *sorted);
    double pooled = pooled_excess(sorted, count);
    double *sigma = centers->sigma, *y = centers->position + 1;
    for (size_t i = 0; i < count; i++) {
        columns->count = measured[i].columns;
        memcpy(columns->variance, sigma, columns->count * sizeof *sigma);
        for (size_t j = 0; j < columns->count; j++, y += 2) columns->y[j] = *y;
        raise_variances(columns, measured[i].of, pooled * excess(measured[i].of, 1) / excess(measured[i].first, 1));
        for (size_t j = 0; j < columns->count; j++) sigma[j] = sqrt(columns->variance[j]);
        sigma += columns->count;
    }
}

int find_centers(const StripeImage *image, const Filter *filters, size_t filter_count, const StripeParams *params,
                 const List *ridges, const List *pieces, Centers *centers) {
    Patch patch;
    Job job = {image, filters, filter_count, params, ridges->data, ridges->used, &patch, {{0}, {0}}};
    size_t room = pieces->used + 1;
    int32_t *end = malloc(room * sizeof *end);
    int32_t *order = end ? ridges_by_piece(params, ridges, pieces, end) : NULL;
    PieceScatter *measured = malloc(2 * room * sizeof *measured);
    void *memory[2];
    for (int i = 0; i < 2; i++) memory[i] = allocate_columns(job.columns + i, longest_piece(pieces));
    int done = order != NULL && measured != NULL && memory[0] != NULL && memory[1] != NULL;
    if (done) {
        size_t count = (size_t)measure_pieces(&job, pieces, order, end, measured, centers);
        find_sigmas(job.columns, measured, count, measured + room, centers);
    }
    free(end);
    free(order);
    free(measured);
    free(memory[0]);
    free(memory[1]);
    return done;
}
