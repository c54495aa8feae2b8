/* Other places where a stripe may end. No Python in here. */
#ifndef RINGPOSE_END_PLACES_H
#define RINGPOSE_END_PLACES_H

#include "end_widths.h"

/* Mean squared distance from an edge, known with a variance, of all places where the end may be. */
double variance_over_places(const Columns *columns, const EdgeFit *fit, const Edge *edge, double variance,
                            double likeness);

#endif
