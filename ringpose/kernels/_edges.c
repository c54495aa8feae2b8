/* The Python side of the kernels that follow the ring's edges; arguments are checked here. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdlib.h>
#include <string.h>

#include "buffers.h"
#include "edges.h"

enum { ARCS = 14, LENS = 12, MOST_ROUNDS = 100 };

/* What an argument must be: its name, the element's format, axes, and elements in a row (0: any number). */
typedef struct {
    const char *name, *format;
    int size, axes, row;
} Shape;

/* Opens the arguments; a Python exception and 0 if one is not of its shape. */
static int open_shapes(PyObject *arguments, Py_buffer view[], const Shape shape[], Py_ssize_t count) {
    if (PyTuple_Size(arguments) != count) {
        PyErr_Format(PyExc_TypeError, "takes %zd arguments", count);
        return 0;
    }
    for (Py_ssize_t i = 0; i < count; i++) {
        PyObject *object = PyTuple_GetItem(arguments, i);
        const int writable = shape[i].name[0] == '>';
        int open = open_array(object, &view[i], shape[i].name, shape[i].format, shape[i].size, shape[i].axes, writable);
        if (open && (shape[i].row == 0 || view[i].shape[shape[i].axes - 1] == shape[i].row)) continue;
        if (open) PyErr_Format(PyExc_ValueError, "%s: must be %d", shape[i].name, shape[i].row);
        close_arrays(view, (int)i + open);
        return 0;
    }
    return 1;
}

static PyObject *released(PyObject *result, Py_buffer view[], int count) {
    close_arrays(view, count);
    return result;
}

/* Whether both arrays have as many rows. */
static int agree(const Py_buffer *one, const Py_buffer *other, const char *name) {
    if (one->shape[0] == other->shape[0]) return 1;
    PyErr_Format(PyExc_ValueError, "%s: must be as many as the others", name);
    return 0;
}

static PyObject *places(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Shape shape[] = {
        {"arcs", "d", 8, 1, ARCS}, {"covariance", "d", 8, 2, STATE}, {"lens", "d", 8, 1, LENS}, {"rules", "d", 8, 1, 11}};
    Py_buffer view[4];
    if (!open_shapes(arguments, view, shape, 4)) return NULL;
    if (view[1].shape[0] != STATE) {
        PyErr_SetString(PyExc_ValueError, "covariance: must be square");
        return released(NULL, view, 4);
    }
    RingArcs arcs;
    Lens lens;
    PlaceRules rules;
    memcpy(&arcs, view[0].buf, sizeof arcs);
    memcpy(&lens, view[2].buf, sizeof lens);
    memcpy(&rules, view[3].buf, sizeof rules);
    Place *place = malloc((most_places(&arcs, &lens, &rules) + 1) * sizeof *place);
    if (place == NULL) return released(PyErr_NoMemory(), view, 4);
    const size_t count = edge_places(&arcs, view[1].buf, &lens, &rules, place);
    PyObject *result = PyBytes_FromStringAndSize((const char *)place, (Py_ssize_t)(count * sizeof *place));
    free(place);
    return released(result, view, 4);
}

static PyObject *profiles_of(PyObject *object, Py_buffer view[6]) {
    Py_buffer image, peek;
    if (PyObject_GetBuffer(object, &peek, PyBUF_STRIDES) < 0) return NULL;
    const int wide = peek.itemsize == 2;
    PyBuffer_Release(&peek);
    if (!open_array(object, &image, "image", wide ? "H" : "B", wide ? 2 : 1, 2, 0)) return NULL;
    ProfileRules rules;
    memcpy(&rules, view[2].buf, sizeof rules);
    Profiles profiles = {view[3].buf, view[5].buf, view[4].buf, (size_t)view[0].shape[0], (size_t)view[3].shape[1]};
    const double right = (double)image.shape[1] - 1, bottom = (double)image.shape[0] - 1;
    const EdgePicture picture = {image.buf, (size_t)image.shape[0], (size_t)image.shape[1], right, bottom, wide};
    int done = 0;
    if (!(right >= 0 && right < INT32_MAX && bottom >= 0 && bottom < INT32_MAX))
        PyErr_SetString(PyExc_ValueError, "image: must have 1 to 2^31 - 1 rows and columns");
    else {
        Py_BEGIN_ALLOW_THREADS
        done = edge_profiles(&picture, view[0].buf, view[1].buf, &rules, &profiles);
        Py_END_ALLOW_THREADS
        if (!done) PyErr_NoMemory();
    }
    PyBuffer_Release(&image);
    return done ? Py_BuildValue("") : NULL;
}

