/* Maximum-likelihood fit of an edge, level inside + level outside + error function, to the amplitudes about a stripe's
   end, and the width that the edges of an image have in common. */
#include "end_edges.h"
#include "kernels.h"

#include <math.h>
#include <string.h>

double NORMAL_CDF[CDF_STEPS + 1];

void fill_normal_cdf(void) {
    for (int i = 0; i <= CDF_STEPS; i++) NORMAL_CDF[i] = 0.5 * (1 + erf((-4 + 8.0 * i / CDF_STEPS) / sqrt(2)));
}

/* Partial sums, as a vector register holds them. */
enum { PARTS = 4 };

/* Steps of the fine search, index of the width that it begins with, and step in columns. */
enum { FINE = 21, MIDDLE = 3 };
#define FINE_STEP 0.15

/* Sums over columns for the normal equations of the two levels and for the likelihood. */
typedef struct {
    double inside, both, outside, in_value, out_value, square, logarithm;
} Sums;

/* Cumulative sums over the columns, with all of them inside the edge, and with all of them outside. */
typedef struct {
    Sums in[MAX_COLUMNS + 1], out[MAX_COLUMNS + 1];
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
        double head = columns->headroom[FULL][i], value = columns->amplitude[i];
        running->in[i + 1] = running->in[i];
        running->out[i + 1] = running->out[i];
        add(&running->in[i + 1], head, 0, value, column_variance(columns, i, head));
        add(&running->out[i + 1], 0, 1, value, column_variance(columns, i, 0));
        running->in[i + 1].logarithm += log(column_variance(columns, i, head));
        running->out[i + 1].logarithm += log(column_variance(columns, i, 0));
    }
}

/* Columns within four widths of the edge: their shares of both levels, amplitude and variance. */
typedef struct {
    double in[MAX_COLUMNS + PARTS], out[MAX_COLUMNS + PARTS], value[MAX_COLUMNS + PARTS],
        variance[MAX_COLUMNS + PARTS];
} Weighted;

/* GNU C vectors: compilers do not reorder floating-point sums by themselves. */
typedef double Doubles __attribute__((vector_size(8 * PARTS), aligned(8), may_alias));
#define DOUBLES(address) (*(const Doubles *)(address))

static inline double total(Doubles part) { return (part[0] + part[1]) + (part[2] + part[3]); }

/* Sum of the logarithms of variances; products are accumulated as far as their range allows. */
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

/* Negative log likelihood of an edge, maximised over its two levels, and the ratio of the levels. Columns ascend in
   `along`; those more than four widths from the edge lie entirely on one side. */
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

/* Search for an end with edges of one width. */
typedef struct {
    const Columns *columns;
    const Running *running;
    double width;
} Search;

static double cost_at(const Search *search, double position, double *outside) {
    return edge_cost(search->columns, search->running, position, search->width, outside);
}

/* Position to half a column: the best integer column, then the half columns next to it. */
static double coarse_position(const Search *search, double *first) {
    double minimum = INFINITY, best = 0, ignored;
    for (int k = 0; k < PLACES; k++) {
        first[k] = cost_at(search, FIRST_PLACE + k, &ignored);
        if (!(first[k] < minimum)) continue;
        minimum = first[k];
        best = FIRST_PLACE + k;
    }
    double before = cost_at(search, best - 0.5, &ignored), after = cost_at(search, best + 0.5, &ignored);
    if (before < minimum && !(after < before)) return best - 0.5;
    return after < minimum ? best + 0.5 : best;
}

static void try_step(const Search *search, double start, int k, double *cost, double *level) {
    if (isnan(cost[k])) cost[k] = cost_at(search, start + (k - FINE / 2) * FINE_STEP, &level[k]);
}

/* Descent in fine steps about `start` from step `k`, then parabolic interpolation; returns the step of lowest cost. */
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

/* The middle width first; each other width starts at the position found for its neighbour. */
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

#define MIN_INFORMATION 1e-3

enum { ROUNDS = 2 };

