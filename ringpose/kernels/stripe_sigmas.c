/* What differences between the centres of a piece say of their standard deviations; twin: reference_stripe_sigmas.py.

   Second differences do not see where a straight piece runs. Near ones show speckle, far ones what surrounds it. */
#include "stripe_columns.h"

#include <math.h>

/* Columns over which the speckle of two centres has become independent (grains of about 3 px), and a background. */
enum { NEAR_LAG = 4, FAR_LAG = 20 };

/* Far centres differ by so much more than near ones where the surroundings of a stripe spoil it. */
#define BACKGROUND 1.75

/* The sensor's noise counts as much as so many differences. */
#define PRIOR_DIFFERENCES 4.0

/* Squares count up to this many times their mean. */
#define LARGEST_SQUARE 25.0
enum { ROUNDS = 3 };

/* Differences on either side that are a column's surroundings, and as how many those of all the piece count. */
enum { SURROUNDINGS = 24 };
#define PIECE_DIFFERENCES 16.0

/* A second difference has six times the variance of a centre. */
#define VARIANCES 6.0

/* How many centres have a neighbour at that distance on both sides. */
static size_t differences(const Columns *columns, size_t lag) {
    return lag > 0 ? columns->count - 2 * lag : 0;
}

/* A short piece has to do with nearer neighbours. */
static size_t fitting(size_t lag, const Columns *columns) {
    return 4 * lag < columns->count ? lag : columns->count / 4;
}

/* Squares of second differences over what the sensor's noise explains. */
VECTOR_LOOP
static void compare_differences(Columns *columns, size_t lag, size_t count) {
    const double *restrict y = columns->y, *restrict variance = columns->variance;
    double *restrict ratio = columns->ratio;
    for (size_t i = 0; i < count; i++) {
        double off = (y[i] + y[i + 2 * lag]) - 2 * y[i + lag];
        ratio[i] = off * off / ((variance[i] + variance[i + 2 * lag]) + 4 * variance[i + lag]);
    }
}

/* Squares of second differences as variances of centres. */
VECTOR_LOOP
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
        limit = LARGEST_SQUARE * mean;
    }
    return mean;
}

static double excess(Columns *columns, size_t lag) {
    size_t count = differences(columns, fitting(lag, columns));
    compare_differences(columns, fitting(lag, columns), count);
    double sum = PRIOR_DIFFERENCES + clipped_mean(columns->ratio, count) * (double)count;
    return sum / (PRIOR_DIFFERENCES + (double)count);
}

Scatter scatter(Columns *columns) {
    double near = excess(columns, NEAR_LAG), far = excess(columns, FAR_LAG);
    int background = far > BACKGROUND * near;
    return (Scatter){background ? far : near, background ? FAR_LAG : NEAR_LAG, background};
}

double scatter_variance(Columns *columns, Scatter of) {
    size_t lag = fitting(of.lag, columns), count = differences(columns, lag);
    square_differences(columns, lag, count);
    return clipped_mean(columns->square, count);
}

/* Adds to the variance of each column that of its surroundings, that of all the piece counting as some more. */
static void add_locally(Columns *columns, Scatter of) {
    size_t lag = fitting(of.lag, columns), count = differences(columns, lag);
    double piece = scatter_variance(columns, of), limit = LARGEST_SQUARE * piece, *sum = columns->ratio;
    sum[0] = 0;
    for (size_t i = 0; i < count; i++)
        sum[i + 1] = sum[i] + (columns->square[i] < limit ? columns->square[i] : limit);
    for (size_t i = 0; i < columns->count; i++) {
        size_t from = i > lag + SURROUNDINGS ? i - lag - SURROUNDINGS : 0;
        size_t to = i + SURROUNDINGS + 1 > lag ? i + SURROUNDINGS + 1 - lag : 0;
        if (to > count) to = count;
        if (from > to) from = to;
        double local = (sum[to] - sum[from]) + PIECE_DIFFERENCES * piece;
        columns->variance[i] += local / ((double)(to - from) + PIECE_DIFFERENCES);
    }
}

void raise_variances(Columns *columns, Scatter of) {
    if (of.excess > CLUTTERED)
        add_locally(columns, of);
    else
        for (size_t i = 0; i < columns->count; i++) columns->variance[i] *= of.excess;
}
