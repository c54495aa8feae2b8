/* Noise model of the amplitudes about a stripe's end. */
#ifndef RINGPOSE_END_NOISE_H
#define RINGPOSE_END_NOISE_H

#include "profile.h"

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

/* Variance of a column that shows that share of the stripe, Eq. (3.11): N + S shown + C^2 shown^2, its texture, and
   clutter in so far as it does not show the stripe. */
static inline double column_variance(const Columns *columns, int i, double shown) {
    double hidden = 1 - shown;
    return columns->minimum + columns->texture[i] + shown * (columns->shot + columns->speckle * shown) +
           columns->clutter * hidden * hidden;
}

/* Variance about a level that neighbouring values have in common: total variance less half that of differences. */
double slow_variance(const double *value, int count, double level);

#endif
