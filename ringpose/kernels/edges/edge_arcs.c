/* The ring's edges as arcs in a plane. */
#include "edges.h"

#include <math.h>

static double dot(const double a[AXES], const double b[AXES]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

void arc_point(const RingArcs *arcs, double along, double side, double point[AXES], double outward[AXES]) {
    const double half = arcs->curvature * along / 2, sine = sin(half), cosine = cos(half);
    const double toward[2] = {1 - 2 * sine * sine, -2 * sine * cosine};
    const double chord = half == 0 ? along : along * sine / half; /* from the origin, at half the angle */
    const double x = chord * sine + side * arcs->half_band * toward[0];
    const double y = chord * cosine + side * arcs->half_band * toward[1];
    for (int i = 0; i < AXES; i++) {
        point[i] = arcs->origin[i] + x * arcs->axes[0][i] + y * arcs->axes[1][i];
        outward[i] = side * (toward[0] * arcs->axes[0][i] + toward[1] * arcs->axes[1][i]);
    }
}

double off_face(const RingArcs *arcs, const double ray[AXES], double side, double by_state[STATE]) {
    const double steepness = dot(ray, arcs->axes[2]), scale = dot(arcs->origin, arcs->axes[2]) / steepness;
    double offset[AXES];
    for (int i = 0; i < AXES; i++) offset[i] = ray[i] * scale - arcs->origin[i];
    const double x = dot(offset, arcs->axes[0]), y = dot(offset, arcs->axes[1]), bend = arcs->curvature;
    const double to_center = sqrt((1 - bend * x) * (1 - bend * x) + bend * y * (bend * y));
    const double slope_x = (1 - bend * x) / to_center, slope_y = -bend * y / to_center;
    const double square = x * x + y * y, height = (2 * x - bend * square) / (1 + to_center);
    const double by_bend = (-square + height * (slope_x * x + slope_y * y)) / (1 + to_center);
    const double by_lift = (slope_x * dot(ray, arcs->axes[0]) + slope_y * dot(ray, arcs->axes[1])) / steepness;
    const double derivative[STATE] = {-x * by_lift, -y * by_lift, by_lift, -slope_x, slope_x * y - slope_y * x,
                                      by_bend};
    for (int i = 0; i < STATE - 1; i++) by_state[i] = side * derivative[i];
    by_state[STATE - 1] = -1;
    return side * height - arcs->half_band;
}