/* Index of the middle one of three sharp widths about index k. */
static int inner_width(int k) { return k < 1 ? 1 : k > SHARP_WIDTHS - 2 ? SHARP_WIDTHS - 2 : k; }

EdgeWidth blur_width(const Columns *columns, const EdgeFit *fit, double sigma, double correlation) {
    int best = argmin(fit->cost, SHARP_WIDTHS), k = inner_width(best);
    const double *w = &WIDTH[k], *cost = &fit->cost[k];
    double before = (cost[0] - cost[-1]) / (w[0] - w[-1]), after = (cost[1] - cost[0]) / (w[1] - w[0]);
    double curvature = (after - before) / (w[1] - w[-1]);
    if (!(curvature > 0)) return (EdgeWidth){log(WIDTH[best] * sigma), MIN_INFORMATION};
    double width = fmin(fmax(0.5 * (w[-1] + w[0]) - 0.5 * before / curvature, w[-1]), w[1]);
    double correlation_length = correlation_length_for_width(columns, correlation, width * sigma);
    return (EdgeWidth){log(width * sigma), fmax(2 * curvature * width * width / correlation_length, MIN_INFORMATION)};
}

/* Weight of an end's width in the pooled one, with the spread of widths between ends. */
static double weight_of(const EdgeWidth *width, const EndParams *params) {
    return 1 / (1 / width->information + params->width_spread * params->width_spread);
}

/* Lower weighted median. */
static double middle_width(const EdgeWidth *width, size_t ends, const EndParams *params) {
    double all = 0, middle = INFINITY;
    for (size_t i = 0; i < ends; i++) all += weight_of(&width[i], params);
    for (size_t i = 0; i < ends; i++) {
        double below = 0;
        for (size_t j = 0; j < ends; j++)
            if (width[j].logarithm <= width[i].logarithm) below += weight_of(&width[j], params);
        if (below >= 0.5 * all && width[i].logarithm < middle) middle = width[i].logarithm;
    }
    return middle;
}

EdgeWidth pooled_width(const EdgeWidth *width, size_t ends, const EndParams *params) {
    EdgeWidth common = {middle_width(width, ends, params), 0};
    for (int round = 0; round < ROUNDS; round++) {
        double sum = 0, weights = 0;
        for (size_t i = 0; i < ends; i++) {
            double weight = weight_of(&width[i], params), away = width[i].logarithm - common.logarithm;
            weight /= 1 + 0.25 * weight * away * away; /* Cauchy weight */
            sum += weight * width[i].logarithm;
            weights += weight;
        }
        common = (EdgeWidth){sum / weights, weights};
    }
    return common;
}

EdgeWidth combined_width(const EdgeWidth *own, const EdgeWidth *common, const EndParams *params) {
    double others = weight_of(common, params), all = own->information + others;
    return (EdgeWidth){(own->logarithm * own->information + common->logarithm * others) / all, all};
}

/* Lagrange interpolation over the three nearest trial widths. */
Edge edge_of_width(const EdgeFit *fit, double sigma, double width) {
    double at = fmin(fmax(width / sigma, WIDTH[0]), WIDTH[SHARP_WIDTHS - 1]);
    int k = 0;
    for (int s = 1; s < SHARP_WIDTHS; s++)
        if (at * at > WIDTH[s - 1] * WIDTH[s]) k = s;
    k = inner_width(k);
    const double *w = &WIDTH[k], *position = &fit->position[k];
    double a = at - w[-1], b = at - w[0], c = at - w[1];
    double first = position[-1] / ((w[-1] - w[0]) * (w[-1] - w[1]));
    double second = position[0] / ((w[0] - w[-1]) * (w[0] - w[1]));
    double third = position[1] / ((w[1] - w[-1]) * (w[1] - w[0]));
    int low = at < w[0] ? -1 : 0;
    double share = (at - w[low]) / (w[low + 1] - w[low]);
    const double *outside = &fit->outside[k];
    return (Edge){first * b * c + second * a * c + third * a * b, at * sigma,
                  outside[low] + (outside[low + 1] - outside[low]) * share,
                  (first * (b + c) + second * (a + c) + third * (a + b)) * at};
}
