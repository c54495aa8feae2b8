/* Where the search for the most likely ring begins. */
#include "ring_start.h"

#include <math.h>
#include <string.h>

#define SHORTEST_M 1e-9 /* a direction of less than this is none */

enum { PLANE_STEPS = 2 };

static double inner(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void cross(const double a[3], const double b[3], double to[3]) {
    for (int i = 0; i < 3; i++) to[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

/* Of a symmetric matrix and its right side, by Cramer's rule; what is singular gives no finite numbers. */
static void solve(const double a[3][3], const double b[3], double x[3]) {
    double minors[3][3];
    for (int i = 0; i < 3; i++) cross(a[(i + 1) % 3], a[(i + 2) % 3], minors[i]);
    double determinant = inner(a[0], minors[0]);
    for (int i = 0; i < 3; i++)
        x[i] = (b[0] * minors[0][i] + b[1] * minors[1][i] + b[2] * minors[2][i]) / determinant;
}

/* (m . r - d q . r) / (m - d q)_y is linear in q but for its weak denominator. */
static void improve_plane(const Sighted *sighted, double q[3]) {
    double matrix[3][3] = {{0}}, side[3] = {0};
    for (int i = 0; i < sighted->ends; i++) {
        double row[3] = {0}, value = 0;
        for (int j = i & ~1; j < (i | 1) + 1; j++) {
            const double *light = sighted->light[j], *ray = sighted->ray[j];
            double weight = sighted->whitening[i * sighted->ends + j] / (light[1] - light[3] * q[1]);
            for (int k = 0; k < 3; k++) row[k] += weight * light[3] * ray[k];
            value += weight * inner(light, ray);
        }
        for (int k = 0; k < 3; k++) {
            for (int l = 0; l < 3; l++) matrix[k][l] += row[k] * row[l];
            side[k] += row[k] * value;
        }
    }
    for (int k = 0; k < 2; k++) matrix[k][k] += 1 / (q[2] * q[2]); /* one stripe alone: a face that looks here */
    solve(matrix, side, q);
}

static void find_plane(const Sighted *sighted, double q[3]) {
    int count = sighted->ends + sighted->points;
    q[0] = q[1] = q[2] = 0;
    for (int i = 0; i < count; i++) q[2] += inner(sighted->light[i], sighted->ray[i]) / sighted->light[i][3] / count;
    for (int step = 0; step < PLANE_STEPS; step++) improve_plane(sighted, q);
}

static int is_direction(const double a[3]) { return inner(a, a) >= SHORTEST_M * SHORTEST_M; }

/* How a break point moves when it goes along its stripe in the image. */
static void find_step(const Prediction *sight, int i, const double q[3], double to[3]) {
    const double *ray = sight->ray[i], slope = sight->slope[i], depth = 1 / inner(ray, q);
    const double rate = depth * (q[0] + slope * q[1]);
    for (int k = 0; k < 3; k++) to[k] = depth * ((k == 0) + slope * (k == 1) - rate * ray[k]);
}

/* From inner towards outer ends, seen from the middles of their stripes; if these say nothing, across the last and the
   first of the others, or along the first stripe. */
static void find_outward(const Sighted *sighted, const double *middle, const Prediction *sight, RingStart *start) {
    const double *q = start->plane;
    double direction[3] = {0}, normal[3];
    for (int i = 0; i < sighted->points; i++) {
        double step[3], weight = sighted->point[i][0] * (sighted->ray[sighted->ends + i][0] - middle[i]);
        find_step(sight, sighted->ends + i, q, step);
        for (int k = 0; k < 3; k++) direction[k] += weight * step[k];
    }
    for (int k = 0; k < 3; k++) normal[k] = -q[k] / sqrt(inner(q, q));
    if (!is_direction(direction)) {
        int first = sighted->ends, last = first + sighted->points - 1;
        double to_first = 1 / inner(sight->ray[first], q), to_last = 1 / inner(sight->ray[last], q), apart[3];
        for (int k = 0; k < 3; k++) apart[k] = to_last * sighted->ray[last][k] - to_first * sighted->ray[first][k];
        cross(normal, apart, direction);
    }
    if (!is_direction(direction)) find_step(sight, sighted->ends, q, direction);
    double off = inner(direction, normal);
    for (int k = 0; k < 3; k++) direction[k] -= off * normal[k];
    for (int k = 0; k < 3; k++) start->outward[k] = direction[k] / sqrt(inner(direction, direction));
}

int start_ring(const Sighted *sighted, const double *middle, const Prediction *sight, RingStart *start) {
    find_plane(sighted, start->plane);
    RingState state = {{0}, {1, 0, 0}, 0, 0, 0};
    memcpy(state.plane, start->plane, sizeof state.plane);
    predict_lines(&state, sighted, sight);
    for (int i = 0; i < sighted->ends + sighted->points; i++)
        if (!(inner(sight->ray[i], start->plane) > 0)) return 0;
    find_outward(sighted, middle, sight, start);
    for (int i = 0; i < sighted->points; i++) {
        const double *ray = sight->ray[sighted->ends + i];
        start->along[i] = inner(ray, start->outward) / inner(ray, start->plane);
    }
    return 1;
}
