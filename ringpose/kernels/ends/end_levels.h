/* What a stripe's brightness about its ends varies by. N, S and C^2 of ringpose-method(7), section 3, are `noise`,
   `shot` and `speckle`. No Python in here. */
#ifndef RINGPOSE_END_LEVELS_H
#define RINGPOSE_END_LEVELS_H

#include "profile.h"

enum { MOST_COLUMNS = 64 };

/* The columns about an end, outwards. Variances are those of amplitudes. */
typedef struct {
    int count, clipped; /* clipped: saturation leaves some column less than all of the stripe */
    double along[MOST_COLUMNS], amplitude[MOST_COLUMNS], texture[MOST_COLUMNS], room[ROOMS][MOST_COLUMNS];
    unsigned char saturated[MOST_COLUMNS];
    double facet;                 /* how alike what lies beneath neighbouring columns is */
    double level;                 /* of the face's stripe */
    double scatter, step;         /* relative variance of its columns, and half that of their differences */
    double within, beyond;        /* variance by pixels' noise in the stripe and beyond the end */
    double clutter;               /* variance of the columns beyond */
    double noise, shot, speckle;  /* beyond the end; what grows with the light, and with its square, at the level */
    double least;                 /* no column weighs as if it had less */
} Columns;

/* 0 if the columns about index `near` are too few or dark. */
int gather_columns(const Profile *profile, ptrdiff_t near, int outward, const EndRules *rules, Columns *columns);

/* Divides what the columns vary by into noise, shot noise and speckle, with what the image's other ends show of them;
   returns how alike neighbouring columns' speckle is. */
double share_levels(Columns *const columns[], size_t ends, const EndRules *rules);

/* Columns that count as one for the light of many, where speckle is so much alike. */
double columns_alike(const Columns *columns, double likeness);

/* The same for an edge's width in columns, for which neighbours' speckle of one sign says little. */
double columns_alike_for_width(const Columns *columns, double likeness, double width);

/* How much of the stripe a column shows, where so much of it is lit; saturation takes little of a faint edge. */
static inline double share_shown(const Columns *columns, int i, double lit) {
    if (!columns->clipped) return lit;
    double faint = columns->room[FAINT][i], half = columns->room[HALF][i], full = columns->room[FULL][i];
    return lit * (lit < 0.5 ? faint + (half - faint) * 2 * lit : half + (full - half) * (2 * lit - 1));
}

/* Variance of what is seen in a column that shows so much of the stripe, by which it weighs. */
static inline double column_variance(const Columns *columns, int i, double shown) {
    return columns->least + columns->texture[i] + shown * (columns->shot + columns->speckle * shown);
}

/* Variance of values about a level that neighbours share; what each has of its own shows in their differences. */
double slow_variance(const double *value, int count, double level);

#endif
