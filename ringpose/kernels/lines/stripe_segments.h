/* Straight stripe segments (segments) and their lines. */
#ifndef RINGPOSE_STRIPE_SEGMENTS_H
#define RINGPOSE_STRIPE_SEGMENTS_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "lens.h"

#define SEGMENT_COLUMNS(COLUMN, COLUMNS_OF)                                                                           \
    COLUMN(laser)   /* number, or -1 */                                                                             \
    COLUMN(centers) /* their number */                                                                              \
    COLUMN(x_start) COLUMN(x_end)                                                                                   \
    COLUMN(middle_x) COLUMN(middle_y) COLUMN(slope) /* of the line */                                               \
    COLUMN(scatter)     /* standard deviation of the centres about the line */                                      \
    COLUMN(correlation) /* columns per independent one */                                                           \
    COLUMN(clipped)     /* 1 if an end lies at the border */                                                        \
    COLUMN(before_start) COLUMN(after_end) /* centres on the line beyond the ends */
ROW_STRUCT(Segment, SEGMENT_COLUMNS);

/* Number of centres at either end of a segment that its line does not use. An edge that crosses the stripe obliquely cuts
   its last cross-sections off on one side, which would turn the line, and all lines of a shot alike. */
enum { MAX_CUT = 4, COLUMNS_PER_CUT = 12 };

static inline size_t cut_centres(size_t count) {
    return count / COLUMNS_PER_CUT < MAX_CUT ? count / COLUMNS_PER_CUT : MAX_CUT;
}

/* Share of a segment's centres that its line uses. */
static inline double used_share(const Segment *segment) {
    return 1 - 2 * (double)cut_centres((size_t)segment->centers) / fmax(segment->centers, 1);
}

static inline double line_y(const Segment *segment, double x) {
    return segment->middle_y + segment->slope * (x - segment->middle_x);
}

/* Standard deviation of the ordinate at x, given that of the segment's middle. */
static inline double line_sigma(const Segment *segment, double x, double middle_sigma) {
    double spread = fmax(used_share(segment) * (segment->x_end - segment->x_start), 1) / sqrt(12);
    return middle_sigma * hypot(1, (x - segment->middle_x) / spread);
}

/* Standard deviation of the middle, Eq. (3.5): scatter / sqrt(independent columns - degrees of freedom of the fit). */
static inline double middle_sigma(const Segment *segment, double fit_dof, double min_columns) {
    double columns = used_share(segment) * segment->centers / segment->correlation;
    return segment->scatter / sqrt(fmax(columns - fit_dof, min_columns));
}

#endif
