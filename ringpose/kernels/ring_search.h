/* The most likely ring of stripes and break points by Gauss and Newton's steps. No Python in here. */
#ifndef RINGPOSE_RING_SEARCH_H
#define RINGPOSE_RING_SEARCH_H

#include "ring_rows.h"

/* Radii known beforehand, NaN if not: radius and standard deviation of the inner and of the outer edge. */
typedef struct {
    double radius[2], sd[2];
} KnownRadii;

/* All that a ring is to explain; residuals come in this order. */
typedef struct {
    Sighted sighted;
    VisibleEdges edges;
    KnownRadii radii;
} Evidence;

/* When a search ends, and what is no ring. */
typedef struct {
    double huber, step_sigmas, ridge, least_depth, most_depth, steepest;
} SearchRules;

/* What the residuals have in common: rows x errors, in the order of lines, points, edges, radii. */
typedef struct {
    int errors;
    const double *rows;
} Common;

enum { SEARCH_FAILED = 0, SEARCH_DONE = 1, SEARCH_MOVED = 2 };

/* What is worked on, and in the end found; all arrays are the caller's. */
typedef struct {
    RingState state;
    int rows;
    double *residual, (*by_state)[STATE], *weight; /* of lines, points, edges, radii */
    double *left; /* residuals that the last step is expected to leave */
    double normal_matrix[STATE][STATE], inverse[STATE][STATE];
    double *error_step; /* of the common errors */
    double *scratch;    /* errors x (errors + STATE + 1) */
} Search;

/* Numbers of scratch that a search with so many common errors needs. */
int scratch_numbers(int errors);

/* Steps from number `first` to before `last`; not the first one of all ends the search, as little of it is known yet.
   SEARCH_MOVED: the state has made its last step, and nothing is told of it but what is left. */
int search_ring(const Evidence *evidence, const Common *common, const SearchRules *rules, int first, int last,
                const Prediction *prediction, Search *search);

#endif
