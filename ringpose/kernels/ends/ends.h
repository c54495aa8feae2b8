/* The stages of the search for stripe endpoints: profile, noise model, edge fit, variance. */
#ifndef RINGPOSE_ENDS_H
#define RINGPOSE_ENDS_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "lens.h"

/* ---- images and parameters ---- */

typedef struct {
    const void *lit, *dark; /* dark may be NULL */
    ptrdiff_t height, width;
    int wide; /* 16 bits a pixel */
} Images;

typedef struct {
    double saturation, beyond_columns, inside_columns, outside_columns, flank_sigmas, flanks_share, undimmed_level,
        min_headroom, min_noise, shape_sigma, texture_factor, facet_sigmas, near_columns, width_spread, blunt_gain,
        clipped_shape;
} EndParams;

typedef struct {
    double middle_x, middle_y, slope, x_start, x_end; /* undistorted */
} StripeLine;

typedef struct {
    double x, y, slope, sigma, outside, saturated, width, section_sigma, blunt, background;
} StripeEnd;

/* ---- profile.c ---- */

/* Light levels at which the headroom, the share of the stripe that saturation leaves visible, is tabulated. */
enum { FAINT, HALF, FULL, LIGHT_LEVELS };

/* The stripe in the columns first, first + 1, ... */
typedef struct {
    ptrdiff_t first, count, face_first, face_last; /* face: indices, inclusive */
    double *y, *amplitude, *headroom[LIGHT_LEVELS], *texture, *scratch;
    double *residual_variance; /* of the fitted cross-section */
    double *ambient;           /* range of the subtracted background across the section; infinite without one */
    unsigned char *saturated;
    int clipped;        /* in some column a part of the stripe is saturated */
    double sigma, gain; /* of the cross-section; variance of the amplitude over that of a pixel */
    double background;      /* relative variance of the face's amplitudes due to the background */
} Profile;

/* Mean residual variance of columns with noise only, from the lower quartile of columns that may show more. */
double low_residual_variance(double *residual_variance, size_t n);

/* Returns 1, 0 if the face has fewer than two columns, -1 without memory; the profile must always be freed. */
int read_profile(const Images *images, const StripeLine *line, const Lens *lens, const EndParams *params,
                 Profile *profile);

void free_profile(Profile *profile);

/* Index of the last column beyond `near` up to which the stripe keeps its level. */
ptrdiff_t last_undimmed(const Profile *profile, ptrdiff_t near, int outward, const EndParams *params);

/* ---- end_noise.c ---- */

enum { MAX_COLUMNS = 64 };

/* The columns about an end, outwards. Variances are those of amplitudes. N, S and C^2 of ringpose-method(7), section 3,
   are `noise`, `shot` and `speckle`. */
typedef struct {
    int count, inner, clipped; /* inner: on the face; clipped: in some column a part of the stripe is saturated */
    double along[MAX_COLUMNS], y[MAX_COLUMNS], amplitude[MAX_COLUMNS], texture[MAX_COLUMNS], headroom[LIGHT_LEVELS][MAX_COLUMNS];
    unsigned char saturated[MAX_COLUMNS];
    double facet;                 /* correlation of the background of neighbouring columns */
    double level;                 /* of the face's stripe */
    double scatter, step;         /* relative variance of its columns, and half that of their differences */
    double within, beyond;        /* variance by pixels' noise in the stripe and beyond the end */
    double clutter;               /* variance of the columns beyond if it exceeds that of noise, else 0 */
    double noise, shot, speckle;  /* beyond the end; what grows with the light, and with its square, at the level */
    double minimum;                 /* lower bound of the variance of a column */
} Columns;

/* Returns 0 if the columns about index `near` are too few or dark. */
int gather_columns(const Profile *profile, ptrdiff_t near, int outward, const EndParams *params, Columns *columns);

/* Splits the variance of the columns of every end into noise, shot noise and speckle, with the variances of all ends as
   a prior; returns the correlation of the speckle of neighbouring columns. */
double estimate_noise_model(Columns *const columns[], size_t ends, const EndParams *params);

/* Columns per independent column, for a sum of amplitudes, at that speckle correlation. */
double correlation_length(const Columns *columns, double correlation);

/* Columns per independent one for the width of an edge (in columns), to which correlated speckle adds little. */
double correlation_length_for_width(const Columns *columns, double correlation, double width);

/* Visible share of the stripe in a column at an illuminated share `lit`; saturation hides little of a faint edge. */
static inline double share_shown(const Columns *columns, int i, double lit) {
    if (!columns->clipped) return lit;
    double faint = columns->headroom[FAINT][i], half = columns->headroom[HALF][i], full = columns->headroom[FULL][i];
    return lit * (lit < 0.5 ? faint + (half - faint) * 2 * lit : half + (full - half) * (2 * lit - 1));
}

/* Variance of a column that shows that share of the stripe: N + S shown + C^2 shown^2, its texture, and clutter in so
   far as it does not show the stripe. */
static inline double column_variance(const Columns *columns, int i, double shown) {
    double hidden = 1 - shown;
    return columns->minimum + columns->texture[i] + shown * (columns->shot + columns->speckle * shown) +
           columns->clutter * hidden * hidden;
}

/* Variance about a level that neighbouring values have in common: total variance less half that of differences. */
double slow_variance(const double *value, int count, double level);

/* ---- end_edges.c ---- */

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

/* ---- end_sigmas.c ---- */

/* Bias of an edge's position by the curvature of the model, -1/2 sum(u_k m_k'') times the variance of the position (Box
   1971): speckle is proportional to the light, so that the foot of the edge, where the curve is convex, has most of the
   weight, and the edge would be found too far inside. For columns without saturation. */
double second_order_bias(const Columns *columns, const Edge *edge, double variance);

/* Variance of an edge's position along the columns. `correlation`: of the speckle of neighbouring columns;
   `information`: of the logarithm of the edge's width. */
double edge_variance(const Columns *columns, const Edge *edge, double correlation, double information,
                     const EndParams *params);

/* Mean squared distance from the edge, whose own variance is given, over all possible positions of the end. */
double variance_over_places(const Columns *columns, const EdgeFit *fit, const Edge *edge, double variance,
                            double correlation);

/* ---- small functions ---- */

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

/* Vertex of the parabola through three equidistant values, in their distance from the middle one; 0 if it is not a
   minimum. */
static inline double parabola(double before, double at, double after) {
    double curvature = before - 2 * at + after;
    return curvature > 0 && curvature < INFINITY ? fmin(fmax(0.5 * (before - after) / curvature, -1), 1) : 0;
}

#endif
