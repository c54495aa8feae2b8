/* The ring's two edges as arcs in a plane, where an image should show them, and the steps of brightness that it shows
   there. No Python in here. */
#ifndef RINGPOSE_EDGES_H
#define RINGPOSE_EDGES_H

#include <stddef.h>
#include <stdint.h>

#include "lens.h"

enum { STATE = 7, AXES = 3 };

/* As geometry.ring_arcs.RingArcs. */
typedef struct {
    double origin[AXES], axes[AXES][AXES], curvature, half_band;
} RingArcs;

/* A point on an edge (`side` 1: inner, -1: outer), and there the unit vector that leads off the face. */
void arc_point(const RingArcs *arcs, double along, double side, double point[AXES], double outward[AXES]);

/* How far beyond its edge a ray meets the plane, and the derivatives by the state. */
double off_face(const RingArcs *arcs, const double ray[AXES], double side, double by_state[STATE]);

typedef struct {
    double width, height;       /* of the image */
    double spacing, sigma;      /* pixels between places; where the edge is predicted worse there is none */
    double half_turn;           /* radians to both sides */
    double margin, wider;       /* pixels to the image's border; share of its size that distortion may shift */
    double oblique, detour, nudge;
    double farthest; /* place to both sides of the arcs' origin */
} PlaceRules;

typedef struct {
    double point[AXES], outward[AXES], side, place[2], normal[2], metres_per_px, number;
} Place;

/* The places in the image, along the inner edge first; `places` has room for `most_places`. Returns how many. */
size_t edge_places(const RingArcs *arcs, const double *covariance, const Lens *lens, const PlaceRules *rules,
                   Place *places);

/* So many places at most. */
size_t most_places(const RingArcs *arcs, const Lens *lens, const PlaceRules *rules);

typedef struct {
    const void *data;
    size_t height, width;
    double right, bottom; /* column and row of the last pixel */
    int wide;             /* uint16_t instead of uint8_t */
} EdgePicture;

typedef struct {
    double reach, inside, outside, along; /* pixels */
    double noise, pooled, saturation;
} ProfileRules;

typedef struct {
    double *value, *noise;
    uint8_t *saturated;
    size_t count, samples;
} Profiles;

/* Mean brightness across each place, above the surface's and in units of its noise. 0 if there is no memory. */
int edge_profiles(const EdgePicture *picture, const double *place, const double *normal, const ProfileRules *rules,
                  Profiles *profiles);

/* What does not depend on the image: rows of samples, columns of places for the edge. */
typedef struct {
    const double *across, *place, *unit, *weight, *level, *step;
    size_t places;
} Templates;

typedef struct {
    double flat, touched, spacing, pooled;
} StepRules;

typedef struct {
    double offset, sigma, height, height_dn, cost;
} EdgeStep;

int edge_steps(const Profiles *profiles, const Templates *templates, const StepRules *rules, EdgeStep *steps);

typedef struct {
    double rounds, outlier_sigmas;
    double tilt_sigma, turn_sigma, curvature_sigma, half_band, half_band_sigma;
    double longest[STATE];
} FitRules;

typedef struct {
    const double *plane_point, *plane_sigma; /* of the ring's plane */
    size_t plane_points;
    const double *reference; /* axes of the priors */
    const double *ray, *side, *sigma;
    size_t sights;
} Evidence;

/* Rounds of Gauss-Newton; NaN if the evidence does not determine the arcs. */
void fit_ring_arcs(const Evidence *evidence, const FitRules *rules, RingArcs *arcs, double *covariance);

#endif
