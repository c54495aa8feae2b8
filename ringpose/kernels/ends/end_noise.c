/* Noise model of the amplitudes about a stripe's end: noise N, shot noise S and speckle C^2 (ringpose-method(7),
   section 3), each estimated from the columns of one end and shrunk towards the mean of all ends. */
#include "end_noise.h"
#include "median.h"

#include <math.h>
#include <string.h>

/* Columns of the face are winsorised at this many robust standard deviations. */
#define WINSORISED 2.5

/* The columns beyond the end show clutter, such as the stripe on the body behind, if their variance exceeds that of
   noise by this factor. */
#define CLUTTER 2.5

#define MIN_RELATIVE_NOISE 1e-6
#define MIN_SPECKLE 1e-9
#define MIN_CORRELATION_LENGTH 1

static double median_deviation(double *value, size_t n) {
    double middle = median(value, n);
    for (size_t i = 0; i < n; i++) value[i] = fabs(value[i] - middle);
    return 1.4826 * median(value, n);
}

/* Relative variance of the face's columns about their level, and half that of their differences. */
static void measure_scatter(Columns *columns, double *full, size_t n) {
    double away[MAX_COLUMNS], mean = 0, scatter = 0, step = 0;
    for (size_t i = 0; i < n; i++) away[i] = full[i] = full[i] / columns->level - 1;
    double limit = WINSORISED * median_deviation(away, n);
    for (size_t i = 0; i < n; i++) mean += full[i] = fmin(fmax(full[i], -limit), limit);
    mean /= (double)n;
    for (size_t i = 0; i < n; i++) {
        scatter += (full[i] - mean) * (full[i] - mean);
        if (i) step += (full[i] - full[i - 1]) * (full[i] - full[i - 1]);
    }
    columns->scatter = scatter / (double)(n - 1);
    columns->step = 0.5 * step / (double)(n - 1);
}

/* Level of the stripe and scatter of its columns; 0 if they are dark. */
static int measure_face(Columns *columns, const EndParams *params) {
    double full[MAX_COLUMNS], some[MAX_COLUMNS];
    size_t inner = 0;
    for (int i = 0; i < columns->count; i++)
        if (columns->along[i] < -2)
            full[inner++] = columns->amplitude[i] / fmax(columns->headroom[FULL][i], params->min_headroom);
    memcpy(some, full, inner * sizeof *some);
    columns->level = median(some, inner);
    if (!(columns->level > 0)) return 0;
    measure_scatter(columns, full, inner);
    columns->inner = (int)inner;
    return 1;
}

/* Variances due to pixel noise, from the residuals of the sections, and of the columns beyond the end that have no
   background texture. */
static void measure_noise(Columns *columns, const double *residual_variance, double gain, const EndParams *params) {
    double within[MAX_COLUMNS], near[MAX_COLUMNS], beyond[MAX_COLUMNS];
    size_t faces = 0, nears = 0, clear = 0;
    for (int i = 0; i < columns->count; i++) {
        double along = columns->along[i];
        if (along < -3) within[faces++] = residual_variance[i];
        if (along > 1 && along <= params->near_columns) near[nears++] = residual_variance[i];
        if (along > 2 && !(columns->texture[i] > 0)) beyond[clear++] = columns->amplitude[i];
    }
    double minimum = MIN_RELATIVE_NOISE * columns->level * columns->level;
    double outside = fmax(gain * low_residual_variance(near, nears), minimum);
    double spread = clear < 4 ? 0 : median_deviation(beyond, clear);
    columns->within = gain * median(within, faces);
    columns->beyond = fmin(outside, fmax(columns->within, minimum)); /* more is light on what lies behind the edge */
    /* the residuals of the sections contain stripes beside the line, which hardly change the amplitude on it */
    columns->clutter = clear < 4 ? outside - columns->beyond : spread * spread;
}

int gather_columns(const Profile *profile, ptrdiff_t near, int outward, const EndParams *params, Columns *columns) {
    int inner = 0, outer = 0, count = 0;
    double residual_variance[MAX_COLUMNS];
    for (double along = 1 - params->inside_columns; along < params->outside_columns && count < MAX_COLUMNS; along++) {
        ptrdiff_t i = near + outward * (ptrdiff_t)along;
        if (i < 0 || i >= profile->count) continue;
        inner += along < -3;
        outer += along > 1;
        columns->along[count] = along;
        columns->y[count] = profile->y[i];
        columns->amplitude[count] = profile->amplitude[i];
        for (int k = 0; k < LIGHT_LEVELS; k++) columns->headroom[k][count] = profile->headroom[k][i];
        columns->texture[count] = profile->texture[i];
        residual_variance[count] = profile->residual_variance[i];
        columns->saturated[count++] = profile->saturated[i];
    }
    columns->count = count;
    columns->clipped = profile->clipped;
    columns->facet = exp(-2 / (params->facet_sigmas * profile->sigma));
    if (inner < 4 || outer < 3 || !measure_face(columns, params)) return 0;
    measure_noise(columns, residual_variance, profile->gain, params);
    return 1;
}

