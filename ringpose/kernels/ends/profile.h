/* The intensity profile of a stripe along its line. */
#ifndef RINGPOSE_PROFILE_H
#define RINGPOSE_PROFILE_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "lens.h"

typedef struct {
    const void *lit, *dark; /* dark may be NULL */
    ptrdiff_t height, width;
    int wide; /* 16 bits a pixel */
} Images;

#define END_PARAMS(REAL, COUNT)                                                                                     \
    COUNT(saturation_dn, 1, UINT16_MAX)                                                                             \
    COUNT(beyond_columns, 0, 10000)                                                                                 \
    COUNT(inside_columns, 0, 10000)                                                                                 \
    COUNT(outside_columns, 0, 10000)                                                                                \
    REAL(flank_sigmas, POSITIVE)                                                                                    \
    REAL(flanks_share, 0, 1)                                                                                        \
    REAL(undimmed_level, NOT_NEGATIVE)                                                                              \
    REAL(min_headroom, POSITIVE)                                                                                    \
    REAL(min_noise, NOT_NEGATIVE)                                                                                   \
    REAL(shape_sigma, NOT_NEGATIVE)                                                                                 \
    REAL(texture_factor, NOT_NEGATIVE)                                                                              \
    REAL(facet_sigmas, POSITIVE)                                                                                    \
    REAL(near_columns, NOT_NEGATIVE)                                                                                \
    REAL(width_spread, NOT_NEGATIVE)                                                                                \
    REAL(blunt_gain, FINITE)                                                                                        \
    REAL(clipped_shape, NOT_NEGATIVE)
RECORD_STRUCT(EndParams, END_PARAMS);

/* In undistorted pixels. */
#define LINE_COLUMNS(COLUMN, COLUMNS_OF)                                                                            \
    COLUMN(middle_x) COLUMN(middle_y) COLUMN(slope) COLUMN(x_start) COLUMN(x_end)
ROW_STRUCT(StripeLine, LINE_COLUMNS);

/* Light levels at which the headroom, the share of the stripe that saturation leaves visible, is tabulated. */
enum { FAINT, HALF, FULL, LIGHT_LEVELS };

/* The stripe in the columns first, first + 1, ... */
typedef struct {
    ptrdiff_t first, count, face_first, face_last; /* face: indices, inclusive */
    double *y, *amplitude, *headroom[LIGHT_LEVELS], *texture, *scratch;
    double *residual_variance; /* of the fitted cross-section */
    double *ambient;           /* range of the subtracted background across the section; infinite without one */
    unsigned char *saturated;
    int clipped;        /* in some column a part of the stripe is saturated */
    double sigma, gain; /* of the cross-section; variance of the amplitude over that of a pixel */
    double background;      /* relative variance of the face's amplitudes due to the background */
} Profile;

/* Mean residual variance of columns with noise only, from the lower quartile of columns that may show more. */
double low_residual_variance(double *residual_variance, size_t n);

/* Returns 1, 0 if the face has fewer than two columns, -1 without memory; the profile must always be freed. */
int read_profile(const Images *images, const StripeLine *line, const Lens *lens, const EndParams *params,
                 Profile *profile);

void free_profile(Profile *profile);

/* Index of the last column beyond `near` up to which the stripe keeps its level. */
ptrdiff_t last_undimmed(const Profile *profile, ptrdiff_t near, int outward, const EndParams *params);

/* Vertex of the parabola through three equidistant values, in their distance from the middle one; 0 if it is not a
   minimum. */
static inline double parabola(double before, double at, double after) {
    double curvature = before - 2 * at + after;
    return curvature > 0 && curvature < INFINITY ? fmin(fmax(0.5 * (before - after) / curvature, -1), 1) : 0;
}

#endif
