/* The Python side of the search for the most likely ring; arguments are checked here. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "buffers.h"
#include "ring_search.h"
#include "ring_start.h"

#include <math.h>

enum { STATE_AT, RAYS, LIGHT, WHITENING, POINTS, EDGE_RAYS, EDGES, RADII, COMMON, LEFT, RULES, ARRAYS };

static const Description expected[ARRAYS] = {
    {"state", "d", 1}, {"rays", "d", 2},   {"light", "d", 2}, {"whitening", "d", 2}, {"points", "d", 2},
    {"edge rays", "d", 2}, {"edges", "d", 2}, {"radii", "d", 2}, {"common", "d", 2}, {"left", "d", 1}, {"rules", "d", 1},
};

enum { HEAD = 1 + 9 + 2 * STATE * STATE, MOST_SIGHTS = 10000, MOST_ERRORS = 1000 };

static int known_radii(const double *radii) { return !isnan(radii[0]) + !isnan(radii[1]); }

static int fit_together(const Py_buffer *view) {
    Py_ssize_t sights = view[RAYS].shape[0], ends = view[WHITENING].shape[0], points = view[POINTS].shape[0];
    if (view[RADII].shape[0] != 2 || view[RADII].shape[1] != 2 || view[STATE_AT].shape[0] != 9) return 0;
    Py_ssize_t edges = view[EDGES].shape[0], errors = view[COMMON].shape[1];
    Py_ssize_t rows = sights + edges + known_radii(view[RADII].buf);
    if (view[EDGES].shape[1] != 3 || view[EDGE_RAYS].shape[0] != edges || view[EDGE_RAYS].shape[1] != 3) return 0;
    return view[RAYS].shape[1] == 3 && view[LIGHT].shape[0] == sights && view[LIGHT].shape[1] == 4 &&
           view[WHITENING].shape[1] == ends && view[POINTS].shape[1] == 2 && ends % 2 == 0 && points > 0 &&
           ends + points == sights && sights + edges <= MOST_SIGHTS && errors <= MOST_ERRORS &&
           (errors == 0 || view[COMMON].shape[0] == rows) && view[LEFT].shape[0] == rows && view[RULES].shape[0] == 6;
}

static RingState state_of(const double *s) {
    return (RingState){{s[0], s[1], s[2]}, {s[3], s[4], s[5]}, s[6], s[7], s[8]};
}

static void write_head(const Search *search, int status, double *to) {
    const RingState *s = &search->state;
    *to++ = status;
    memcpy(to, s->plane, sizeof s->plane);
    memcpy(to + 3, s->outward, sizeof s->outward);
    to[6] = s->shift, to[7] = s->curvature, to[8] = s->band;
    memcpy(to + 9, search->normal_matrix, sizeof search->normal_matrix);
    memcpy(to + 9 + STATE * STATE, search->inverse, sizeof search->inverse);
}

/* Head, error step, weights, what is left, residuals, derivatives, prediction. */
static PyObject *searched(const Py_buffer *view, int first, int last) {
    int ends = (int)view[WHITENING].shape[0], points = (int)view[POINTS].shape[0];
    const double *radii = view[RADII].buf, *r = view[RULES].buf;
    int edges = (int)view[EDGES].shape[0], rows = ends + points + edges + known_radii(radii), errors = (int)view[COMMON].shape[1];
    int count = HEAD + errors + (3 + STATE) * rows + prediction_numbers(ends, points);
    double *scratch = PyMem_Malloc(((size_t)scratch_numbers(errors) + 1) * sizeof *scratch);
    PyObject *result = PyBytes_FromStringAndSize(NULL, count * (Py_ssize_t)sizeof(double));
    if (!scratch || !result) {
        PyMem_Free(scratch);
        Py_XDECREF(result);
        return PyErr_NoMemory();
    }
    double *to = (double *)PyBytes_AsString(result), *at = to + HEAD + errors;
    memset(to, 0, (size_t)count * sizeof *to);
    Search search = {state_of(view[STATE_AT].buf), rows, at + 2 * rows, (double(*)[STATE])(at + 3 * rows), at, at + rows,
                     {{0}}, {{0}}, to + HEAD, scratch};
    memcpy(search.left, view[LEFT].buf, (size_t)rows * sizeof(double));
    Prediction prediction;
    lay_out(at + (3 + STATE) * rows, ends, points, &prediction);
    const Evidence evidence = {{ends, points, view[RAYS].buf, view[LIGHT].buf, view[WHITENING].buf, view[POINTS].buf},
                               {edges, view[EDGE_RAYS].buf, view[EDGES].buf},
                               {{radii[0], radii[1]}, {radii[2], radii[3]}}};
    const SearchRules rules = {r[0], r[1], r[2], r[3], r[4], r[5]};
    const Common common = {errors, view[COMMON].buf};
    int status = search_ring(&evidence, &common, &rules, first, last, &prediction, &search);
    write_head(&search, status, to);
    PyMem_Free(scratch);
    return result;
}

