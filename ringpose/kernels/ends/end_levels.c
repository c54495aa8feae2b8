/* What a stripe's brightness about its ends varies by. */
#include "end_levels.h"

#include <math.h>
#include <string.h>

#include "select.h"

/* Median deviations beyond which a column of the face says no more. */
#define WINSORISED 2.5

/* Columns beyond the end spread by more than noise if they do by so much more, in variance. */
#define CLUTTER 2.5

#define LEAST_RELATIVE_NOISE 1e-6
#define LEAST_SPECKLE 1e-9
#define LEAST_ALIKE 1

static double median_deviation(double *value, size_t n) {
    double middle = median(value, n);
    for (size_t i = 0; i < n; i++) value[i] = fabs(value[i] - middle);
    return 1.4826 * median(value, n);
}

/* Relative variance of the face's columns about their level, and half that of their differences. */
static void measure_scatter(Columns *columns, double *full, size_t n) {
    double away[MOST_COLUMNS], mean = 0, scatter = 0, step = 0;
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
static int measure_face(Columns *columns, const EndRules *rules) {
    double full[MOST_COLUMNS], some[MOST_COLUMNS];
    size_t inner = 0;
    for (int i = 0; i < columns->count; i++)
        if (columns->along[i] < -2)
            full[inner++] = columns->amplitude[i] / fmax(columns->room[FULL][i], rules->least_headroom);
    memcpy(some, full, inner * sizeof *some);
    columns->level = median(some, inner);
    if (!(columns->level > 0)) return 0;
    measure_scatter(columns, full, inner);
    return 1;
}

/* Variances by the pixels' noise, from what sections leave unexplained, and of the columns beyond the end where nothing
   lies beneath. */
static void measure_noise(Columns *columns, const double *rough, double gain, const EndRules *rules) {
    double within[MOST_COLUMNS], near[MOST_COLUMNS], beyond[MOST_COLUMNS];
    size_t faces = 0, nears = 0, clear = 0;
    for (int i = 0; i < columns->count; i++) {
        double along = columns->along[i];
        if (along < -3) within[faces++] = rough[i];
        if (along > 1 && along <= rules->near_columns) near[nears++] = rough[i];
        if (along > 2 && !(columns->texture[i] > 0)) beyond[clear++] = columns->amplitude[i];
    }
    columns->beyond = fmax(gain * low_roughness(near, nears), LEAST_RELATIVE_NOISE * columns->level * columns->level);
    columns->within = gain * median(within, faces);
    double spread = clear < 4 ? 0 : median_deviation(beyond, clear);
    columns->clutter = spread * spread;
}

int gather_columns(const Profile *profile, ptrdiff_t near, int outward, const EndRules *rules, Columns *columns) {
    int inner = 0, outer = 0, count = 0;
    double rough[MOST_COLUMNS];
    for (double along = 1 - rules->inside_columns; along < rules->outside_columns && count < MOST_COLUMNS; along++) {
        ptrdiff_t i = near + outward * (ptrdiff_t)along;
        if (i < 0 || i >= profile->count) continue;
        inner += along < -3;
        outer += along > 1;
        columns->along[count] = along;
        columns->amplitude[count] = profile->amplitude[i];
        for (int k = 0; k < ROOMS; k++) columns->room[k][count] = profile->room[k][i];
        columns->texture[count] = profile->texture[i];
        rough[count] = profile->rough[i];
        columns->saturated[count++] = profile->saturated[i];
    }
    columns->count = count;
    columns->clipped = profile->clipped;
    columns->facet = exp(-2 / (rules->facet_sigmas * profile->sigma));
    if (inner < 4 || outer < 3 || !measure_face(columns, rules)) return 0;
    measure_noise(columns, rough, profile->gain, rules);
    return 1;
}

/* Relative variance of the face's columns, no less than that by noise. */
static double relative_scatter(const Columns *columns) {
    return fmax(columns->scatter, columns->beyond / (columns->level * columns->level));
}

/* Noise, shot noise and speckle of one end, from geometric means of its own variances and all ends' (logarithms). */
static void divide_scatter(Columns *columns, double usual_scatter, double usual_noise, const EndRules *rules) {
    double square = columns->level * columns->level, least = rules->least_noise * columns->level;
    double scatter = exp(0.5 * (log(relative_scatter(columns)) + usual_scatter)) * square;
    columns->noise = exp(0.5 * (log(columns->beyond) + usual_noise));
    if (columns->clutter > CLUTTER * columns->noise) columns->noise = columns->clutter;
    double more = fmax(scatter - columns->noise, 0);
    columns->shot = fmin(more, fmax(columns->within - columns->noise, 0));
    columns->speckle = more - columns->shot;
    columns->least = fmax(columns->noise, least * least);
}

double share_levels(Columns *const columns[], size_t ends, const EndRules *rules) {
    double scatter = 0, noise = 0, alike = 0, all = 0;
    for (size_t i = 0; i < ends; i++) {
        scatter += log(relative_scatter(columns[i])) / (double)ends;
        noise += log(columns[i]->beyond) / (double)ends;
    }
    for (size_t i = 0; i < ends; i++) {
        Columns *each = columns[i];
        divide_scatter(each, scatter, noise, rules);
        double white = (each->noise + each->shot) / (each->level * each->level);
        alike += each->scatter - each->step;
        all += fmax(each->scatter - white, LEAST_SPECKLE);
    }
    return ends ? fmin(fmax(alike / all, 0), 0.9) : 0;
}

static double speckle_share(const Columns *columns) {
    return columns->speckle / (columns->speckle + columns->shot + columns->least);
}

double columns_alike(const Columns *columns, double likeness) {
    return 1 + 2 * speckle_share(columns) * (likeness + pow(likeness, 4) + pow(likeness, 9));
}

/* An edge changes with its width like the derivative of a Gaussian, whose likeness to itself so far apart is known. */
double columns_alike_for_width(const Columns *columns, double likeness, double width) {
    double alike = 0, square = 4 * width * width;
    for (int lag = 1; lag <= 3; lag++) {
        double apart = lag * lag / square;
        alike += pow(likeness, lag * lag) * (1 - 2 * apart) * exp(-apart);
    }
    return fmax(1 + 2 * speckle_share(columns) * alike, LEAST_ALIKE);
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
