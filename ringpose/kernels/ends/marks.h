/* What is said of the ends of the ring's face in the end. No Python in here. */
#ifndef RINGPOSE_MARKS_H
#define RINGPOSE_MARKS_H

#include "ends.h"
#include "tracks.h"

typedef struct {
    double width, border, saturated_share, kink_level, unclear;
    double clipped_phase, facet_sigmas, taken_by_fit, least_columns;
    double saturated, kink, clipped, blunt, unclear_flag; /* flags */
} MarkRules;

/* To be filled; two ends a laser, left and right. */
typedef struct {
    ptrdiff_t lasers;
    double *position, *covariance; /* distorted pixels */
    int64_t *flags;
    double *straight, *straight_sigma; /* the tracks' own ends, undistorted pixels */
} Marks;

/* NaN everywhere, and no flags. */
void clear_marks(Marks *marks);

void mark_ends(const Track *track, const StripeEnd end[2], ptrdiff_t laser, const MarkRules *rules, Marks *marks);

#endif
