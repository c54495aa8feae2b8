/* Edges fitted to the brightness of a stripe about its end. */
#include "end_fits.h"

#include <math.h>
#include <string.h>

#include "minimum.h"
#include "kernels.h"
#include "normal_cdf.h"

/* Sums are kept in so many parts, as vectors do it. */
enum { PARTS = 4 };

/* Steps of the fine search, its step in columns, and the width that it begins with. */
enum { FINE = 21, MIDDLE = 3 };
#define FINE_STEP 0.15

/* What the columns add to the equations for the two levels, and to the likelihood. */
typedef struct {
    double inside, both, outside, in_value, out_value, square, logarithm;
} Sums;

/* Sums over the columns up to each one, if all lay inside the edge, and if all lay outside. */
typedef struct {
    Sums in[MOST_COLUMNS + 1], out[MOST_COLUMNS + 1];
} Running;

static void add(Sums *sums, double in, double out, double value, double variance) {
    double weight = 1 / variance;
    sums->inside += in * in * weight;
    sums->both += in * out * weight;
    sums->outside += out * out * weight;
    sums->in_value += in * value * weight;
    sums->out_value += out * value * weight;
    sums->square += value * value * weight;
}

static void add_range(Sums *sums, const Sums *from, const Sums *to) {
    sums->inside += to->inside - from->inside;
    sums->outside += to->outside - from->outside;
    sums->in_value += to->in_value - from->in_value;
    sums->out_value += to->out_value - from->out_value;
    sums->square += to->square - from->square;
    sums->logarithm += to->logarithm - from->logarithm;
}

static void run(const Columns *columns, Running *running) {
    memset(running, 0, sizeof *running);
    for (int i = 0; i < columns->count; i++) {
        double head = columns->room[FULL][i], value = columns->amplitude[i];
        running->in[i + 1] = running->in[i];
        running->out[i + 1] = running->out[i];
        add(&running->in[i + 1], head, 0, value, column_variance(columns, i, head));
        add(&running->out[i + 1], 0, 1, value, column_variance(columns, i, 0));
        running->in[i + 1].logarithm += log(column_variance(columns, i, head));
        running->out[i + 1].logarithm += log(column_variance(columns, i, 0));
    }
}

/* Columns in which an edge lies: their shares of both levels, and what is seen there. */
typedef struct {
    double in[MOST_COLUMNS + PARTS], out[MOST_COLUMNS + PARTS], value[MOST_COLUMNS + PARTS],
        variance[MOST_COLUMNS + PARTS];
} Weighted;

/* GNU C's vectors: the compilers do not see that sums may be kept in parts. */
typedef double Doubles __attribute__((vector_size(8 * PARTS), aligned(8), may_alias));
#define DOUBLES(address) (*(const Doubles *)(address))

static inline double total(Doubles part) { return (part[0] + part[1]) + (part[2] + part[3]); }

/* Adds the logarithms of variances, as few as their product's range allows. */
static double logarithm(const double *variance, int n) {
    double product = 1, sum = 0;
    for (int i = 0; i < n; i++) {
        product *= variance[i];
        if (product > 1e-150 && product < 1e150) continue;
        sum += log(product);
        product = 1;
    }
    return sum + log(product);
}

static void add_weighted(Weighted *columns, int n, Sums *sums) {
    Doubles inside = {0}, both = {0}, outside = {0}, in_value = {0}, out_value = {0}, square = {0};
    sums->logarithm += logarithm(columns->variance, n);
    for (int i = n; i % PARTS; i++) {
        columns->in[i] = columns->out[i] = columns->value[i] = 0;
        columns->variance[i] = 1;
    }
    for (int i = 0; i < n; i += PARTS) {
        Doubles in = DOUBLES(columns->in + i), out = DOUBLES(columns->out + i), value = DOUBLES(columns->value + i);
        Doubles weight = 1 / DOUBLES(columns->variance + i);
        inside += in * in * weight;
        both += in * out * weight;
        outside += out * out * weight;
        in_value += in * value * weight;
        out_value += out * value * weight;
        square += value * value * weight;
    }
    sums->inside += total(inside);
    sums->both += total(both);
    sums->outside += total(outside);
    sums->in_value += total(in_value);
    sums->out_value += total(out_value);
    sums->square += total(square);
}

/* Minus log likelihood of an edge with its best levels, and the outside level's share of the inside. Columns ascend
   in `along`; more than four widths from the edge they lie wholly on one side. */
