/* How well the end of a stripe is known. No Python in here. Twin: reference_end_sigmas.py. */
#ifndef RINGPOSE_END_SIGMAS_H
#define RINGPOSE_END_SIGMAS_H

#include "end_widths.h"

/* Variance of an edge's position along the columns; speckle of neighbours is alike by `likeness`, the edge's width
   (logarithm) known with `information`. */
double edge_variance(const Columns *columns, const Edge *edge, double likeness, double information,
                     const EndRules *rules);

#endif
