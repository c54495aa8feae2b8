/* Two short arcs about one centre through points in a plane. No Python in here. */
#ifndef RINGPOSE_ARCS_H
#define RINGPOSE_ARCS_H

#include "tracks.h"

enum { MOST_ENDS = 64 };

typedef struct {
    double x, y;
    int arc, used;
    double sigma, along_sigma; /* across its arc; along x */
} End;

/* a (x^2 + y^2) + x + b y + c_arc = 0, by least squares over the used points. */
typedef struct {
    double a, b, c[2];
} Arcs;

/* 0 if an arc has no point. */
int fit_arcs(const End *end, int ends, Arcs *arcs);

/* The same, but straight where that would be of a smaller radius than this: the arcs of two stripes go through any four
   ends, and where these lie square, the least error bends them at will. */
int fit_wide_arcs(const End *end, int ends, double radius, Arcs *arcs);

/* Distance of a point from its arc, positive towards positive x. */
double outside_arc(const Arcs *arcs, const End *end);

/* One over the radius; positive if the centre lies on the side of positive x. */
double arcs_curvature(const Arcs *arcs);

double arcs_band(const Arcs *arcs);

/* Puts points seen in the image, each on a light plane (normal, distance), into the plane nearest to all, with x along
   the image's rows; `sigma` becomes what a pixel is worth there, in metres. */
void flatten_ends(const double *position, const double *planes, const Lens *lens, End *end, int count);

/* Cost of all ends, of all but each, the curvature, and its sigma by differences. */
void arc_costs(End *end, int ends, double *result);

#endif
