/* OpenCV's camera model. */
#ifndef RINGPOSE_LENS_H
#define RINGPOSE_LENS_H

#include <stddef.h>

#include "kernels.h"

#define LENS(REAL, COUNT)                                                                                           \
    REAL(fx, POSITIVE) REAL(fy, POSITIVE) REAL(cx, FINITE) REAL(cy, FINITE) /* pixels */                            \
    REAL(k1, FINITE) REAL(k2, FINITE) REAL(p1, FINITE) REAL(p2, FINITE)     /* OpenCV's distortion; k4 to k6 are */ \
    REAL(k3, FINITE) REAL(k4, FINITE) REAL(k5, FINITE) REAL(k6, FINITE)     /* 0 for plumb_bob */
RECORD_STRUCT(Lens, LENS);
extern const Kind Lens_record;

/* Distorted to undistorted pixels, n of them, in place; `x` and `y` run along stripes. */
void undistort(const Lens *lens, double *x, double *y, size_t n);

/* Distorts one pixel in place. */
void distort_pixel(const Lens *lens, double *x, double *y);

#endif
