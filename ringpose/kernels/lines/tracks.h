/* Straight tracks among stripe centres. No Python in here. */
#ifndef RINGPOSE_TRACKS_H
#define RINGPOSE_TRACKS_H

#include <stddef.h>
#include <stdint.h>

#include "lens.h"

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