static PyObject *profiles(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Shape shape[] = {{"place", "d", 8, 2, 2},   {"normal", "d", 8, 2, 2},    {"rules", "d", 8, 1, 7},
                                  {">value", "d", 8, 2, 0}, {">saturated", "?", 1, 2, 0}, {">noise", "d", 8, 1, 0}};
    Py_buffer view[6];
    PyObject *image, *rest, *result = NULL;
    if (PyTuple_Size(arguments) < 1) {
        PyErr_SetString(PyExc_TypeError, "takes an image");
        return NULL;
    }
    image = PyTuple_GetItem(arguments, 0);
    rest = PyTuple_GetSlice(arguments, 1, PyTuple_Size(arguments));
    if (rest == NULL) return NULL;
    if (open_shapes(rest, view, shape, 6)) {
        const double *rule = view[2].buf;
        const int fit = agree(&view[0], &view[1], "normal") && agree(&view[0], &view[3], "value") &&
                        agree(&view[0], &view[4], "saturated") && agree(&view[0], &view[5], "noise");
        if (fit && (view[3].shape[1] != view[4].shape[1] || !(rule[1] >= 2) || view[3].shape[1] < rule[1]))
            PyErr_SetString(PyExc_ValueError, "value: must have more samples than lie inside");
        else if (fit)
            result = profiles_of(image, view);
        released(NULL, view, 6);
    }
    Py_DECREF(rest);
    return result;
}

/* Whether templates and profiles fit together. */
static int templates_fit(const Py_buffer view[8]) {
    const Py_ssize_t samples = view[0].shape[1], count = view[4].shape[0];
    return samples > 3 && view[1].shape[1] == samples && view[3].shape[0] == samples && count > 2 &&
           view[5].shape[0] == count && view[6].shape[1] == count && view[6].shape[0] == 3 * samples;
}

static PyObject *steps_of(Py_buffer view[8]) {
    const size_t count = (size_t)view[0].shape[0], samples = (size_t)view[0].shape[1];
    const size_t places = (size_t)view[4].shape[0];
    const double *table = view[6].buf;
    Profiles profiles = {view[0].buf, view[2].buf, view[1].buf, count, samples};
    const Templates templates = {view[3].buf, view[4].buf, view[5].buf, table, table + samples * places,
                                 table + 2 * samples * places, places};
    StepRules rules;
    memcpy(&rules, view[7].buf, sizeof rules);
    EdgeStep *step = malloc((count + 1) * sizeof *step);
    int done = 0;
    if (step != NULL) {
        Py_BEGIN_ALLOW_THREADS
        done = edge_steps(&profiles, &templates, &rules, step);
        Py_END_ALLOW_THREADS
    }
    PyObject *result = done ? PyBytes_FromStringAndSize((const char *)step, (Py_ssize_t)(count * sizeof *step))
                            : PyErr_NoMemory();
    free(step);
    return result;
}

static PyObject *steps(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Shape shape[] = {{"value", "d", 8, 2, 0},  {"saturated", "?", 1, 2, 0}, {"noise", "d", 8, 1, 0},
                                  {"across", "d", 8, 1, 0}, {"place", "d", 8, 1, 0},     {"unit", "d", 8, 1, 0},
                                  {"table", "d", 8, 2, 0},  {"rules", "d", 8, 1, 4}};
    Py_buffer view[8];
    PyObject *result = NULL;
    if (!open_shapes(arguments, view, shape, 8)) return NULL;
    if (!templates_fit(view))
        PyErr_SetString(PyExc_ValueError, "table: does not fit the samples and places");
    else if (agree(&view[0], &view[1], "saturated") && agree(&view[0], &view[2], "noise"))
        result = steps_of(view);
    return released(result, view, 8);
}

static PyObject *fit(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Shape shape[] = {{"arcs", "d", 8, 1, ARCS},      {"plane_point", "d", 8, 2, AXES},
                                  {"plane_sigma", "d", 8, 1, 0},  {"reference", "d", 8, 1, AXES * AXES},
                                  {"ray", "d", 8, 2, AXES},       {"side", "d", 8, 1, 0},
                                  {"sigma", "d", 8, 1, 0},        {"rules", "d", 8, 1, 7 + STATE}};
    Py_buffer view[8];
    if (!open_shapes(arguments, view, shape, 8)) return NULL;
    if (!agree(&view[1], &view[2], "plane_sigma") || !agree(&view[4], &view[5], "side") ||
        !agree(&view[4], &view[6], "sigma"))
        return released(NULL, view, 8);
    FitRules rules;
    memcpy(&rules, view[7].buf, sizeof rules);
    if (!(rules.rounds >= 1 && rules.rounds <= MOST_ROUNDS)) {
        PyErr_Format(PyExc_ValueError, "rounds: must be 1 to %d", MOST_ROUNDS);
        return released(NULL, view, 8);
    }
    const Evidence evidence = {view[1].buf, view[2].buf, (size_t)view[1].shape[0], view[3].buf,
                               view[4].buf, view[5].buf, view[6].buf, (size_t)view[4].shape[0]};
    struct {
        RingArcs arcs;
        double covariance[STATE * STATE];
    } found;
    memcpy(&found.arcs, view[0].buf, sizeof found.arcs);
    fit_ring_arcs(&evidence, &rules, &found.arcs, found.covariance);
    return released(PyBytes_FromStringAndSize((const char *)&found, sizeof found), view, 8);
}

static PyMethodDef methods[] = {
    {"places", places, METH_VARARGS, "Where an image should show the ring's edges."},
    {"profiles", profiles, METH_VARARGS, "Brightness across places of an edge."},
    {"steps", steps, METH_VARARGS, "Steps of brightness in profiles."},
    {"fit", fit, METH_VARARGS, "The arcs that explain what was seen."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_edges", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__edges(void) { return PyModule_Create(&module); }
