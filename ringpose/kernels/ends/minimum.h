/* The minimum of a parabola through three values. */
#ifndef RINGPOSE_MINIMUM_H
#define RINGPOSE_MINIMUM_H

#include <math.h>

/* Where it lies between three equidistant values, in their distance, from the middle one; 0 if there is none. */
static inline double parabola(double before, double at, double after) {
    double bend = before - 2 * at + after;
    return bend > 0 && bend < INFINITY ? fmin(fmax(0.5 * (before - after) / bend, -1), 1) : 0;
}

#endif
