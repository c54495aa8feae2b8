/* Where the image should show the ring's edges, and how well that is known. */
#include "edges.h"

#include <math.h>

/* A point in the image without distortion; 0 if it is not before the camera. */
static int straight(const Lens *lens, const double point[AXES], double at[2]) {
    at[0] = point[0] / point[2] * lens->fx + lens->cx;
    at[1] = point[1] / point[2] * lens->fy + lens->cy;
    return point[2] > 0;
}

static double standard_deviation(const double by_state[STATE], const double *covariance) {
    double variance = 0;
    for (int i = 0; i < STATE; i++) {
        double sum = 0;
        for (int j = 0; j < i; j++) sum += covariance[STATE * i + j] * by_state[j];
        variance += by_state[i] * (2 * sum + covariance[(STATE + 1) * i] * by_state[i]);
    }
    return sqrt(fmax(variance, 0));
}

/* Where the image has the point `step` times a direction beyond that of a place. */
static int beside(const Lens *lens, const Place *place, const double direction[AXES], double step, double at[2]) {
    double point[AXES];
    for (int i = 0; i < AXES; i++) point[i] = place->point[i] + step * direction[i];
    if (!straight(lens, point, at)) return 0;
    distort_pixel(lens, at, at + 1);
    return 1;
}

/* Completes a place whose point is known; 0 if the camera does not see it. */
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

/* Whether the value lies between the limits, each moved outward by `wider`. */
static int within(double value, double size, double wider) { return value > -wider && value < size + wider; }

static double metres_per_px(const RingArcs *arcs, const Lens *lens) { return arcs->origin[2] / lens->fx; }

/* Places to one side of the arcs' origin, along one edge. */
static double reach(const RingArcs *arcs, const Lens *lens, const PlaceRules *rules) {
    double at[2];
    if (!straight(lens, arcs->origin, at)) return 0;
    const double x = fabs(at[0] - rules->width / 2) + rules->width / 2;
    const double y = fabs(at[1] - rules->height / 2) + rules->height / 2;
    const double count = floor(rules->detour * sqrt(x * x + y * y) / rules->spacing);
    const double turned = ceil(rules->half_turn / fabs(arcs->curvature * rules->spacing * metres_per_px(arcs, lens)));
    return fmin(fmin(count, turned - 1), rules->farthest);
}

size_t most_places(const RingArcs *arcs, const Lens *lens, const PlaceRules *rules) {
    const double count = reach(arcs, lens, rules);
    return count >= 0 && count < 1e6 ? 2 * (2 * (size_t)count + 1) : 0;
}

/* Completes a place at that distance along its edge; 0 if the edge is not predicted there, or not in the image. */
static int see_place(const RingArcs *arcs, const double *covariance, const Lens *lens, const PlaceRules *rules,
                     double along, Place *place) {
    double at[2], by_state[STATE];
    arc_point(arcs, along, place->side, place->point, place->outward);
    if (!straight(lens, place->point, at) || !within(at[0], rules->width, rules->wider * rules->width) ||
        !within(at[1], rules->height, rules->wider * rules->height))
        return 0;
    off_face(arcs, place->point, place->side, by_state);
    const double sigma = standard_deviation(by_state, covariance);
    if (!(sigma < rules->oblique * rules->sigma * metres_per_px(arcs, lens))) return 0;
    if (!image_place(arcs, lens, rules->nudge, place) || !(sigma < rules->sigma * place->metres_per_px)) return 0;
    return within(place->place[0], rules->width - 1, -rules->margin) &&
           within(place->place[1], rules->height - 1, -rules->margin);
}

size_t edge_places(const RingArcs *arcs, const double *covariance, const Lens *lens, const PlaceRules *rules,
                   Place *places) {
    const size_t most = most_places(arcs, lens, rules), edge = most / 2;
    const double spacing = rules->spacing * metres_per_px(arcs, lens);
    size_t count = 0;
    for (size_t i = 0; i < most; i++) {
        Place *place = places + count;
        place->side = i < edge ? 1 : -1;
        place->number = (double)(i % edge) - (double)(edge / 2);
        count += (size_t)see_place(arcs, covariance, lens, rules, place->number * spacing, place);
    }
    return count;
}
