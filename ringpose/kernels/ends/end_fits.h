/* Edges fitted to the brightness of a stripe about its end. No Python in here. */
#ifndef RINGPOSE_END_FITS_H
#define RINGPOSE_END_FITS_H

#include "end_levels.h"

enum { WIDTHS = 7, SHARP_WIDTHS = 5 };

/* Widths that are tried, in sigmas of the section: no lens blurs more along a stripe than across it. */
static const double WIDTH[WIDTHS] = {0.3, 0.4, 0.55, 0.75, 1.0, 1.4, 2.0};

/* Columns at which ends are looked for first. */
enum { FIRST_PLACE = -12, LAST_PLACE = 6, PLACES = LAST_PLACE - FIRST_PLACE + 1 };

/* The edge that fits best, for each width; minus log likelihoods, columns, shares of the face's level. */
typedef struct {
    double cost[WIDTHS], position[WIDTHS], outside[WIDTHS];
    double first[PLACES]; /* costs of the first search */
} EdgeFit;

void fit_edge(const Columns *columns, double sigma, EdgeFit *fit);

/* Minus log likelihoods of edges of one width. */
void edge_costs(const Columns *columns, double width, const double *position, int count, double *cost);

#endif
