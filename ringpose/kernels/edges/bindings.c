/* The Python side of the ring's visible edges. */
#include <stdlib.h>
#include <string.h>

#include "arguments.h"
#include "edges.h"

enum { MAX_ROUNDS = 100 };

PyObject *call_edge_places(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"arcs", 'd', {NUMBERS(RingArcs)}},
                                          {"covariance", 'd', {STATE, STATE}},
                                          {"lens", 'T', {NUMBERS(Lens)}},
                                          {"rules", 'T', {NUMBERS(PlaceRules)}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const RingArcs *arcs = a.view[0].buf;
    const Lens *lens = (const Lens *)a.number[2];
    const PlaceRules *rules = (const PlaceRules *)a.number[3];
    Place *place = malloc((most_places(arcs, lens, rules) + 1) * sizeof *place);
    if (place == NULL) return close_arguments(&a, PyErr_NoMemory());
    const size_t count = edge_places(arcs, a.view[1].buf, lens, rules, place);
    PyObject *result = PyBytes_FromStringAndSize((const char *)place, (Py_ssize_t)(count * sizeof *place));
    free(place);
    return close_arguments(&a, result);
}

PyObject *call_edge_profiles(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"image", 'I', {ANY, ANY}},
                                          {"place", 'd', {N, 2}},
                                          {"normal", 'd', {N, 2}},
                                          {"rules", 'T', {NUMBERS(ProfileRules)}},
                                          {">value", 'd', {N, M}},
                                          {">saturated", '?', {N, M}},
                                          {">noise", 'd', {N}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const Py_buffer *image = &a.view[0], *value = &a.view[4];
    const ProfileRules *rules = (const ProfileRules *)a.number[3];
    if (!require(rules->inside >= 2 && (double)value->shape[1] >= rules->inside,
                 "value: must have more samples than lie inside"))
        return close_arguments(&a, NULL);
    Profiles profiles = {value->buf, a.view[6].buf, a.view[5].buf, (size_t)value->shape[0], (size_t)value->shape[1]};
    const double right = (double)image->shape[1] - 1, bottom = (double)image->shape[0] - 1;
    const EdgePicture picture = {image->buf, (size_t)image->shape[0], (size_t)image->shape[1], right, bottom,
                                 image->itemsize == 2};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = edge_profiles(&picture, a.view[1].buf, a.view[2].buf, rules, &profiles);
    Py_END_ALLOW_THREADS
    return close_arguments(&a, done ? Py_BuildValue("") : PyErr_NoMemory());
}

PyObject *call_edge_steps(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"value", 'd', {N, M}},  {"saturated", '?', {N, M}}, {"noise", 'd', {N}},
                                          {"across", 'd', {M}},    {"place", 'd', {K}},        {"unit", 'd', {K}},
                                          {"table", 'd', {3, M, K}}, {"rules", 'T', {NUMBERS(StepRules)}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const size_t count = (size_t)a.view[0].shape[0], samples = (size_t)a.view[0].shape[1];
    const size_t places = (size_t)a.view[4].shape[0];
    if (!require(samples > 3 && places > 2, "table: must have more than 3 samples and 2 places"))
        return close_arguments(&a, NULL);
    const double *table = a.view[6].buf;
    Profiles profiles = {a.view[0].buf, a.view[2].buf, a.view[1].buf, count, samples};
    const Templates templates = {a.view[3].buf, a.view[4].buf, a.view[5].buf, table, table + samples * places,
                                 table + 2 * samples * places, places};
    EdgeStep *step = malloc((count + 1) * sizeof *step);
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = step && edge_steps(&profiles, &templates, (const StepRules *)a.number[7], step);
    Py_END_ALLOW_THREADS
    PyObject *result = done ? PyBytes_FromStringAndSize((const char *)step, (Py_ssize_t)(count * sizeof *step))
                            : PyErr_NoMemory();
    free(step);
    return close_arguments(&a, result);
}

PyObject *call_edge_fit(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"arcs", 'd', {NUMBERS(RingArcs)}}, {"plane_point", 'd', {N, AXES}},
                                          {"plane_sigma", 'd', {N}},          {"reference", 'd', {AXES, AXES}},
                                          {"ray", 'd', {M, AXES}},            {"side", 'd', {M}},
                                          {"sigma", 'd', {M}},                {"rules", 'T', {NUMBERS(FitRules)}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const FitRules *rules = (const FitRules *)a.number[7];
    if (!require(rules->rounds >= 1 && rules->rounds <= MAX_ROUNDS, "rounds: must be 1 to 100"))
        return close_arguments(&a, NULL);
    const Evidence evidence = {a.view[1].buf, a.view[2].buf, (size_t)a.view[1].shape[0], a.view[3].buf,
                               a.view[4].buf, a.view[5].buf, a.view[6].buf, (size_t)a.view[4].shape[0]};
    struct {
        RingArcs arcs;
        double covariance[STATE * STATE];
    } found;
    memcpy(&found.arcs, a.view[0].buf, sizeof found.arcs);
    fit_ring_arcs(&evidence, rules, &found.arcs, found.covariance);
    return close_arguments(&a, PyBytes_FromStringAndSize((const char *)&found, sizeof found));
}
