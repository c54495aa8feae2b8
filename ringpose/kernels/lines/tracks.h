/* Straight stripe segments (tracks) and their lines. */
#ifndef RINGPOSE_TRACKS_H
#define RINGPOSE_TRACKS_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "lens.h"

typedef struct {
    double laser, count, x_start, x_end, middle_x, middle_y, slope, scatter, correlation, clipped, beyond_ends;
} Track;

static inline double line_y(const Track *track, double x) {
    return track->middle_y + track->slope * (x - track->middle_x);
}

/* Standard deviation of the ordinate at x, given that of the track's middle. */
static inline double line_sigma(const Track *track, double x, double middle_sigma) {
    double spread = fmax(track->x_end - track->x_start, 1) / sqrt(12);
    return middle_sigma * hypot(1, (x - track->middle_x) / spread);
}

/* Standard deviation of the middle: scatter / sqrt(independent columns - degrees of freedom of the fit). */
static inline double middle_sigma(const Track *track, double fit_dof, double min_columns) {
    return track->scatter / sqrt(fmax(track->count / track->correlation - fit_dof, min_columns));
}

#endif
