/* Variance of a fitted edge position: u^T V u, Eq. (3.7) of ringpose-method(7), where fill_influence gives u and
   intensity_variance adds the parts of V; and the contribution of secondary minima of the cost. */
#include "end_sigmas.h"

#include <math.h>

/* Largest lag of correlated speckle. */
enum { LAGS = 5 };

#define ROOT_OF_TWO 1.4142135623730951
#define ROOT_OF_TWO_PI 2.5066282746310002

/* Derivative of the position, in widths, with respect to the relative error of the level: half the level over the slope
   at half the level. */
#define LEVEL_TO_POSITION (0.5 * ROOT_OF_TWO_PI)

/* Columns up to this distance from the edge enter the goodness of fit. */
#define CHI2_WIDTHS 3

#define MIN_INFORMATION 1e-12

/* Model of the columns: the visible share, and the derivatives with respect to position and levels. */
typedef struct {
    double shown[MAX_COLUMNS], slope[MAX_COLUMNS], beyond[MAX_COLUMNS], weight[MAX_COLUMNS];
    double fine[2 * MAX_COLUMNS]; /* share of the blur's square before the edge, at half columns from the first on */
} Shapes;

/* Derivative of the visible share with respect to the illuminated one. */
static double growth(const Columns *columns, int i, double illuminated) {
    if (!columns->clipped) return 1;
    double faint = columns->headroom[FAINT][i], half = columns->headroom[HALF][i], full = columns->headroom[FULL][i];
    double grows = illuminated < 0.5 ? faint + 4 * (half - faint) * illuminated
                                     : 2 * half - full + 4 * (full - half) * illuminated;
    return fmax(grows, 0);
}

static void fill_shapes(const Columns *columns, const Edge *edge, Shapes *shapes) {
    double step = columns->level * (1 - edge->outside) / (edge->width * ROOT_OF_TWO_PI);
    for (int i = 0; i < columns->count; i++) {
        double t = (edge->position - columns->along[i]) / edge->width, illuminated = normal_cdf(t);
        double shown = share_shown(columns, i, illuminated);
        shapes->shown[i] = shown;
        shapes->slope[i] = step * exp(-0.5 * t * t) * growth(columns, i, illuminated);
        shapes->beyond[i] = 1 - illuminated;
        shapes->weight[i] = 1 / column_variance(columns, i, shown);
    }
    for (int k = 0; k < 2 * columns->count; k++)
        shapes->fine[k] = normal_cdf(ROOT_OF_TWO * (edge->position - columns->along[0] - 0.5 * k) / edge->width);
}

/* Influence u = (J^T W J)^-1 J^T W of each column on the position; the levels are eliminated (Schur complement), the
   outside one if there is one. Suffixes of sums: p position, i inside, o outside. */
static void fill_influence(const Columns *columns, const Shapes *shapes, int has_beyond, double *influence) {
    double pp = 0, pi = 0, po = 0, ii = 0, io = 0, oo = 0;
    for (int k = 0; k < columns->count; k++) {
        double weight = shapes->weight[k], p = shapes->slope[k], i = shapes->shown[k], o = shapes->beyond[k];
        pp += p * p * weight;
        pi += p * i * weight;
        po += p * o * weight;
        ii += i * i * weight;
        io += i * o * weight;
        oo += o * o * weight;
    }
    if (!has_beyond) {
        po = io = 0;
        oo = 1;
    }
    double block = fmax(ii * oo - io * io, MIN_INFORMATION * ii * oo);
    double inside = 0, outside = 0; /* 0 if every column is saturated */
    if (block > 0) {
        inside = (pi * oo - po * io) / block;
        outside = has_beyond ? (po * ii - pi * io) / block : 0;
    }
    double information = fmax(pp - inside * pi - outside * po, MIN_INFORMATION);
    for (int k = 0; k < columns->count; k++)
        influence[k] = shapes->weight[k] *
                       (shapes->slope[k] - inside * shapes->shown[k] - outside * shapes->beyond[k]) / information;
}

/* Speckle covariance of two columns over that on the face: the lens averages grains that are smaller than its blur, and
   the edge cuts off some of them. */
