/* Two short arcs about one centre through points in a plane. */
#ifndef RINGPOSE_ARCS_H
#define RINGPOSE_ARCS_H

typedef struct {
    double x, y;
    int arc, used;
} End;

/* a (x^2 + y^2) + x + b y + c_arc = 0, by least squares over the used points. */
typedef struct {
    double a, b, c[2];
} Arcs;

/* 0 if an arc has no point. Straight lines if the radius would be smaller than `radius`: two arcs pass through any four
   ends, and if these form a square, the radius is not determined. */
int fit_wide_arcs(const End *end, int ends, double radius, Arcs *arcs);

/* Distance of a point from its arc, positive towards positive x. */
double outside_arc(const Arcs *arcs, const End *end);

double arcs_band(const Arcs *arcs);

#endif