static double edge_cost(const Columns *columns, const Running *running, double position, double width,
                        double *outside) {
    Sums sums = {0};
    Weighted weighted;
    int n = 0;
    double before = position - 4 * width - columns->along[0]; /* columns wholly inside */
    int count = columns->count, first = before > 0 ? (int)before : 0, last;
    double per_width = 1 / width;
    if (first > count) first = count;
    while (first < count && (position - columns->along[first]) * per_width >= 4) first++;
    add_range(&sums, &running->in[0], &running->in[first]);
    for (last = first; last < count; last++) {
        double steps = (position - columns->along[last]) * per_width;
        if (!(steps > -4)) break;
        double edge = normal_cdf(steps), in = share_shown(columns, last, edge);
        weighted.in[n] = in;
        weighted.out[n] = 1 - edge;
        weighted.value[n] = columns->amplitude[last];
        weighted.variance[n++] = column_variance(columns, last, in);
    }
    add_weighted(&weighted, n, &sums);
    add_range(&sums, &running->out[last], &running->out[count]);
    double determinant = fmax(sums.inside * sums.outside - sums.both * sums.both, 1e-30);
    double within = fmax((sums.outside * sums.in_value - sums.both * sums.out_value) / determinant, 1e-6);
    double beyond = (sums.inside * sums.out_value - sums.both * sums.in_value) / determinant;
    beyond = fmin(fmax(beyond, 0), within);
    *outside = beyond / within;
    double square = sums.square - 2 * within * sums.in_value - 2 * beyond * sums.out_value +
                    within * within * sums.inside + 2 * within * beyond * sums.both + beyond * beyond * sums.outside;
    return 0.5 * (square + sums.logarithm);
}

/* A search for one end at one width. */
typedef struct {
    const Columns *columns;
    const Running *running;
    double width;
} Search;

static double cost_at(const Search *search, double position, double *outside) {
    return edge_cost(search->columns, search->running, position, search->width, outside);
}

/* Where the edge lies to half a column: the best of whole columns, and the halves beside it. */
static double coarse_position(const Search *search, double *first) {
    double least = INFINITY, best = 0, ignored;
    for (int k = 0; k < PLACES; k++) {
        first[k] = cost_at(search, FIRST_PLACE + k, &ignored);
        if (!(first[k] < least)) continue;
        least = first[k];
        best = FIRST_PLACE + k;
    }
    double before = cost_at(search, best - 0.5, &ignored), after = cost_at(search, best + 0.5, &ignored);
    if (before < least && !(after < before)) return best - 0.5;
    return after < least ? best + 0.5 : best;
}

static void try_step(const Search *search, double start, int k, double *cost, double *level) {
    if (isnan(cost[k])) cost[k] = cost_at(search, start + (k - FINE / 2) * FINE_STEP, &level[k]);
}

/* Downhill in fine steps about `start` from step `k`, then a parabola; returns the lowest step. */
static int descend(const Search *search, double start, int k, EdgeFit *fit, int s) {
    double cost[FINE], level[FINE];
    for (int j = 0; j < FINE; j++) cost[j] = NAN;
    try_step(search, start, k, cost, level);
    for (int next = k;; k = next) {
        if (k > 0) try_step(search, start, k - 1, cost, level);
        if (k < FINE - 1) try_step(search, start, k + 1, cost, level);
        if (k > 0 && cost[k - 1] < cost[next]) next = k - 1;
        if (k < FINE - 1 && cost[k + 1] < cost[next]) next = k + 1;
        if (next == k) break;
    }
    double shift = k > 0 && k < FINE - 1 ? parabola(cost[k - 1], cost[k], cost[k + 1]) : 0;
    fit->cost[s] = cost[k];
    fit->position[s] = start + (k - FINE / 2 + shift) * FINE_STEP;
    fit->outside[s] = level[k];
    return k;
}

/* The middle width first, then from each to its neighbour, whose edge hardly lies elsewhere. */
void fit_edge(const Columns *columns, double sigma, EdgeFit *fit) {
    Running running;
    run(columns, &running);
    double start = coarse_position(&(Search){columns, &running, 0.8 * sigma}, fit->first);
    int middle = descend(&(Search){columns, &running, WIDTH[MIDDLE] * sigma}, start, FINE / 2, fit, MIDDLE);
    for (int s = MIDDLE - 1, k = middle; s >= 0; s--)
        k = descend(&(Search){columns, &running, WIDTH[s] * sigma}, start, k, fit, s);
    for (int s = MIDDLE + 1, k = middle; s < WIDTHS; s++)
        k = descend(&(Search){columns, &running, WIDTH[s] * sigma}, start, k, fit, s);
}

void edge_costs(const Columns *columns, double width, const double *position, int count, double *cost) {
    Running running;
    double ignored;
    run(columns, &running);
    for (int k = 0; k < count; k++) cost[k] = edge_cost(columns, &running, position[k], width, &ignored);
}
