/* Two short arcs about one centre through points in a plane that cross the x axis steeply. */
#ifndef RINGPOSE_ARCS_H
#define RINGPOSE_ARCS_H

#include "kernels.h"

typedef struct {
    double x, y;
    int arc, used;
} ArcPoint;

/* bend (x^2 + y^2) + x + lean y + level = 0 for the points of either arc. `bend` is half the curvature (for
   `lean` 0), `lean` the tangent of the angle between the common radius of the arcs and the x axis, `level`
   their places along x. */
#define ARCS_COLUMNS(COLUMN, COLUMNS_OF) COLUMN(bend) COLUMN(lean) COLUMNS_OF(level, 2)
ROW_STRUCT(Arcs, ARCS_COLUMNS);

/* The arcs through the used points by least squares; 0 if an arc has no point. Straight lines if the radius
   would be smaller than `min_radius`: two arcs pass through any four points, and if these form a square, it is
   not determined. */
int fit_arcs(const ArcPoint *point, int count, double min_radius, Arcs *arcs);

/* Distance of a point from its arc, positive towards positive x. */
double outside_arc(const Arcs *arcs, const ArcPoint *point);

#endif
