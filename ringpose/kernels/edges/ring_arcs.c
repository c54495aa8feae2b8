/* The ring's two edges as concentric arcs in a plane: their points, their prediction in the image with its sigma, and
   the robust Gauss-Newton fit to stripe endpoints, stripe lines and edge points (ringpose-method(7), section 4). */
#include "arguments.h"

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "cholesky.h"
#include "lens.h"

enum { STATE = 7, AXES = 3 };

/* As geometry.ring_arcs.RingArcs. */
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
    double point[AXES], outward[AXES], side, place[2], normal[2], metres_per_px, number;
} Place;

typedef struct {
    double rounds, outlier_sigmas;
    double tilt_sigma, turn_sigma, curvature_sigma, half_band, half_band_sigma;
    double max_step[STATE];
} FitParams;

typedef struct {
    const double *plane_point, *plane_sigma; /* of the ring's plane */
    size_t plane_points;
    const double *reference; /* axes of the priors */
    const double *ray, *side, *sigma;
    size_t observations;
} Evidence;

static double dot(const double a[AXES], const double b[AXES]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* A point on an edge (`side` 1: inner, -1: outer), and the unit vector away from the rim there. */
static void arc_point(const RingArcs *arcs, double along, double side, double point[AXES], double outward[AXES]) {
    const double half = arcs->curvature * along / 2, sine = sin(half), cosine = cos(half);
    const double toward[2] = {1 - 2 * sine * sine, -2 * sine * cosine};
    const double chord = half == 0 ? along : along * sine / half; /* at half the angle */
    const double x = chord * sine + side * arcs->half_band * toward[0];
    const double y = chord * cosine + side * arcs->half_band * toward[1];
    for (int i = 0; i < AXES; i++) {
        point[i] = arcs->origin[i] + x * arcs->axes[0][i] + y * arcs->axes[1][i];
        outward[i] = side * (toward[0] * arcs->axes[0][i] + toward[1] * arcs->axes[1][i]);
    }
}

/* Signed distance from its edge at which a ray intersects the plane, and its Jacobian with respect to the state: two
   tilts, offset along the normal, radial offset, in-plane rotation, curvature, half width. The formula is regular at
   curvature 0. */
static double off_face(const RingArcs *arcs, const double ray[AXES], double side, double jacobian[STATE]) {
    const double denominator = dot(ray, arcs->axes[2]), scale = dot(arcs->origin, arcs->axes[2]) / denominator;
    double offset[AXES];
    for (int i = 0; i < AXES; i++) offset[i] = ray[i] * scale - arcs->origin[i];
    const double x = dot(offset, arcs->axes[0]), y = dot(offset, arcs->axes[1]), curvature = arcs->curvature;
    const double to_center = sqrt((1 - curvature * x) * (1 - curvature * x) + curvature * y * (curvature * y));
    const double slope_x = (1 - curvature * x) / to_center, slope_y = -curvature * y / to_center;
    const double square = x * x + y * y, height = (2 * x - curvature * square) / (1 + to_center);
    const double wrt_curvature = (-square + height * (slope_x * x + slope_y * y)) / (1 + to_center);
    const double wrt_lift = (slope_x * dot(ray, arcs->axes[0]) + slope_y * dot(ray, arcs->axes[1])) / denominator;
    const double derivative[STATE] = {-x * wrt_lift, -y * wrt_lift, wrt_lift, -slope_x, slope_x * y - slope_y * x,
                                      wrt_curvature};
    for (int i = 0; i < STATE - 1; i++) jacobian[i] = side * derivative[i];
    jacobian[STATE - 1] = -1;
    return side * height - arcs->half_band;
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
    const double *normal = arcs->axes[2], *out = place->outward;
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
    arc_point(arcs, along, place->side, place->point, place->outward);
    if (!project(lens, place->point, at) || !within(at[0], params->width, params->wider * params->width) ||
        !within(at[1], params->height, params->wider * params->height))
        return 0;
    off_face(arcs, place->point, place->side, jacobian);
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
        place->side = i < edge ? 1 : -1;
        place->number = (double)(i % edge) - (double)(edge / 2);
        count += (size_t)see_place(arcs, covariance, lens, params, place->number * spacing, place);
    }
    return count;
}

typedef struct {
    double matrix[STATE][STATE], side[STATE]; /* the lower triangle */
} Equations;

static void add_row(Equations *equations, const double row[STATE], double residual, double weight) {
    for (int i = 0; i < STATE; i++) {
        const double weighted = weight * row[i];
        for (int j = 0; j <= i; j++) equations->matrix[i][j] += weighted * row[j];
        equations->side[i] += weighted * residual;
    }
}

static void add_observations(const Evidence *evidence, double outlier_sigmas, const RingArcs *arcs,
                             Equations *equations) {
    for (size_t k = 0; k < evidence->observations; k++) {
        double row[STATE];
        const double per = 1 / evidence->sigma[k];
        const double residual = off_face(arcs, evidence->ray + AXES * k, evidence->side[k], row) * per;
        const double excess = residual / outlier_sigmas, root = 1 / (1 + excess * excess);
        for (int i = 0; i < STATE; i++) row[i] *= per;
        add_row(equations, row, residual, root * root);
    }
}