/* Relative variance of the face's columns, at least that of noise. */
static double relative_scatter(const Columns *columns) {
    return fmax(columns->scatter, columns->beyond / (columns->level * columns->level));
}

/* Noise, shot noise and speckle of one end, Eq. (3.6), from geometric means of its own and the pooled variances
   (logarithms). */
static void split_scatter(Columns *columns, double pooled_scatter, double pooled_noise, const EndParams *params) {
    double square = columns->level * columns->level, minimum = params->min_noise * columns->level;
    double scatter = exp(0.5 * (log(relative_scatter(columns)) + pooled_scatter)) * square;
    columns->noise = exp(0.5 * (log(columns->beyond) + pooled_noise));
    if (!(columns->clutter > CLUTTER * columns->noise)) columns->clutter = 0;
    double more = fmax(scatter - columns->noise, 0);
    columns->shot = fmin(more, fmax(columns->within - columns->noise, 0));
    columns->speckle = more - columns->shot;
    columns->minimum = fmax(columns->noise, minimum * minimum);
}

/* Columns per independent one at a Gaussian autocorrelation, correlation^(lag^2): L of Eq. (3.9). */
static double columns_per_grain(double correlation) {
    return 1 + 2 * (correlation + pow(correlation, 4) + pow(correlation, 9));
}

static double speckle_share(const Columns *columns) {
    return columns->speckle / (columns->speckle + columns->shot + columns->minimum);
}

double correlation_length(const Columns *columns, double correlation) {
    return 1 + speckle_share(columns) * (columns_per_grain(correlation) - 1);
}

/* Variance over the expected scatter of correlated columns about their own mean, Eq. (3.9). */
static double scatter_correction(const Columns *columns, double correlation) {
    double independent = fmax(columns->inner / correlation_length(columns, correlation), 3);
    return independent / (independent - 1);
}

double estimate_noise_model(Columns *const columns[], size_t ends, const EndParams *params) {
    double scatter = 0, noise = 0, correlation = 0;
    for (size_t i = 0; i < ends; i++) {
        scatter += log(relative_scatter(columns[i])) / (double)ends;
        noise += log(columns[i]->beyond) / (double)ends;
    }
    for (size_t i = 0; i < ends; i++) split_scatter(columns[i], scatter, noise, params);
    for (int round = 0; round < 2; round++) { /* the correction depends on the correlation */
        double correlated = 0, all = 0;
        for (size_t i = 0; i < ends; i++) {
            const Columns *each = columns[i];
            double unbiased = each->scatter * (round ? scatter_correction(each, correlation) : 1);
            correlated += unbiased - each->step;
            all += fmax(unbiased - (each->noise + each->shot) / (each->level * each->level), MIN_SPECKLE);
        }
        correlation = ends ? fmin(fmax(correlated / all, 0), 0.9) : 0;
    }
    for (size_t i = 0; i < ends; i++) {
        double correction = scatter_correction(columns[i], correlation);
        /* a mean of logarithms of chi-squared with n degrees of freedom is smaller than log(n) by 1 / n */
        columns[i]->speckle *= correction * exp(correction - 1);
    }
    return correlation;
}

/* The derivative of an edge with respect to its width is that of a Gaussian; its autocorrelation at lag l is
   (1 - l^2 / 2 w^2) exp(-l^2 / 4 w^2). */
double correlation_length_for_width(const Columns *columns, double correlation, double width) {
    double sum = 0, square = 4 * width * width;
    for (int lag = 1; lag <= 3; lag++) {
        double apart = lag * lag / square;
        sum += pow(correlation, lag * lag) * (1 - 2 * apart) * exp(-apart);
    }
    return fmax(1 + 2 * speckle_share(columns) * sum, MIN_CORRELATION_LENGTH);
}

double slow_variance(const double *value, int count, double level) {
    double square = 0, difference = 0;
    if (count < 3) return 0;
    for (int i = 0; i < count; i++) {
        square += (value[i] - level) * (value[i] - level);
        if (i) difference += (value[i] - value[i - 1]) * (value[i] - value[i - 1]);
    }
    return fmax(square / count - 0.5 * difference / (count - 1), 0);
}
