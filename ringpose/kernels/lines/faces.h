/* What the kernels share that look for the ring's face among tracks. No Python in here. */
#ifndef RINGPOSE_FACES_H
#define RINGPOSE_FACES_H

#include <stdint.h>

#include "kernels.h"
#include "tracks.h"

typedef struct {
    double least_spilt, longest_gap;
    double apart, apart_sigmas, farthest; /* px, 1, px */
    double rounds, taken_by_fit, least_columns;
} UnionRules;

typedef struct {
    double nearest, farthest, shortest, longest; /* m */
    double usual_scatter, enough_columns;
    double spill_cost, coincidence_cost, behind_least, behind_most; /* 1, 1, m, m */
    double clipped_cost, union_cost;
    double most;
} CandidateRules;

typedef struct {
    double focal_x, focal_y, principal_x, principal_y, height; /* px */
    double border, along_sigma, across_sigma;                  /* px */
    double plane_limit, circle_limit, dropped_end, unseen;     /* squared sigmas over two */
    double tilt;                                               /* radians */
    double minimum_radius, minimum_band;                       /* metres */
    double left, right;                                        /* normalised x beyond which an end is cut off, */
    double top, bottom;                                        /* and y */
} RingRules;

typedef struct {
    UnionRules unions;
    CandidateRules candidates;
    RingRules ring;
} FaceRules;

/* Tracks that may be one, two by two, as one: appended to the list. 0 if there is no memory. */
int unite_collinear(const Track *track, size_t count, const UnionRules *rules, List *unions);

/* A track under the assumption that it belongs to a laser. */
typedef struct {
    int32_t track, laser;
    double x[2], y[2];       /* normalised image coordinates of its start and end */
    double inverse_depth[2]; /* 1/z there, 1/m */
    double merit;
    double forgiven; /* what a group of three adds to it */
    double normal_matrix[6], right_side[3], square; /* of the weighted plane equations: upper triangle, sums */
} Candidate;

typedef struct {
    int lasers;
    uint32_t unlabelled;      /* mask of those that unlabelled tracks may belong to */
    const double (*plane)[3]; /* m / d of each light plane: 1/z = (m / d) . (x, y, 1) */
    const FaceRules *rules;
} Scene;

/* The best tracks for each laser, sorted by laser; `all` holds rules->candidates.most of each. Returns how many. */
int find_candidates(const Track *track, size_t count, size_t unions, const Scene *scene, Candidate *all);

enum { MOST_MEMBERS = 3 };

typedef struct {
    int32_t index[MOST_MEMBERS];
    double score, rival; /* rival: best score of the same tracks under other lasers; minus infinity if none */
} Best;

/* Candidates must be sorted by laser. */
Best best_group(const Candidate *all, int count, int size, const Scene *scene);

#endif
