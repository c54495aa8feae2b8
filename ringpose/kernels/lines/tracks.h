/* Straight tracks among stripe centres. No Python in here. */
#ifndef RINGPOSE_TRACKS_H
#define RINGPOSE_TRACKS_H

#include <stddef.h>
#include <stdint.h>

typedef struct {
    double fx, fy, cx, cy;
    double k1, k2, p1, p2, k3, k4, k5, k6; /* OpenCV's distortion; k4 to k6 are 0 for plumb_bob */
} Lens;

/* Distorted to undistorted pixels, n of them, in place; `x` and `y` run along stripes. */
void undistort(const Lens *lens, double *x, double *y, size_t n);

/* One undistorted pixel to where the lens shows it, in place. */
void distort_pixel(const Lens *lens, double *x, double *y);

/* Derivatives of the distortion at a normalised point: dx/dx, dx/dy (as dy/dx), dy/dy. */
void distortion_slope(const Lens *lens, double x, double y, double slope[3]);

typedef struct {
    double kink, joined;      /* px */
    double short_series;      /* factor */
    double on_line, border;   /* px */
    size_t minimum, longest_lag;
    double width;             /* of the image */
} TrackRules;

typedef struct {
    double laser, count, x_start, x_end, middle_x, middle_y, slope, scatter, correlation, clipped, spilt;
} Track;

typedef struct {
    size_t n, pieces;
    const double *column; /* distorted */
    const double *x, *y;  /* undistorted */
    const double *sigma;
    const int64_t *piece, *laser; /* of each centre; of each piece */
} Centers;

/* The tracks, `*count` of them, from malloc; NULL if there is no memory. */
Track *straight_tracks(const Centers *centers, const TrackRules *rules, size_t *count);

#endif
