/* Prediction of the ring's two edges in the image, with their sigma (ringpose-method(7), section 5). */
#include "arguments.h"

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "lens.h"

enum { STATE = 7, AXES = 3 };

/* As geometry.ring.RingArcs. */
typedef struct {
    double origin[AXES], axes[AXES][AXES], curvature, half_band;
} RingArcs;

typedef struct {
    double width, height;       /* of the image */
    double spacing, sigma;      /* pixels between places; largest predicted sigma */
    double half_turn;           /* radians to both sides */
    double margin, wider;       /* distance from the image border; bound of the distortion, share of the image size */
    double oblique, detour, nudge;
    double max_count; /* place to both sides of the arcs' origin */
} PlaceParams;

typedef struct {
    double point[AXES], off_face[AXES], sign, place[2], normal[2], metres_per_px, number;
} Place;

static double dot(const double a[AXES], const double b[AXES]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* A point on an edge (`sign` -1: inner, 1: outer), and the unit vector off the face there. */
static void arc_point(const RingArcs *arcs, double along, double sign, double point[AXES], double off_face[AXES]) {
    const double half = arcs->curvature * along / 2, sine = sin(half), cosine = cos(half);
    const double outward[2] = {2 * sine * sine - 1, 2 * sine * cosine};
    const double chord = half == 0 ? along : along * sine / half; /* at half the angle */
    const double x = chord * sine + sign * arcs->half_band * outward[0];
    const double y = chord * cosine + sign * arcs->half_band * outward[1];
    for (int i = 0; i < AXES; i++) {
        point[i] = arcs->origin[i] + x * arcs->axes[0][i] + y * arcs->axes[1][i];
        off_face[i] = sign * (outward[0] * arcs->axes[0][i] + outward[1] * arcs->axes[1][i]);
    }
}

/* Derivatives of the signed distance from an edge at which a ray meets the ring's plane, with respect to the step of
   geometry.ring, Eq. (5.2) of ringpose-method(7). */
static void distance_wrt_step(const RingArcs *arcs, const double ray[AXES], double sign, double jacobian[STATE]) {
    const double denominator = dot(ray, arcs->axes[2]), depth = dot(arcs->origin, arcs->axes[2]) / denominator;
    double offset[AXES];
    for (int i = 0; i < AXES; i++) offset[i] = ray[i] * depth - arcs->origin[i];
    const double x = dot(offset, arcs->axes[0]), y = dot(offset, arcs->axes[1]), curvature = arcs->curvature;
    const double h_x = 1 - curvature * x, h_y = curvature * y, h = sqrt(h_x * h_x + h_y * h_y);
    const double wrt_x = -h_x / h, wrt_y = h_y / h, square = x * x + y * y;
    const double outside = (curvature * square - 2 * x) / (1 + h);
    const double wrt_lift = (wrt_x * dot(ray, arcs->axes[0]) + wrt_y * dot(ray, arcs->axes[1])) / denominator;
    const double derivative[STATE] = {-x * wrt_lift,           -y * wrt_lift, wrt_lift, -wrt_x,
                                      wrt_x * y - wrt_y * x, (square - outside * outside) / (2 * h), -sign};
    memcpy(jacobian, derivative, sizeof derivative);
}

/* Pinhole projection; 0 if the point is not in front of the camera. */
static int project(const Lens *lens, const double point[AXES], double at[2]) {
    at[0] = point[0] / point[2] * lens->fx + lens->cx;
    at[1] = point[1] / point[2] * lens->fy + lens->cy;
    return point[2] > 0;
}

static double standard_deviation(const double jacobian[STATE], const double *covariance) {
    double variance = 0;
    for (int i = 0; i < STATE; i++) {
        double sum = 0;
        for (int j = 0; j < i; j++) sum += covariance[STATE * i + j] * jacobian[j];
        variance += jacobian[i] * (2 * sum + covariance[(STATE + 1) * i] * jacobian[i]);
    }
    return sqrt(fmax(variance, 0));
}

/* Distorted image of the place's point moved by `step` times a direction. */
static int beside(const Lens *lens, const Place *place, const double direction[AXES], double step, double at[2]) {
    double point[AXES];
    for (int i = 0; i < AXES; i++) point[i] = place->point[i] + step * direction[i];
    if (!project(lens, point, at)) return 0;
    distort_pixel(lens, at, at + 1);
    return 1;
}

/* Fills in the image of a place's point; 0 if it is not visible. */
static int image_place(const RingArcs *arcs, const Lens *lens, double nudge, Place *place) {
    const double *normal = arcs->axes[2], *out = place->off_face;
    const double along[AXES] = {normal[1] * out[2] - normal[2] * out[1], normal[2] * out[0] - normal[0] * out[2],
                                normal[0] * out[1] - normal[1] * out[0]};
    double nudged[2], next[2];
    if (!beside(lens, place, out, 0, place->place) || !beside(lens, place, out, nudge, nudged) ||
        !beside(lens, place, along, nudge, next))
        return 0;
    const double x = place->place[1] - next[1], y = next[0] - place->place[0], length = sqrt(x * x + y * y);
    const double off = (x * (nudged[0] - place->place[0]) + y * (nudged[1] - place->place[1])) / length / nudge;
    const double turn = (off > 0) - (off < 0);
    place->normal[0] = x / length * turn;
    place->normal[1] = y / length * turn;
    place->metres_per_px = 1 / fabs(off);
    return 1;
}

/* True if -wider < value < size + wider. */
static int within(double value, double size, double wider) { return value > -wider && value < size + wider; }

static double metres_per_px(const RingArcs *arcs, const Lens *lens) { return arcs->origin[2] / lens->fx; }

/* Number of places on one edge to one side of the arcs' origin. */
static double reach(const RingArcs *arcs, const Lens *lens, const PlaceParams *params) {
    double at[2];
    if (!project(lens, arcs->origin, at)) return 0;
    const double x = fabs(at[0] - params->width / 2) + params->width / 2;
    const double y = fabs(at[1] - params->height / 2) + params->height / 2;
    const double count = floor(params->detour * sqrt(x * x + y * y) / params->spacing);
    const double turned = ceil(params->half_turn / fabs(arcs->curvature * params->spacing * metres_per_px(arcs, lens)));
    return fmin(fmin(count, turned - 1), params->max_count);
}

/* Upper bound of the number of places. */
static size_t max_places(const RingArcs *arcs, const Lens *lens, const PlaceParams *params) {
    const double count = reach(arcs, lens, params);
    return count >= 0 && count < 1e6 ? 2 * (2 * (size_t)count + 1) : 0;
}

/* Fills in the place at a distance along its edge; 0 if it is not in the image or predicted too poorly. */
static int see_place(const RingArcs *arcs, const double *covariance, const Lens *lens, const PlaceParams *params,
                     double along, Place *place) {
    double at[2], jacobian[STATE];
    arc_point(arcs, along, place->sign, place->point, place->off_face);
    if (!project(lens, place->point, at) || !within(at[0], params->width, params->wider * params->width) ||
        !within(at[1], params->height, params->wider * params->height))
        return 0;
    distance_wrt_step(arcs, place->point, place->sign, jacobian);
    const double sigma = standard_deviation(jacobian, covariance);
    if (!(sigma < params->oblique * params->sigma * metres_per_px(arcs, lens))) return 0;
    if (!image_place(arcs, lens, params->nudge, place) || !(sigma < params->sigma * place->metres_per_px)) return 0;
    return within(place->place[0], params->width - 1, -params->margin) &&
           within(place->place[1], params->height - 1, -params->margin);
}

/* The places in the image, along the inner edge first; `places` has room for `max_places`. Returns how many. */
static size_t edge_places(const RingArcs *arcs, const double *covariance, const Lens *lens, const PlaceParams *params,
                   Place *places) {
    const size_t maximum = max_places(arcs, lens, params), edge = maximum / 2;
    const double spacing = params->spacing * metres_per_px(arcs, lens);
    size_t count = 0;
    for (size_t i = 0; i < maximum; i++) {
        Place *place = places + count;
        place->sign = i < edge ? -1 : 1;
        place->number = (double)(i % edge) - (double)(edge / 2);
        count += (size_t)see_place(arcs, covariance, lens, params, place->number * spacing, place);
    }
    return count;
}

PyObject *call_edge_places(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"arcs", 'd', {NUMBERS(RingArcs)}},
                                          {"covariance", 'd', {STATE, STATE}},
                                          {"lens", 'T', {NUMBERS(Lens)}},
                                          {"params", 'T', {NUMBERS(PlaceParams)}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const RingArcs *arcs = a.view[0].buf;
    const Lens *lens = (const Lens *)a.number[2];
    const PlaceParams *params = (const PlaceParams *)a.number[3];
    Place *place = malloc((max_places(arcs, lens, params) + 1) * sizeof *place);
    if (place == NULL) return close_arguments(&a, PyErr_NoMemory());
    const size_t count = edge_places(arcs, a.view[1].buf, lens, params, place);
    PyObject *result = PyBytes_FromStringAndSize((const char *)place, (Py_ssize_t)(count * sizeof *place));
    free(place);
    return close_arguments(&a, result);
}
