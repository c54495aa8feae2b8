/* Which places on the ring's edges an image shows, where, and the edge's normal there (ringpose-method(7),
   section 5). */
#include "arguments.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "lens.h"

enum { STEP = 7, AXES = 3 };

#define PLACE_PARAMS(REAL, COUNT)                                                                                   \
    COUNT(image_width, 1, INT32_MAX)                                                                                \
    COUNT(image_height, 1, INT32_MAX)                                                                               \
    REAL(sigma_px, 0, INFINITY)                                                                                     \
    REAL(margin_px, NOT_NEGATIVE)                                                                                   \
    REAL(wider, NOT_NEGATIVE)                                                                                       \
    REAL(nudge_m, POSITIVE)
RECORD_STRUCT(PlaceParams, PLACE_PARAMS);
RECORD(PlaceParams, PLACE_PARAMS);

/* What the ring's model (geometry/ring.py) predicts: points on edges, unit vectors off the face there, the edge's sign
   and a number, the normals of the face (one for each point, or one for all), and the derivatives of the distance from
   the edge by the ring's step, one row for each increment; NULL if the ring is known exactly. */
typedef struct {
    const double (*point)[AXES], (*off_face)[AXES], *sign, *number, (*normal)[AXES], *wrt_step;
    size_t count, normals;
} Predicted;

#define PLACE_COLUMNS(COLUMN, COLUMNS_OF)                                                                           \
    COLUMNS_OF(point, AXES) COLUMNS_OF(off_face, AXES) COLUMN(sign)                                                 \
    COLUMNS_OF(position, 2) COLUMNS_OF(normal, 2) COLUMN(metres_per_px) COLUMN(number)
ROW_STRUCT(Place, PLACE_COLUMNS);
TABLE(Place, PLACE_COLUMNS);

/* Pinhole projection; 0 if the point is not in front of the camera. */
static int project(const Lens *lens, const double point[AXES], double at[2]) {
    at[0] = point[0] / point[2] * lens->fx + lens->cx;
    at[1] = point[1] / point[2] * lens->fy + lens->cy;
    return point[2] > 0;
}

/* Distorted image of a point moved by `step` times a direction; 0 if it is not in front of the camera. */
static int image_beside(const Lens *lens, const double point[AXES], const double direction[AXES], double step,
                        double at[2]) {
    double moved[AXES];
    for (int i = 0; i < AXES; i++) moved[i] = point[i] + step * direction[i];
    if (!project(lens, moved, at)) return 0;
    distort_pixel(lens, at, at + 1);
    return 1;
}

/* Image of a place, with the edge's unit normal off the face and the metres on the face per pixel along it, by steps of
   `nudge` off the face and along the edge; 0 if it is not in front of the camera. */
static int image_place(const double n[AXES], const Lens *lens, double nudge, Place *place) {
    const double *point = place->point, *off = place->off_face;
    const double along[AXES] = {n[1] * off[2] - n[2] * off[1], n[2] * off[0] - n[0] * off[2],
                                n[0] * off[1] - n[1] * off[0]};
    double nudged[2], next[2], *at = place->position;
    if (!image_beside(lens, point, off, 0, at) || !image_beside(lens, point, off, nudge, nudged) ||
        !image_beside(lens, point, along, nudge, next))
        return 0;
    const double x = at[1] - next[1], y = next[0] - at[0], length = sqrt(x * x + y * y);
    const double px_per_m = (x * (nudged[0] - at[0]) + y * (nudged[1] - at[1])) / length / nudge;
    const double turn = (px_per_m > 0) - (px_per_m < 0);
    place->normal[0] = x / length * turn;
    place->normal[1] = y / length * turn;
    place->metres_per_px = 1 / fabs(px_per_m);
    return 1;
}

/* Standard deviation of the distance from the edge, Eq. (5.2), with the covariance of the ring's step: J C J^T. */
static double predicted_sigma(const Predicted *predicted, size_t at, const double *covariance) {
    double jacobian[STEP], variance = 0;
    for (size_t i = 0; i < STEP; i++) jacobian[i] = predicted->wrt_step[i * predicted->count + at];
    for (size_t i = 0; i < STEP; i++) {
        double sum = 0;
        for (size_t j = 0; j < i; j++) sum += covariance[STEP * i + j] * jacobian[j];
        variance += jacobian[i] * (2 * sum + covariance[(STEP + 1) * i] * jacobian[i]);
    }
    return sqrt(fmax(variance, 0));
}

/* True if -wider < value < size + wider. */
static int within(double value, double size, double wider) { return value > -wider && value < size + wider; }

/* Fills in a predicted place; 0 if it is not in the image or predicted too poorly. Where a lens model folds, points far
   outside the image would be distorted into it: these are left out first. */
static int see_place(const Predicted *predicted, size_t i, const double *covariance, const Lens *lens,
                     const PlaceParams *params, Place *place) {
    double at[2];
    if (!project(lens, predicted->point[i], at) || !within(at[0], params->image_width, params->wider * params->image_width) ||
        !within(at[1], params->image_height, params->wider * params->image_height))
        return 0;
    const double sigma = predicted->wrt_step ? predicted_sigma(predicted, i, covariance) : 0;
    memcpy(place->point, predicted->point[i], sizeof place->point);
    memcpy(place->off_face, predicted->off_face[i], sizeof place->off_face);
    place->sign = predicted->sign[i];
    place->number = predicted->number[i];
    if (!image_place(predicted->normal[predicted->normals > 1 ? i : 0], lens, params->nudge_m, place)) return 0;
    return sigma <= params->sigma_px * place->metres_per_px &&
           within(place->position[0], params->image_width - 1, -params->margin_px) &&
           within(place->position[1], params->image_height - 1, -params->margin_px);
}

PyObject *call_edge_places(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"point", FLOAT64, {N, AXES}},
                                          {"off_face", FLOAT64, {N, AXES}},
                                          {"sign", FLOAT64, {N}},
                                          {"number", FLOAT64, {N}},
                                          {"normal", FLOAT64, {ANY, AXES}},
                                          {"?wrt_step", FLOAT64, {STEP, N}},
                                          {"?covariance", FLOAT64, {STEP, STEP}},
                                          {"lens", &Lens_record, {0}},
                                          {"params", &PlaceParams_record, {0}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const size_t count = (size_t)a.view[0].shape[0], normals = (size_t)a.view[4].shape[0];
    const double *wrt_step = a.view[5].obj ? a.view[5].buf : NULL;
    if (!require(normals == 1 || normals == count, "normal: must be one, or one for each point") ||
        !require(!wrt_step || a.view[6].obj, "covariance: is missing"))
        return close_arguments(&a, NULL);
    const Predicted predicted = {a.view[0].buf, a.view[1].buf, a.view[2].buf, a.view[3].buf,
                                 a.view[4].buf, wrt_step,      count,         normals};
    List places = {NULL, 0, 0, sizeof(Place)};
    const int done = reserve(&places, count + 1);
    for (size_t i = 0; done && i < count; i++)
        places.used += (size_t)see_place(&predicted, i, a.view[6].buf, (const Lens *)a.number[7],
                                         (const PlaceParams *)a.number[8], (Place *)places.data + places.used);
    return close_arguments(&a, list_bytes(done, &places));
}