static double shared_light(const Columns *columns, const Shapes *shapes, int i, int lag) {
    return shapes->fine[2 * i - lag] * columns->headroom[FULL][i] * columns->headroom[FULL][i - lag];
}

/* Variance due to speckle, with a Gaussian autocorrelation, Eq. (3.8): correlation^(lag^2). */
static double speckle_variance(const Columns *columns, const Shapes *shapes, const double *influence,
                               double correlation) {
    double sum = 0, fall = correlation, square = correlation * correlation, by = 1;
    for (int lag = 0; lag <= LAGS; lag++) {
        double product = 0;
        for (int i = lag; i < columns->count; i++)
            product += influence[i] * influence[i - lag] * shared_light(columns, shapes, i, lag);
        sum += (lag ? 2 : 1) * by * product;
        by *= fall;
        fall *= square;
    }
    return columns->speckle * fmax(sum, 0);
}

/* Variance due to independent noise of each column, and to background texture with correlation facet^lag. */
static double column_variance_sum(const Columns *columns, const Shapes *shapes, const double *influence, double facet) {
    double alone = 0, background = 0, before = 0;
    for (int i = 0; i < columns->count; i++) {
        double here = fabs(influence[i]) * sqrt(columns->texture[i]);
        double hidden = 1 - shapes->shown[i];
        alone += influence[i] * influence[i] *
                 (columns->noise + columns->shot * shapes->shown[i] + columns->clutter * hidden * hidden);
        background += here * (here + 2 * before);
        before = facet * (before + here);
    }
    return alone + background;
}

/* Independent part of the background texture, in addition to the part common to the columns of an edge. */
static double texture_variance(const Columns *columns, const double *influence) {
    double sum = 0;
    for (int i = 0; i < columns->count; i++) sum += influence[i] * influence[i] * columns->texture[i];
    return sum;
}

/* Relative variance of slow changes of the levels on both sides of an edge, beyond speckle: background,
   illumination. */
static double slow_level_variance(const Columns *columns, const Edge *edge, const EndParams *params) {
    double full[MAX_COLUMNS], beyond[MAX_COLUMNS];
    int inner = 0, outer = 0;
    for (int i = 0; i < columns->count; i++) {
        double from = columns->along[i] - edge->position, value = columns->amplitude[i] / columns->level;
        if (from < -3 * edge->width) full[inner++] = value / fmax(columns->headroom[FULL][i], params->min_headroom);
        if (from > 3 * edge->width && from < params->near_columns) beyond[outer++] = value;
    }
    double speckle = columns->speckle / (columns->level * columns->level);
    return fmax(slow_variance(full, inner, 1) - speckle, 0) + slow_variance(beyond, outer, edge->outside);
}

/* Reduced chi-square of the columns about an edge, at least 1: glints and foil raise it. */
static double reduced_chi2(const Columns *columns, const Shapes *shapes, const Edge *edge) {
    double square = 0, count = 0;
    for (int i = 0; i < columns->count; i++) {
        if (fabs(columns->along[i] - edge->position) > CHI2_WIDTHS * edge->width + 1) continue;
        double off = columns->amplitude[i] / columns->level - shapes->shown[i] - edge->outside * shapes->beyond[i];
        square += off * off * columns->level * columns->level * shapes->weight[i];
        count += 1;
    }
    return count > 2 ? fmax(square / (count - 2) - 1, 1) : 1;
}

/* Visible share of the stripe in each column. */
static void show_edge(const Columns *columns, const Edge *edge, double *shown) {
    for (int i = 0; i < columns->count; i++)
        shown[i] = share_shown(columns, i, normal_cdf((edge->position - columns->along[i]) / edge->width));
}

/* Variance of the sum of the columns' amplitudes, each times its influence. */
static double intensity_variance(const Columns *columns, const Edge *edge, const double *influence,
                                 double correlation) {
    Shapes shapes;
    fill_shapes(columns, edge, &shapes);
    return column_variance_sum(columns, &shapes, influence, columns->facet) +
           speckle_variance(columns, &shapes, influence, correlation);
}

