/* Where stripes end. No Python in here. */
#ifndef RINGPOSE_ENDS_H
#define RINGPOSE_ENDS_H

#include <stddef.h>
#include <stdint.h>

#include "tracks.h"

typedef struct {
    const void *lit, *dark; /* dark may be NULL */
    ptrdiff_t height, width;
    int wide; /* 16 bits a pixel */
} Images;

typedef struct {
    double saturation, beyond_columns, inside_columns, outside_columns, flank_sigmas, flanks_share, undimmed_level,
        least_headroom, least_noise, shape_sigma, texture_factor, facet_sigmas, near_columns, width_spread, blunt_gain;
} EndRules;

typedef struct {
    double middle_x, middle_y, slope, x_start, x_end; /* undistorted */
} StripeLine;

typedef struct {
    double x, y, slope, sigma, outside, saturated, width, section_sigma, blunt, beneath;
} StripeEnd;

/* Two ends (left, right) a line; NaN where none fits. 0 if there is no memory. */
int stripe_ends(const Images *images, const StripeLine *line, size_t lines, const Lens *lens, const EndRules *rules,
                StripeEnd *end);

#endif