static PyObject *search(PyObject *module, PyObject *arguments) {
    (void)module;
    PyObject *o[ARRAYS], *result = NULL;
    Py_buffer view[ARRAYS];
    int first, last;
    if (!PyArg_ParseTuple(arguments, "OOOOOOOOOOOii", &o[0], &o[1], &o[2], &o[3], &o[4], &o[5], &o[6], &o[7], &o[8],
                          &o[9], &o[10], &first, &last))
        return NULL;
    if (!open_arrays(o, view, expected, ARRAYS)) return NULL;
    if (fit_together(view))
        result = searched(view, first, last);
    else
        PyErr_SetString(PyExc_ValueError, "search: arrays do not fit together");
    close_arrays(view, ARRAYS);
    return result;
}

enum { START_RAYS, START_LIGHT, START_WHITENING, START_POINTS, START_MIDDLE, START_ARRAYS };

static const Description start_expected[START_ARRAYS] = {
    {"rays", "d", 2}, {"light", "d", 2}, {"whitening", "d", 2}, {"points", "d", 2}, {"middle", "d", 1},
};

static int start_fits(const Py_buffer *view) {
    Py_ssize_t sights = view[0].shape[0], ends = view[START_WHITENING].shape[0], points = view[START_POINTS].shape[0];
    return view[0].shape[1] == 3 && view[START_LIGHT].shape[0] == sights && view[START_LIGHT].shape[1] == 4 &&
           view[START_WHITENING].shape[1] == ends && view[START_POINTS].shape[1] == 2 && ends % 2 == 0 && points > 0 &&
           ends + points == sights && sights <= MOST_SIGHTS && view[START_MIDDLE].shape[0] == points;
}

/* Plane, outward direction, how far out the points are; no bytes if there is no plane before the camera. */
static PyObject *started(const Py_buffer *view) {
    int ends = (int)view[START_WHITENING].shape[0], points = (int)view[START_POINTS].shape[0];
    double *room = PyMem_Malloc((6 + (size_t)points + (size_t)prediction_numbers(ends, points)) * sizeof *room);
    if (!room) return PyErr_NoMemory();
    Prediction sight;
    lay_out(room + 6 + points, ends, points, &sight);
    const Sighted sighted = {ends, points, view[0].buf, view[START_LIGHT].buf, view[START_WHITENING].buf,
                             view[START_POINTS].buf};
    RingStart start = {{0}, {0}, room + 6};
    int found = start_ring(&sighted, view[START_MIDDLE].buf, &sight, &start);
    memcpy(room, start.plane, sizeof start.plane);
    memcpy(room + 3, start.outward, sizeof start.outward);
    PyObject *result = PyBytes_FromStringAndSize((const char *)room, found ? (6 + points) * (Py_ssize_t)sizeof *room : 0);
    PyMem_Free(room);
    return result;
}

static PyObject *start(PyObject *module, PyObject *arguments) {
    (void)module;
    PyObject *o[START_ARRAYS], *result = NULL;
    Py_buffer view[START_ARRAYS];
    if (!PyArg_ParseTuple(arguments, "OOOOO", &o[0], &o[1], &o[2], &o[3], &o[4])) return NULL;
    if (!open_arrays(o, view, start_expected, START_ARRAYS)) return NULL;
    if (start_fits(view))
        result = started(view);
    else
        PyErr_SetString(PyExc_ValueError, "start: arrays do not fit together");
    close_arrays(view, START_ARRAYS);
    return result;
}

static PyMethodDef methods[] = {
    {"start", start, METH_VARARGS, "The plane of stripes, and where out is on it."},
    {"search", search, METH_VARARGS, "Steps towards the most likely ring."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_search", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__search(void) { return PyModule_Create(&module); }