static void add_plane(const Evidence *evidence, const RingArcs *arcs, Equations *equations) {
    for (size_t k = 0; k < evidence->plane_points; k++) {
        double offset[AXES];
        for (int i = 0; i < AXES; i++) offset[i] = evidence->plane_point[AXES * k + i] - arcs->origin[i];
        const double per = 1 / evidence->plane_sigma[k];
        const double row[STATE] = {dot(offset, arcs->axes[0]) * per, dot(offset, arcs->axes[1]) * per, -per};
        add_row(equations, row, dot(offset, arcs->axes[2]) * per, 1);
    }
}

static void add_priors(const Evidence *evidence, const FitParams *params, const RingArcs *arcs, Equations *equations) {
    const double *across = evidence->reference, *along = evidence->reference + AXES;
    const double *tilted[2] = {across, along};
    for (int i = 0; i < 2; i++) {
        const double row[STATE] = {dot(tilted[i], arcs->axes[0]) / params->tilt_sigma,
                                   dot(tilted[i], arcs->axes[1]) / params->tilt_sigma};
        add_row(equations, row, dot(tilted[i], arcs->axes[2]) / params->tilt_sigma, 1);
    }
    const double turn[STATE] = {0, 0, 0, 0, dot(arcs->axes[1], along) / params->turn_sigma};
    add_row(equations, turn, dot(arcs->axes[0], along) / params->turn_sigma, 1);
    const double curvature[STATE] = {0, 0, 0, 0, 0, 1 / params->curvature_sigma};
    add_row(equations, curvature, arcs->curvature / params->curvature_sigma, 1);
    const double band[STATE] = {0, 0, 0, 0, 0, 0, 1 / params->half_band_sigma};
    add_row(equations, band, (arcs->half_band - params->half_band) / params->half_band_sigma, 1);
}

/* Rotates the axes by the Cayley transform of a rotation vector: they stay orthonormal. */
static void turn_axes(const double turn[AXES], RingArcs *arcs) {
    const double x = turn[0], y = turn[1], z = turn[2], part = 1 / (1 + (x * x + y * y + z * z) / 4);
    const double skew[AXES][AXES] = {{0, z, -x}, {-z, 0, -y}, {x, y, 0}};
    double turned[AXES][AXES];
    for (int i = 0; i < AXES; i++)
        for (int k = 0; k < AXES; k++) {
            turned[i][k] = arcs->axes[i][k];
            for (int j = 0; j < AXES; j++) {
                const double square = skew[i][0] * skew[0][j] + skew[i][1] * skew[1][j] + skew[i][2] * skew[2][j];
                turned[i][k] += part * (skew[i][j] + square / 2) * arcs->axes[j][k];
            }
        }
    memcpy(arcs->axes, turned, sizeof turned);
}

static void retract(const double step[STATE], RingArcs *arcs) {
    for (int i = 0; i < AXES; i++) arcs->origin[i] += step[2] * arcs->axes[2][i] + step[3] * arcs->axes[0][i];
    turn_axes((const double[AXES]){step[0], step[1], step[4]}, arcs);
    arcs->curvature += step[5];
    arcs->half_band += step[6];
}

/* Gauss-Newton iterations; NaN if the normal equations are singular. */
static void fit_ring_arcs(const Evidence *evidence, const FitParams *params, RingArcs *arcs, double *covariance) {
    Equations equations;
    for (int round = 0; round < (int)params->rounds; round++) {
        memset(&equations, 0, sizeof equations);
        add_observations(evidence, params->outlier_sigmas, arcs, &equations);
        add_plane(evidence, arcs, &equations);
        add_priors(evidence, params, arcs, &equations);
        if (!factorised(equations.matrix[0], STATE)) equations.matrix[0][0] = NAN; /* makes all solutions NaN */
        solve(equations.matrix[0], STATE, equations.side, 1);
        for (int i = 0; i < STATE; i++) {
            const double step = -equations.side[i], maximum = params->max_step[i];
            equations.side[i] = step > maximum ? maximum : step < -maximum ? -maximum : step;
        }
        retract(equations.side, arcs);
    }
    for (int i = 0; i < STATE; i++) {
        double *row = covariance + STATE * i;
        memset(row, 0, STATE * sizeof *row);
        row[i] = 1;
        solve(equations.matrix[0], STATE, row, 1);
    }
}

enum { MAX_ROUNDS = 100 };

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

PyObject *call_edge_fit(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"arcs", 'd', {NUMBERS(RingArcs)}}, {"plane_point", 'd', {N, AXES}},
                                          {"plane_sigma", 'd', {N}},          {"reference", 'd', {AXES, AXES}},
                                          {"ray", 'd', {M, AXES}},            {"side", 'd', {M}},
                                          {"sigma", 'd', {M}},                {"params", 'T', {NUMBERS(FitParams)}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const FitParams *params = (const FitParams *)a.number[7];
    if (!require(params->rounds >= 1 && params->rounds <= MAX_ROUNDS, "rounds: must be 1 to 100"))
        return close_arguments(&a, NULL);
    const Evidence evidence = {a.view[1].buf, a.view[2].buf, (size_t)a.view[1].shape[0], a.view[3].buf,
                               a.view[4].buf, a.view[5].buf, a.view[6].buf, (size_t)a.view[4].shape[0]};
    struct {
        RingArcs arcs;
        double covariance[STATE * STATE];
    } found;
    memcpy(&found.arcs, a.view[0].buf, sizeof found.arcs);
    fit_ring_arcs(&evidence, params, &found.arcs, found.covariance);
    return close_arguments(&a, PyBytes_FromStringAndSize((const char *)&found, sizeof found));
}
