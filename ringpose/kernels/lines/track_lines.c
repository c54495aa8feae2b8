/* Lines through the centres of tracks, and how far neighbours err alike. */
#include "drafts.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "kernels.h"
#include "select.h"

/* Sums are kept in so many parts, as vectors do it. */
enum { PARTS = 4 };

/* Copies a draft's centres together; returns how many. */
static size_t gather(const Draft *draft, const double *from, double *to) {
    size_t n = 0;
    for (size_t b = 0; b < draft->blocks; b++) {
        size_t length = draft->last[b] - draft->first[b];
        memcpy(to + n, from + draft->first[b], length * sizeof *to);
        n += length;
    }
    return n;
}

/* Sum of products of values that lie so far apart. */
static double likeness_at(const double *value, size_t n, size_t lag) {
    const double *other = value + lag;
    double sum[PARTS] = {0};
    size_t pairs = n - lag, i = 0;
    for (; i + PARTS <= pairs; i += PARTS)
        for (size_t j = 0; j < PARTS; j++) sum[j] += value[i + j] * other[i + j];
    for (; i < pairs; i++) sum[0] += value[i] * other[i];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* 1 + 2 times the sum of the autocorrelation, as far as it stays positive. */
static double correlation_columns(double *residual, size_t n, const TrackRules *rules) {
    double mean = 0, columns = 1;
    for (size_t i = 0; i < n; i++) mean += residual[i];
    mean /= (double)n;
    for (size_t i = 0; i < n; i++) residual[i] -= mean;
    double variance = fmax(likeness_at(residual, n, 0), 1e-12);
    for (size_t lag = 1; lag < rules->longest_lag && lag < n / 3; lag++) {
        double likeness = likeness_at(residual, n, lag) / variance;
        if (!(likeness > 0)) break;
        columns += 2 * likeness;
    }
    return rules->short_series * columns;
}

/* GNU C's vectors: the compilers do not see that sums may be kept in parts. */
typedef double Doubles __attribute__((vector_size(8 * PARTS), aligned(8), may_alias));
typedef int64_t Masks __attribute__((vector_size(8 * PARTS), aligned(8), may_alias));
#define DOUBLES(address) (*(const Doubles *)(address))

/* Sums over centres whose residual is below a limit, about an origin. */
typedef struct {
    Doubles count, x, y, xx, xy;
} Sums;

static void add_inliers(const double *x, const double *y, const double *residual, size_t n, double limit, size_t origin,
                        Sums *sums) {
    double origin_x = x[origin], origin_y = y[origin];
    const Doubles one = {1, 1, 1, 1};
    Sums s = {{0}, {0}, {0}, {0}, {0}};
    size_t whole = n - n % PARTS;
    for (size_t i = 0; i < whole; i += PARTS) {
        Doubles weight = (Doubles)((DOUBLES(residual + i) < limit) & (Masks)one);
        Doubles dx = DOUBLES(x + i) - origin_x, dy = DOUBLES(y + i) - origin_y, weighted = weight * dx;
        s.count += weight;
        s.x += weighted;
        s.y += weight * dy;
        s.xx += weighted * dx;
        s.xy += weighted * dy;
    }
    for (size_t i = whole; i < n; i++) {
        double weight = residual[i] < limit ? 1 : 0, dx = x[i] - origin_x, dy = y[i] - origin_y;
        s.count[0] += weight;
        s.x[0] += weight * dx;
        s.y[0] += weight * dy;
        s.xx[0] += weight * dx * dx;
        s.xy[0] += weight * dx * dy;
    }
    *sums = s;
}

static double total(const Doubles *part) { return ((*part)[0] + (*part)[1]) + ((*part)[2] + (*part)[3]); }

/* Distances from a track's line. */
static void find_residuals(const Track *track, const double *restrict x, const double *restrict y, size_t n,
                           double *restrict residual) {
    double middle_x = track->middle_x, middle_y = track->middle_y, slope = track->slope;
    for (size_t i = 0; i < n; i++) residual[i] = fabs(y[i] - middle_y - slope * (x[i] - middle_x));
}

void fit_line(Draft *draft, const Work *work) {
    Track *track = &draft->track;
    double *x = work->x, *y = work->y, *r = work->residual, limit = INFINITY;
    size_t n = gather(draft, work->centers->x, x);
    gather(draft, work->centers->y, y);
    memset(r, 0, n * sizeof *r);
    for (int round = 0; round < 2; round++) {
        Sums sums;
        add_inliers(x, y, r, n, limit, n / 2, &sums);
        double count = total(&sums.count), sum_x = total(&sums.x), sum_y = total(&sums.y);
        track->slope = (total(&sums.xy) - sum_x * sum_y / count) / (total(&sums.xx) - sum_x * sum_x / count);
        track->middle_x = x[n / 2] + sum_x / count;
        track->middle_y = y[n / 2] + sum_y / count;
        find_residuals(track, x, y, n, r);
        memcpy(work->scratch, r, n * sizeof *r);
        track->scatter = fmax(1.4826 * median(work->scratch, n), 0.01);
        limit = 3 * track->scatter;
    }
    size_t inliers = 0;
    for (size_t i = 0; i < n; i++) {
        work->scratch[inliers] = y[i] - track->middle_y - track->slope * (x[i] - track->middle_x);
        inliers += r[i] < limit;
    }
    track->correlation = correlation_columns(work->scratch, inliers, work->rules);
    track->count = (double)n;
    track->x_start = x[0];
    track->x_end = x[n - 1];
    double left = work->centers->column[draft->first[0]];
    double right = work->centers->column[draft->last[draft->blocks - 1] - 1];
    double border = work->rules->border, width = work->rules->width;
    track->clipped = left < border || left > width - 1 - border || right < border || right > width - 1 - border;
}

