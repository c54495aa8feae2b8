/* Tracks in the making. No Python in here. */
#ifndef RINGPOSE_DRAFTS_H
#define RINGPOSE_DRAFTS_H

#include "tracks.h"

/* Runs of neighbouring centres that one track is joined from. */
enum { BLOCKS = 8 };

/* A track, and its runs of centres in ascending x. */
typedef struct {
    Track track;
    size_t first[BLOCKS], last[BLOCKS], blocks; /* last is one beyond */
} Draft;

typedef struct {
    const Centers *centers;
    const TrackRules *rules;
    double *x, *y, *residual, *scratch; /* room for all centres */
} Work;

/* The line through a draft's centres, by two rounds of least squares, the second without outliers. */
void fit_line(Draft *draft, const Work *work);

/* For every track the centres on its line that lie beyond its ends; 0 if there is no memory. */
int count_spilt(Draft *drafts, size_t count, const Work *work);

#endif