double second_order_bias(const Columns *columns, const Edge *edge, double variance) {
    Shapes shapes;
    double influence[MAX_COLUMNS] = {0}, curvature = 0, square = edge->width * edge->width;
    fill_shapes(columns, edge, &shapes);
    fill_influence(columns, &shapes, edge->outside > 0, influence);
    for (int i = 0; i < columns->count; i++)
        curvature += influence[i] * shapes.slope[i] * (columns->along[i] - edge->position) / square;
    return -0.5 * fmin(variance, square) * curvature;
}

/* u^T V u, Eq. (3.7), and the contributions of background, width and blur model. */
double edge_variance(const Columns *columns, const Edge *edge, double correlation, double information,
                     const EndParams *params) {
    Shapes shapes;
    double influence[MAX_COLUMNS] = {0}, shift = LEVEL_TO_POSITION * edge->width;
    fill_shapes(columns, edge, &shapes);
    fill_influence(columns, &shapes, edge->outside > 0, influence);
    double variance = column_variance_sum(columns, &shapes, influence, 1) + texture_variance(columns, influence) +
                  speckle_variance(columns, &shapes, influence, correlation);
    return variance * reduced_chi2(columns, &shapes, edge) +
           slow_level_variance(columns, edge, params) * shift * shift +
           edge->per_width * edge->per_width / information + params->shape_sigma * params->shape_sigma;
}

/* Alternative positions on either side, in whole columns. */
enum { STEPS = LAST_PLACE - FIRST_PLACE };

/* Positions whose coarse negative log likelihood exceeds the minimum by more than this are ignored. */
#define OPEN 40

/* Relative likelihood below which the noise model is not reliable. */
#define MIN_LIKELIHOOD 0.05

#define MIN_SHARE 1e-3

static double min_first_cost(const EdgeFit *fit) {
    double minimum = INFINITY;
    for (int k = 0; k < PLACES; k++) minimum = fmin(minimum, fit->first[k]);
    return minimum;
}

/* Steps from the edge to alternative positions, selected by the costs of the coarse search. */
static int open_steps(const EdgeFit *fit, const Edge *edge, double *step) {
    double maximum = min_first_cost(fit) + OPEN;
    int count = 0;
    for (int k = -STEPS; k <= STEPS; k++) {
        double nearest = rint(edge->position + k) - FIRST_PLACE;
        if (k && nearest >= 0 && nearest < PLACES && fit->first[(int)nearest] < maximum) step[count++] = k;
    }
    return count;
}

/* Factor by which correlated columns distinguish two positions less well than independent ones. */
static double independent_share(const Columns *columns, const Edge *edge, double place, double correlation) {
    Edge outer = *edge, other = *edge;
    other.position = place;
    outer.position = fmax(place, edge->position);
    double here[MAX_COLUMNS], there[MAX_COLUMNS], shown[MAX_COLUMNS], influence[MAX_COLUMNS], alone = 0;
    show_edge(columns, edge, here);
    show_edge(columns, &other, there);
    show_edge(columns, &outer, shown);
    for (int i = 0; i < columns->count; i++) {
        double variance = column_variance(columns, i, shown[i]);
        influence[i] = (1 - edge->outside) * (here[i] - there[i]) / variance;
        alone += influence[i] * influence[i] * variance;
    }
    double together = intensity_variance(columns, &outer, influence, correlation);
    return fmin(alone / fmax(fmax(together, MIN_SHARE * alone), 1e-30), 1);
}

double variance_over_places(const Columns *columns, const EdgeFit *fit, const Edge *edge, double variance,
                            double correlation) {
    double step[2 * STEPS + 1], place[2 * STEPS + 1], cost[2 * STEPS + 1];
    int count = open_steps(fit, edge, step);
    double weights = ROOT_OF_TWO_PI * sqrt(variance), squares = weights * variance;
    if (!count) return variance;
    for (int k = 0; k < count; k++) place[k] = edge->position + step[k];
    place[count] = edge->position;
    edge_costs(columns, edge->width, place, count + 1, cost);
    for (int k = 0; k < count; k++) {
        double share = independent_share(columns, edge, place[k], correlation);
        double likelihood = exp(-fmax(cost[k] - cost[count], 0) * share), square = step[k] * step[k];
        double weight = fmax(likelihood - exp(-0.5 * square / variance) - MIN_LIKELIHOOD, 0);
        weights += weight;
        squares += weight * square;
    }
    return squares / weights;
}
