/* The brightness of a stripe along its line. No Python in here. Twin: reference_profile.py. */
#ifndef RINGPOSE_PROFILE_H
#define RINGPOSE_PROFILE_H

#include <stddef.h>

#include "ends.h"

/* Whole columns first, first + 1, ... and what the stripe looks like in them. */
typedef struct {
    ptrdiff_t first, count, face_first, face_last; /* face: indices, inclusive */
    double *y, *amplitude, *headroom, *texture, *scratch;
    unsigned char *saturated;
    double sigma, noise; /* of the cross-section; of the amplitude */
    double beneath;      /* relative variance of the face's peaks by what clearly lies beneath it */
} Profile;

/* 1, or 0 if the face has fewer than two columns, or -1 without memory; to be freed in any case. */
int read_profile(const Images *images, const StripeLine *line, const Lens *lens, const EndRules *rules,
                 Profile *profile);

void free_profile(Profile *profile);

/* The y of the line at any x. */
double line_y(const Profile *profile, double x);

/* The last column, as an index, to which the stripe goes on undimmed beyond index `near`. */
ptrdiff_t reached(const Profile *profile, ptrdiff_t near, int outward, const EndRules *rules);

#endif
