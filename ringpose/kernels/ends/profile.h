/* The brightness of a stripe along its line. No Python in here. */
#ifndef RINGPOSE_PROFILE_H
#define RINGPOSE_PROFILE_H

#include <stddef.h>

#include "ends.h"

/* How much of the stripe saturation leaves visible where it is faint, half and wholly lit. */
enum { FAINT, HALF, FULL, ROOMS };

/* Whole columns first, first + 1, ... and what the stripe looks like in them. */
typedef struct {
    ptrdiff_t first, count, face_first, face_last; /* face: indices, inclusive */
    double *y, *amplitude, *room[ROOMS], *rough, *texture, *scratch; /* rough: variance that a section leaves */
    unsigned char *saturated;
    int clipped;        /* saturation leaves some column less than all of the stripe */
    double sigma, gain; /* of the cross-section; the share of a pixel's variance that reaches the amplitude */
    double beneath;      /* relative variance of the face's peaks by what clearly lies beneath it */
} Profile;

/* The mean of what sections leave where only noise is, from the lowest of some that may show more. */
double low_roughness(double *rough, size_t n);

/* 1, or 0 if the face has fewer than two columns, or -1 without memory; to be freed in any case. */
int read_profile(const Images *images, const StripeLine *line, const Lens *lens, const EndRules *rules,
                 Profile *profile);

void free_profile(Profile *profile);

/* The y of the line at any x. */
double line_y(const Profile *profile, double x);

/* The last column, as an index, to which the stripe goes on undimmed beyond index `near`. */
ptrdiff_t reached(const Profile *profile, ptrdiff_t near, int outward, const EndRules *rules);

#endif
