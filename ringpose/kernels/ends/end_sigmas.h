/* How well the end of a stripe is known. No Python in here. */
#ifndef RINGPOSE_END_SIGMAS_H
#define RINGPOSE_END_SIGMAS_H

#include "end_widths.h"

/* Variance of an edge's position along the columns; speckle of neighbours is alike by `likeness`, the edge's width
   (logarithm) known with `information`. */
double edge_variance(const Columns *columns, const Edge *edge, double likeness, double information,
                     const EndRules *rules);

/* How much of the stripe each column shows before an edge. */
void show_edge(const Columns *columns, const Edge *edge, double *shown);

/* Variance of the columns' light, summed with an influence, before an edge. */
double light_noise(const Columns *columns, const Edge *edge, const double *influence, double likeness);

#endif
