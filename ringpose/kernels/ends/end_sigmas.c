/* How well the end of a stripe is known: the u^T V u of ringpose-method(7), section 3. fill_influence gives u,
   light_noise adds the parts of V. */
#include "end_sigmas.h"

#include <math.h>

#include "normal_cdf.h"

/* Neighbours whose speckle is alike. */
enum { LAGS = 5 };

#define ROOT_OF_TWO 1.4142135623730951
#define ROOT_OF_TWO_PI 2.5066282746310002

/* Share of speckle's grains that the optics resolve. */
#define RESOLVED 0.25

/* Columns, in widths, by which an edge moves if the level differs by so much of itself from what it seems to be: half
   of it over the slope at half of it. */
#define LEVEL_TO_POSITION (0.5 * ROOT_OF_TWO_PI)

/* Columns so near to an edge tell whether it is one. */
#define MISFIT_WIDTHS 3

#define LEAST_INFORMATION 1e-12

/* What the columns show of an edge, and how it changes with the edge's position and both levels. */
typedef struct {
    double shown[MOST_COLUMNS], slope[MOST_COLUMNS], beyond[MOST_COLUMNS], weight[MOST_COLUMNS];
    double fine[2 * MOST_COLUMNS]; /* share of the blur's square before the edge, at half columns from the first on */
} Shapes;

/* How what is shown grows with what is lit. */
static double growth(const Columns *columns, int i, double lit) {
    if (!columns->clipped) return 1;
    double faint = columns->room[FAINT][i], half = columns->room[HALF][i], full = columns->room[FULL][i];
    double grows = lit < 0.5 ? faint + 4 * (half - faint) * lit : 2 * half - full + 4 * (full - half) * lit;
    return fmax(grows, 0);
}

static void fill_shapes(const Columns *columns, const Edge *edge, Shapes *shapes) {
    double step = columns->level * (1 - edge->outside) / (edge->width * ROOT_OF_TWO_PI);
    for (int i = 0; i < columns->count; i++) {
        double t = (edge->position - columns->along[i]) / edge->width, lit = normal_cdf(t);
        double shown = share_shown(columns, i, lit);
        shapes->shown[i] = shown;
        shapes->slope[i] = step * exp(-0.5 * t * t) * growth(columns, i, lit);
        shapes->beyond[i] = 1 - lit;
        shapes->weight[i] = 1 / column_variance(columns, i, shown);
    }
    for (int k = 0; k < 2 * columns->count; k++)
        shapes->fine[k] = normal_cdf(ROOT_OF_TWO * (edge->position - columns->along[0] - 0.5 * k) / edge->width);
}

/* How much each column's light moves the edge, both levels being fitted as well, the one beyond if there is one. */
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
    double block = fmax(ii * oo - io * io, LEAST_INFORMATION * ii * oo);
    double inside = 0, outside = 0; /* where all is saturated nothing shows a level */
    if (block > 0) {
        inside = (pi * oo - po * io) / block;
        outside = has_beyond ? (po * ii - pi * io) / block : 0;
    }
    double information = fmax(pp - inside * pi - outside * po, LEAST_INFORMATION);
    for (int k = 0; k < columns->count; k++)
        influence[k] = shapes->weight[k] *
                       (shapes->slope[k] - inside * shapes->shown[k] - outside * shapes->beyond[k]) / information;
}

/* How much light two columns share that grains vary by, over what they would on the face. Of grains that the optics
   resolve each column shows what it shows of the stripe; of finer ones, which they average, the edge leaves fewer to
   both. No image tells which they are; grains before a lens of f/8 are as wide as a pixel, finer than most blurs. */
static double shared_light(const Columns *columns, const Shapes *shapes, int i, int lag) {
    double resolved = shapes->shown[i] * shapes->shown[i - lag];
    double averaged = shapes->fine[2 * i - lag] * columns->room[FULL][i] * columns->room[FULL][i - lag];
    return RESOLVED * resolved + (1 - RESOLVED) * averaged;
}

