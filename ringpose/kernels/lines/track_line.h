/* A track's line. */
#ifndef RINGPOSE_TRACK_LINE_H
#define RINGPOSE_TRACK_LINE_H

#include <math.h>

#include "tracks.h"

static inline double line_y(const Track *track, double x) {
    return track->middle_y + track->slope * (x - track->middle_x);
}

/* Standard deviation of the ordinate if that of the track's middle is known. */
static inline double line_sigma(const Track *track, double x, double middle_sigma) {
    double spread = fmax(track->x_end - track->x_start, 1) / sqrt(12);
    return middle_sigma * hypot(1, (x - track->middle_x) / spread);
}

/* The same of the middle itself, columns that err alike counted once; the line's fit takes some of them. */
static inline double middle_sigma(const Track *track, double taken_by_fit, double least_columns) {
    return track->scatter / sqrt(fmax(track->count / track->correlation - taken_by_fit, least_columns));
}

#endif
