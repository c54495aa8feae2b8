/* Standard deviations of centres from second differences, which are independent of position and slope of a straight
   piece. At a near lag they show speckle, at a far lag the background. */
#include "stripe_sigmas.h"

#include <math.h>
#include <stdlib.h>

/* Lags at which the speckle of two centres is independent (grains of about 3 px), and the background (facets of a
   foil). */
enum { NEAR_LAG = 4, FAR_LAG = 40 };

/* The background disturbs a stripe if the far excess is larger than the near one by this factor. */
#define BACKGROUND 1.75

/* Weight of the expected variance of a piece, as a number of differences. */
#define EXPECTED_DIFFERENCES 4.0

/* Weight of the pooled variance of the frame, as a number of differences, for the logarithm of the variance. */
#define FRAME_DIFFERENCES 8.0

/* Squares are clipped at this multiple of their mean. */
#define MAX_SQUARE 25.0
enum { ROUNDS = 3 };

/* Window of differences on either side of a column, and the weight of the whole piece as a number of differences. */
enum { SURROUNDINGS = 10 };
#define PIECE_DIFFERENCES 6.0

/* A second difference has six times the variance of a centre. */
#define VARIANCES 6.0

/* Number of second differences at a lag. */
static size_t differences(const Columns *columns, size_t lag) {
    return lag > 0 ? columns->count - 2 * lag : 0;
}

/* The lag, reduced for short pieces. */
static size_t feasible_lag(size_t lag, const Columns *columns) {
    return 4 * lag < columns->count ? lag : columns->count / 4;
}

/* Squares of second differences over the variance expected from sensor noise. */
static void compare_differences(Columns *columns, size_t lag, size_t count) {
    const double *restrict y = columns->y, *restrict variance = columns->variance;
    double *restrict ratio = columns->ratio;
    for (size_t i = 0; i < count; i++) {
        double off = (y[i] + y[i + 2 * lag]) - 2 * y[i + lag];
        ratio[i] = off * off / ((variance[i] + variance[i + 2 * lag]) + 4 * variance[i + lag]);
    }
}

/* Squares of second differences as variances of centres. */
static void square_differences(Columns *columns, size_t lag, size_t count) {
    const double *restrict y = columns->y;
    double *restrict square = columns->square;
    for (size_t i = 0; i < count; i++) {
        double off = (y[i] + y[i + 2 * lag]) - 2 * y[i + lag];
        square[i] = off * off / VARIANCES;
    }
}

/* Mean without outliers; the values beyond the last are scratch. */
static double clipped_mean(double *value, size_t count) {
    double limit = INFINITY, mean = 1;
    for (size_t i = count; i % PARTS; i++) value[i] = 0;
    for (int round = 0; count > 0 && round < ROUNDS; round++) {
        double sum[PARTS] = {0};
        for (size_t i = 0; i < count; i += PARTS)
            for (size_t j = 0; j < PARTS; j++) sum[j] += value[i + j] < limit ? value[i + j] : limit;
        mean = ((sum[0] + sum[1]) + (sum[2] + sum[3])) / (double)count;
        limit = MAX_SQUARE * mean;
    }
    return mean;
}

double excess(Scatter of, double expected) {
    return (EXPECTED_DIFFERENCES * expected + of.sum) / (EXPECTED_DIFFERENCES + (double)of.count);
}

Scatter scatter_at(Columns *columns, size_t lag) {
    size_t near = feasible_lag(lag, columns), count = differences(columns, near);
    compare_differences(columns, near, count);
    return (Scatter){clipped_mean(columns->ratio, count) * (double)count, count, lag, lag == FAR_LAG};
}

Scatter scatter(Columns *columns) {
    Scatter near = scatter_at(columns, NEAR_LAG), far = scatter_at(columns, FAR_LAG);
    return excess(far, 1) > BACKGROUND * excess(near, 1) ? far : near;
}

double scatter_variance(Columns *columns, Scatter of) {
    size_t lag = feasible_lag(of.lag, columns), count = differences(columns, lag);
    square_differences(columns, lag, count);
    return clipped_mean(columns->square, count);
}

/* ---- all pieces ---- */

static int by_excess(const void *first, const void *second) {
    double a = excess(((const PieceScatter *)first)->first, 1), b = excess(((const PieceScatter *)second)->first, 1);
    return (a > b) - (a < b);
}

double pooled_excess(PieceScatter *pieces, size_t count) {
    double all = 0, counted = 0, pooled = 1;
    for (size_t i = 0; i < count; i++) all += (double)pieces[i].first.count;
    qsort(pieces, count, sizeof *pieces, by_excess);
    for (size_t i = 0; i < count && 2 * counted < all; i++) {
        pooled = excess(pieces[i].first, 1);
        counted += (double)pieces[i].first.count;
    }
    return pooled;
}

/* Variance of a piece's centres: its own estimate and the pooled one, weighted geometric mean. */
static double piece_variance(Columns *columns, Scatter of, double pooled) {
    double expected = 0, count = (double)of.count, share = FRAME_DIFFERENCES / (FRAME_DIFFERENCES + count);
    for (size_t i = 0; i < columns->count; i++) expected += columns->variance[i];
    expected *= pooled / (double)columns->count;
    double shown = EXPECTED_DIFFERENCES * expected + count * scatter_variance(columns, of);
    return pow(expected, share) * pow(shown / (EXPECTED_DIFFERENCES + count), 1 - share);
}

/* Raises variances to the mean square in the window of each column; cumulative sums at its start and end are given. */
static void raise_between(const double *restrict from, const double *restrict to, double piece, size_t count,
                          double *restrict variance) {
    double squares = 2 * SURROUNDINGS + 1 + PIECE_DIFFERENCES, all = PIECE_DIFFERENCES * piece;
    for (size_t i = 0; i < count; i++) {
        double near = ((to[i] - from[i]) + all) / squares;
        variance[i] = variance[i] > near ? variance[i] : near;
    }
}

/* Raises the variance of one column near an end of the piece, where the window has fewer differences. */
static void raise_one(const double *sum, size_t i, size_t lag, size_t count, double piece, double *variance) {
    size_t from = i > lag + SURROUNDINGS ? i - lag - SURROUNDINGS : 0;
    size_t to = i + SURROUNDINGS + 1 > lag ? i + SURROUNDINGS + 1 - lag : 0;
    if (to > count) to = count;
    if (from > to) from = to;
    double near = (sum[to] - sum[from]) + PIECE_DIFFERENCES * piece;
    variance[i] = fmax(variance[i], near / ((double)(to - from) + PIECE_DIFFERENCES));
}

void raise_variances(Columns *columns, Scatter of, double pooled) {
    size_t lag = feasible_lag(of.lag, columns), count = differences(columns, lag);
    double piece = piece_variance(columns, of, pooled), limit = MAX_SQUARE * piece, *sum = columns->ratio;
    sum[0] = 0;
    for (size_t i = 0; i < count; i++)
        sum[i + 1] = sum[i] + (columns->square[i] < limit ? columns->square[i] : limit);
    size_t first = lag + SURROUNDINGS, all = 2 * SURROUNDINGS + 1, whole = count >= all ? count - all + 1 : 0;
    if (whole == 0) first = columns->count;
    for (size_t i = 0; i < first && i < columns->count; i++) raise_one(sum, i, lag, count, piece, columns->variance);
    if (whole) raise_between(sum, sum + all, piece, whole, columns->variance + first);
    for (size_t i = first + whole; i < columns->count; i++) raise_one(sum, i, lag, count, piece, columns->variance);
}