/* Variance by speckle; that of neighbours is alike: a Gaussian, `likeness` to the power of their distance's square. */
static double speckle_noise(const Columns *columns, const Shapes *shapes, const double *influence, double likeness) {
    double alike = 0, fall = likeness, square = likeness * likeness, by = 1;
    for (int lag = 0; lag <= LAGS; lag++) {
        double product = 0;
        for (int i = lag; i < columns->count; i++)
            product += influence[i] * influence[i - lag] * shared_light(columns, shapes, i, lag);
        alike += (lag ? 2 : 1) * by * product;
        by *= fall;
        fall *= square;
    }
    return columns->speckle * fmax(alike, 0);
}

/* Variance by what each column varies by itself, and what lies beneath, so much alike in neighbours. */
static double column_noise(const Columns *columns, const Shapes *shapes, const double *influence, double facet) {
    double alone = 0, beneath = 0, before = 0;
    for (int i = 0; i < columns->count; i++) {
        double here = fabs(influence[i]) * sqrt(columns->texture[i]);
        alone += influence[i] * influence[i] * (columns->noise + columns->shot * shapes->shown[i]);
        beneath += here * (here + 2 * before);
        before = facet * (before + here);
    }
    return alone + beneath;
}

/* What lies beneath is alike in the few columns of an edge; what differs between them adds to that. */
static double texture_noise(const Columns *columns, const double *influence) {
    double sum = 0;
    for (int i = 0; i < columns->count; i++) sum += influence[i] * influence[i] * columns->texture[i];
    return sum;
}

/* Relative variance of the levels on both sides of an edge that neighbours share beyond grains of speckle: what lies
   beneath the stripe, how it is lit. */
static double slow_levels(const Columns *columns, const Edge *edge, const EndRules *rules) {
    double full[MOST_COLUMNS], beyond[MOST_COLUMNS];
    int inner = 0, outer = 0;
    for (int i = 0; i < columns->count; i++) {
        double from = columns->along[i] - edge->position, value = columns->amplitude[i] / columns->level;
        if (from < -3 * edge->width) full[inner++] = value / fmax(columns->room[FULL][i], rules->least_headroom);
        if (from > 3 * edge->width && from < rules->near_columns) beyond[outer++] = value;
    }
    double speckle = columns->speckle / (columns->level * columns->level);
    return fmax(slow_variance(full, inner, 1) - speckle, 0) + slow_variance(beyond, outer, edge->outside);
}

/* By how much more than expected the columns about an edge differ from it: glints, foil. */
static double misfit(const Columns *columns, const Shapes *shapes, const Edge *edge) {
    double square = 0, count = 0;
    for (int i = 0; i < columns->count; i++) {
        if (fabs(columns->along[i] - edge->position) > MISFIT_WIDTHS * edge->width + 1) continue;
        double off = columns->amplitude[i] / columns->level - shapes->shown[i] - edge->outside * shapes->beyond[i];
        square += off * off * columns->level * columns->level * shapes->weight[i];
        count += 1;
    }
    return count > 2 ? fmax(square / (count - 2) - 1, 1) : 1;
}

void show_edge(const Columns *columns, const Edge *edge, double *shown) {
    for (int i = 0; i < columns->count; i++)
        shown[i] = share_shown(columns, i, normal_cdf((edge->position - columns->along[i]) / edge->width));
}

double light_noise(const Columns *columns, const Edge *edge, const double *influence, double likeness) {
    Shapes shapes;
    fill_shapes(columns, edge, &shapes);
    return column_noise(columns, &shapes, influence, columns->facet) +
           speckle_noise(columns, &shapes, influence, likeness);
}

double edge_variance(const Columns *columns, const Edge *edge, double likeness, double information,
                     const EndRules *rules) {
    Shapes shapes;
    double influence[MOST_COLUMNS] = {0}, shift = LEVEL_TO_POSITION * edge->width;
    fill_shapes(columns, edge, &shapes);
    fill_influence(columns, &shapes, edge->outside > 0, influence);
    double seen = column_noise(columns, &shapes, influence, 1) + texture_noise(columns, influence) +
                  speckle_noise(columns, &shapes, influence, likeness);
    return seen * misfit(columns, &shapes, edge) + slow_levels(columns, edge, rules) * shift * shift +
           edge->per_width * edge->per_width / information + rules->shape_sigma * rules->shape_sigma;
}
