/* Break points in image and space: how far a pose's lie from them, and how they spread. No Python in here. */
#ifndef RINGPOSE_MISFIT_H
#define RINGPOSE_MISFIT_H

#include "tracks.h"

/* Break points: where in space, of which edge, in which light plane, where in the image. */
typedef struct {
    int count;
    const double (*point_m)[3];
    const long long *edge;
    const double (*light_normal)[3];
    const double (*position_px)[2];
} Sights;

typedef struct {
    const double *normal, *center_m, *radius_m;
    double offset_m;
} Solution;

/* Root mean square distance in pixels; NaN where a predicted break point does not exist before the camera. */
double misfit_px(const Sights *sights, const Solution *solution, const Lens *lens);

/* Adds the covariance of the points' coordinates x1 y1 z1 x2 ... that comes from break points that err independently. */
void add_spread_m2(const Sights *sights, const double (*covariance_px2)[4], const Lens *lens, double *covariance_m2);

#endif
