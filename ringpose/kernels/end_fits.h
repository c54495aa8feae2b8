/* Edges fitted to the brightness of a stripe about its end. No Python in here. Twin: reference_ends.py. */
#ifndef RINGPOSE_END_FITS_H
#define RINGPOSE_END_FITS_H

#include "profile.h"

enum { MOST_COLUMNS = 64, WIDTHS = 7, SHARP_WIDTHS = 5 };

/* Widths that are tried, in sigmas of the section: no lens blurs more along a stripe than across it. */
static const double WIDTH[WIDTHS] = {0.3, 0.4, 0.55, 0.75, 1.0, 1.4, 2.0};

/* The columns about an end, outwards. */
typedef struct {
    int count;
    double along[MOST_COLUMNS], amplitude[MOST_COLUMNS], headroom[MOST_COLUMNS], texture[MOST_COLUMNS];
    unsigned char saturated[MOST_COLUMNS];
    double level, contrast, noise; /* of the face's stripe; its relative spread; beyond the end */
} Columns;

/* The edge that fits best, for each width; minus log likelihoods, columns, shares of the face's level. */
typedef struct {
    double cost[WIDTHS], position[WIDTHS], outside[WIDTHS];
} EdgeFit;

/* 0 if the columns about index `near` are too few or dark. */
int gather_columns(const Profile *profile, ptrdiff_t near, int outward, const EndRules *rules, Columns *columns);

void fit_edge(const Columns *columns, double sigma, EdgeFit *fit);

/* Variance of what is seen in a column with so much of the stripe. */
double column_variance(const Columns *columns, int i, double inside);

#endif
