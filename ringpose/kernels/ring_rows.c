/* The rows of the most likely ring; equations and names are those of ringpose/pose/ring_model.py. */
#include "ring_rows.h"

#include <float.h>
#include <math.h>
#include <string.h>

enum { SHIFT = 3, TURN = 4, CURVATURE = 5, BAND = 6 };
#define LEAST_RATE 1e-9

static double inner(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

void predict_lines(const RingState *state, const Sighted *sighted, const Prediction *to) {
    for (int i = 0; i < sighted->ends + sighted->points; i++) {
        const double *light = sighted->light[i], *ray = sighted->ray[i];
        double line[3];
        for (int k = 0; k < 3; k++) line[k] = light[k] - light[3] * state->plane[k];
        to->steepness[i] = line[1];
        to->slope[i] = line[0] / -line[1];
        double predicted[3] = {ray[0], to->slope[i] * ray[0] - line[2] / line[1], ray[2]};
        for (int k = 0; k < 3; k++) {
            to->ray[i][k] = predicted[k];
            to->y_by_plane[i][k] = light[3] / line[1] * predicted[k];
        }
    }
}

static void compare_lines(const Sighted *sighted, const Prediction *to) {
    for (int i = 0; i < sighted->ends; i++) {
        double *row = to->by_state[i];
        memset(row, 0, STATE * sizeof *row);
        to->residual[i] = 0;
        for (int j = i & ~1; j < (i | 1) + 1; j++) {
            double weight = sighted->whitening[i * sighted->ends + j];
            to->residual[i] += weight * (sighted->ray[j][1] - to->ray[j][1]);
            for (int k = 0; k < 3; k++) row[k] -= weight * to->y_by_plane[j][k];
        }
    }
}

/* The point of the plane on the mean ray of the break points. */
static void find_origin(const RingState *state, const Sighted *sighted, const Prediction *to) {
    double mean[3] = {0, 0, 0}, mean_by_plane[3] = {0, 0, 0};
    double *position = to->origin, *by_plane = to->origin + 3, *by_ray = to->origin + 12;
    for (int i = sighted->ends; i < sighted->ends + sighted->points; i++)
        for (int k = 0; k < 3; k++) {
            mean[k] += to->ray[i][k] / sighted->points;
            mean_by_plane[k] += to->y_by_plane[i][k] / sighted->points;
        }
    double depth = 1 / inner(mean, state->plane);
    for (int k = 0; k < 3; k++) {
        position[k] = depth * mean[k];
        for (int j = 0; j < 2; j++) by_ray[2 * k + j] = depth * ((k == j) - depth * mean[k] * state->plane[j]);
        for (int j = 0; j < 3; j++)
            by_plane[3 * k + j] = by_ray[2 * k + 1] * mean_by_plane[j] - depth * depth * mean[k] * mean[j];
    }
}

/* A ring's plane with axes along and across `outward`, as points on it are compared with circles. */
typedef struct {
    const RingState *state;
    double along[3], to_u, to_v, u_by_plane[3], v_by_plane[3]; /* of the origin */
} Band;

static void find_band(const RingState *state, const double *origin, Band *band) {
    const double *u = state->outward, *q = state->plane;
    double size = sqrt(inner(q, q)), *v = band->along;
    band->state = state;
    for (int i = 0; i < 3; i++) /* the normal, -q / |q|, times u */
        v[i] = -(q[(i + 1) % 3] * u[(i + 2) % 3] - q[(i + 2) % 3] * u[(i + 1) % 3]) / size;
    for (int i = 0; i < 3; i++) {
        band->u_by_plane[i] = u[0] * origin[3 + i] + u[1] * origin[6 + i] + u[2] * origin[9 + i];
        band->v_by_plane[i] = v[0] * origin[3 + i] + v[1] * origin[6 + i] + v[2] * origin[9 + i];
    }
    band->to_u = inner(u, origin);
    band->to_v = inner(v, origin);
}

/* Distance of a ray's point on the plane from the circle of an edge (sign -1 or +1), with its derivatives. */
static double arc_distance(const Band *band, const double ray[3], double sign, double arc[STATE], double by_ray[2]) {
    const RingState *state = band->state;
    const double *u = state->outward, *v = band->along, *q = state->plane, k = state->curvature;
    double depth = 1 / inner(ray, q), over_u = depth * inner(u, ray), over_v = depth * inner(v, ray);
    double x = over_u - (band->to_u + state->shift), y = over_v - band->to_v, square = x * x + y * y;
    double stretch = 1 + k * x, turn = k * y, h = sqrt(stretch * stretch + turn * turn);
    double distance = (2 * x + k * square) / (h + 1), cosine = stretch / h, sine = turn / h;
    double reach = cosine * over_u + sine * over_v;
    for (int j = 0; j < 2; j++) by_ray[j] = depth * (cosine * u[j] + sine * v[j] - reach * q[j]);
    for (int j = 0; j < 3; j++)
        arc[j] = -reach * depth * ray[j] - cosine * band->u_by_plane[j] - sine * band->v_by_plane[j];
    arc[SHIFT] = -cosine;
    arc[TURN] = cosine * y - sine * (x + state->shift);
    arc[CURVATURE] = (square - distance * distance) / (h + h);
    arc[BAND] = -0.5 * sign;
    return distance - 0.5 * state->band * sign;
}

static void compare_points(const RingState *state, const Sighted *sighted, const Prediction *to) {
    Band band;
    find_band(state, to->origin, &band);
    for (int i = 0; i < sighted->points; i++) {
        int sight = sighted->ends + i;
        double *arc = to->arc_by_state[i], *by_ray = to->by_ray[i];
        to->distance[i] = arc_distance(&band, to->ray[sight], sighted->point[i][0], arc, by_ray);
        for (int j = 0; j < 3; j++) arc[j] += by_ray[1] * to->y_by_plane[sight][j];
        double by_x = by_ray[0] + to->slope[sight] * by_ray[1];
        to->by_x[i] = fabs(by_x) < LEAST_RATE ? LEAST_RATE : by_x;
        to->scale[i] = 1 / (fabs(to->by_x[i]) * sighted->point[i][1]);
        to->residual[sight] = to->scale[i] * to->distance[i];
        for (int j = 0; j < STATE; j++) to->by_state[sight][j] = to->scale[i] * arc[j];
    }
}

void compare_edges(const RingState *state, const VisibleEdges *edges, const double *origin, double *residual,
                   double (*by_state)[STATE]) {
    Band band;
    find_band(state, origin, &band);
    for (int i = 0; i < edges->count; i++) {
        const double *edge = edges->edge[i];
        double by_ray[2], distance = arc_distance(&band, edges->ray[i], edge[0], by_state[i], by_ray);
        double rate = fabs(by_ray[0] * edge[1] + by_ray[1] * edge[2]), scale = 1 / (rate > DBL_MIN ? rate : DBL_MIN);
        residual[i] = scale * distance;
        for (int j = 0; j < STATE; j++) by_state[i][j] *= scale;
    }
}

void predict(const RingState *state, const Sighted *sighted, const Prediction *to) {
    predict_lines(state, sighted, to);
    compare_lines(sighted, to);
    find_origin(state, sighted, to);
    compare_points(state, sighted, to);
}

int prediction_numbers(int ends, int points) { return 16 * (ends + points) + 12 * points + ORIGIN_NUMBERS; }

void lay_out(double *to, int ends, int points, Prediction *laid) {
    int sights = ends + points, at = 0;
    Prediction parts = {.residual = to};
    at += sights;
    parts.by_state = (double(*)[STATE])(to + at), at += STATE * sights;
    parts.slope = to + at, at += sights;
    parts.steepness = to + at, at += sights;
    parts.y_by_plane = (double(*)[3])(to + at), at += 3 * sights;
    parts.ray = (double(*)[3])(to + at), at += 3 * sights;
    parts.distance = to + at, at += points;
    parts.by_ray = (double(*)[2])(to + at), at += 2 * points;
    parts.arc_by_state = (double(*)[STATE])(to + at), at += STATE * points;
    parts.by_x = to + at, at += points;
    parts.scale = to + at, at += points;
    parts.origin = to + at;
    *laid = parts;
}
