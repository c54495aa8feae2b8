/* Where the search for the most likely ring begins. No Python in here. */
#ifndef RINGPOSE_RING_START_H
#define RINGPOSE_RING_START_H

#include "ring_rows.h"

typedef struct {
    double plane[3], outward[3];
    double *along; /* how far out the break points are */
} RingStart;

/* The plane of the stripes, and the direction from inner to outer break points on it; `middle` are the abscissae of the
   points' stripes, and `sight` has room for the predicted ones. 0 if there is no plane before the camera. */
int start_ring(const Sighted *sighted, const double *middle, const Prediction *sight, RingStart *start);

#endif
