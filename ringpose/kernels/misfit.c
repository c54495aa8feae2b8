/* Break points as a pose predicts them. */
#include "misfit.h"

#include <math.h>

#define GRAZING 1e-9 /* a shorter direction is none */

static double inner(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static double positive(double length) { return length > GRAZING ? length : NAN; }

/* The point moved within its light plane, the shortest way, onto the ring's plane, and the line in which both meet. */
static void stripe_line(const Sights *sights, const Solution *solution, int i, double point[3], double direction[3]) {
    const double *seen = sights->point_m[i], *light = sights->light_normal[i], *normal = solution->normal;
    double common = inner(light, normal), uphill[3];
    for (int k = 0; k < 3; k++) {
        uphill[k] = normal[k] - common * light[k];
        direction[k] = normal[(k + 1) % 3] * light[(k + 2) % 3] - normal[(k + 2) % 3] * light[(k + 1) % 3];
    }
    double step = (solution->offset_m - inner(seen, normal)) / positive(inner(uphill, normal));
    double size = positive(sqrt(inner(direction, direction)));
    for (int k = 0; k < 3; k++) {
        point[k] = seen[k] + step * uphill[k];
        direction[k] /= size;
    }
}

/* Where the line crosses the sphere nearer to the point, or is nearest to its centre; in place. */
static void cross_sphere(const double *center, double radius, const double direction[3], double point[3]) {
    double apart[3] = {center[0] - point[0], center[1] - point[1], center[2] - point[2]};
    double along = inner(apart, direction), away[3];
    for (int k = 0; k < 3; k++) away[k] = along * direction[k] - apart[k];
    double square = radius * radius - inner(away, away), half_chord = sqrt(square < 0 ? 0 : square);
    double step = along + (along > 0 ? -half_chord : half_chord);
    for (int k = 0; k < 3; k++) point[k] += step * direction[k];
}

double misfit_px(const Sights *sights, const Solution *solution, const Lens *lens) {
    double sum = 0;
    for (int i = 0; i < sights->count; i++) {
        double point[3], direction[3];
        stripe_line(sights, solution, i, point, direction);
        cross_sphere(solution->center_m, solution->radius_m[sights->edge[i]], direction, point);
        if (!(point[2] > 0)) return NAN;
        double x = point[0] / point[2] * lens->fx + lens->cx, y = point[1] / point[2] * lens->fy + lens->cy;
        distort_pixel(lens, &x, &y);
        double off_x = x - sights->position_px[i][0], off_y = y - sights->position_px[i][1];
        sum += off_x * off_x + off_y * off_y;
    }
    return sqrt(sum / sights->count);
}
