/* OpenCV's camera model. */
#ifndef RINGPOSE_LENS_H
#define RINGPOSE_LENS_H

#include <stddef.h>

typedef struct {
    double fx, fy, cx, cy;
    double k1, k2, p1, p2, k3, k4, k5, k6; /* OpenCV's distortion; k4 to k6 are 0 for plumb_bob */
} Lens;

/* Distorted to undistorted pixels, n of them, in place; `x` and `y` run along stripes. */
void undistort(const Lens *lens, double *x, double *y, size_t n);

/* Distorts one pixel in place. */
void distort_pixel(const Lens *lens, double *x, double *y);

#endif
