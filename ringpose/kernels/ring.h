/* What the kernels that look for the ring share. No Python in here. */
#ifndef RINGPOSE_RING_H
#define RINGPOSE_RING_H

#include <stdint.h>

enum { MOST_MEMBERS = 3 };

/* A track under the assumption that it belongs to a laser. */
typedef struct {
    int32_t track, laser;
    double x[2], y[2];       /* normalised image coordinates of its start and end */
    double inverse_depth[2]; /* 1/z there, 1/m */
    double merit;
    double normal_matrix[6], right_side[3], square; /* of the weighted plane equations: upper triangle, sums */
} Candidate;

typedef struct {
    double plane, circle, dropped_end, unseen; /* squared sigmas over two */
    double tilt;                               /* radians */
    double minimum_radius, minimum_band;       /* metres */
    double left, right;                        /* normalised x beyond which an end is cut off by the border */
} RingLimits;

typedef struct {
    int lasers;
    const double (*plane)[3]; /* m / d of each light plane: 1/z = (m / d) . (x, y, 1) */
    double focal_x, focal_y, principal_y, height, border, along_sigma;
    RingLimits limits;
} Scene;

typedef struct {
    int32_t index[MOST_MEMBERS];
    double score, rival; /* rival: best score of the same tracks under other lasers; minus infinity if none */
} Best;

double group_score(const Candidate *const member[], int size, const Scene *scene);

/* Candidates must be sorted by laser. */
Best best_group(const Candidate *all, int count, int size, const Scene *scene);

#endif
