/* Edges fitted to the amplitudes about a stripe's end, and their widths. */
#ifndef RINGPOSE_END_EDGES_H
#define RINGPOSE_END_EDGES_H

#include "end_noise.h"

enum { WIDTHS = 7, SHARP_WIDTHS = 5 };

/* Trial widths, in sigmas of the cross-section. The first five are sharp: a lens blurs no more along a stripe than
   across it. */
static const double WIDTH[WIDTHS] = {0.3, 0.4, 0.55, 0.75, 1.0, 1.4, 2.0};

/* Columns of the coarse search. */
enum { FIRST_PLACE = -12, LAST_PLACE = 6, PLACES = LAST_PLACE - FIRST_PLACE + 1 };

/* Best edge for each width: negative log likelihood, column, level outside as a share of the face's level. */
typedef struct {
    double cost[WIDTHS], position[WIDTHS], outside[WIDTHS];
    double first[PLACES]; /* costs of the coarse search */
} EdgeFit;

void fit_edge(const Columns *columns, double sigma, EdgeFit *fit);

/* Negative log likelihoods of edges of one width. */
void edge_costs(const Columns *columns, double width, const double *position, int count, double *cost);

/* Logarithm of a width in columns, and its information (inverse variance). */
typedef struct {
    double logarithm, information;
} EdgeWidth;

/* Width estimated from one end. */
EdgeWidth blur_width(const Columns *columns, const EdgeFit *fit, double sigma, double correlation);

/* Pooled width of all ends of an image, which have the blur of one lens in common. */
EdgeWidth pooled_width(const EdgeWidth *width, size_t ends, const EndParams *params);

/* An end's width, with the pooled one as a prior. */
EdgeWidth combined_width(const EdgeWidth *own, const EdgeWidth *common, const EndParams *params);

/* An edge of a given width. */
typedef struct {
    double position, width, outside;
    double per_width; /* derivative of the position with respect to the logarithm of the width */
} Edge;

Edge edge_of_width(const EdgeFit *fit, double sigma, double width);

/* Fills the table of the normal distribution function; called once, when the module is loaded. */
void fill_normal_cdf(void);

/* The normal distribution function between -4 and 4, as a table with steps of 0.01. Linear interpolation errs by 3e-6
   and takes a tenth of the time of erf(). */
enum { CDF_STEPS = 800 };
extern double NORMAL_CDF[CDF_STEPS + 1];

static inline double normal_cdf(double t) {
    if (!(t > -4)) return 0;
    if (t >= 4) return 1;
    double at = (t + 4) * 100;
    int low = at < CDF_STEPS - 1 ? (int)at : CDF_STEPS - 1; /* the last numbers below 4 become 800 when 4 is added */
    return NORMAL_CDF[low] + (NORMAL_CDF[low + 1] - NORMAL_CDF[low]) * (at - low);
}

static inline int argmin(const double *cost, int count) {
    int k = 0;
    for (int s = 1; s < count; s++)
        if (cost[s] < cost[k]) k = s;
    return k;
}

#endif
