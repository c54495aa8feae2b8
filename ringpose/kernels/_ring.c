/* The Python side of the kernels that look for the ring; arguments are checked here. Twin: reference_ring.py. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "arcs.h"
#include "buffers.h"
#include "ends.h"
#include "tracks.h"

enum { LENS = 12, RULES = 8 };

static Lens lens_of(const Py_buffer *view) {
    const double *v = view->buf;
    return (Lens){v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9], v[10], v[11]};
}

/* Whether all centres are finite, their pieces ascend from 0, and every piece has a laser. */
static int centers_in_order(const Py_buffer view[6]) {
    const double(*at)[2] = view[0].buf, *sigma = view[1].buf;
    const int64_t *piece = view[2].buf;
    Py_ssize_t n = view[0].shape[0];
    for (Py_ssize_t i = 0; i < n; i++) {
        int in_order = piece[i] >= (i ? piece[i - 1] : 0) && piece[i] < view[3].shape[0];
        if (in_order && isfinite(at[i][0]) && isfinite(at[i][1]) && isfinite(sigma[i])) continue;
        PyErr_Format(PyExc_ValueError, "centers: number %zd is not finite, or its piece is out of order", i);
        return 0;
    }
    return 1;
}

/* Rules of tracks: a piece must hold the running median's half window, or that reads beyond it. */
enum { LEAST_COLUMNS = 4 };

static int track_rules_fit(const double *rule) {
    for (int i = 0; i < RULES; i++)
        if (!isfinite(rule[i])) return 0;
    return rule[5] >= LEAST_COLUMNS && rule[6] >= 1 && rule[6] < 1e6 && rule[7] >= 0;
}

static PyObject *tracks_of(const Py_buffer view[6]) {
    Py_ssize_t n = view[0].shape[0];
    const double *rule = view[5].buf, (*at)[2] = view[0].buf;
    if (view[0].shape[1] != 2 || view[1].shape[0] != n || view[2].shape[0] != n || view[4].shape[0] != LENS ||
        view[5].shape[0] != RULES || n > INT32_MAX || !track_rules_fit(rule)) {
        PyErr_SetString(PyExc_ValueError, "tracks: arrays do not fit together, or a rule is out of range");
        return NULL;
    }
    if (!centers_in_order(view)) return NULL;
    double *column = malloc((size_t)(n ? 3 * n : 1) * sizeof *column);
    Lens lens = lens_of(&view[4]);
    Track *track = NULL;
    size_t count = 0;
    if (column) {
        Py_BEGIN_ALLOW_THREADS
        double *x = column + n, *y = x + n;
        for (Py_ssize_t i = 0; i < n; i++) {
            column[i] = x[i] = at[i][0];
            y[i] = at[i][1];
        }
        undistort(&lens, x, y, (size_t)n);
        Centers centers = {(size_t)n, (size_t)view[3].shape[0], column, x, y, view[1].buf, view[2].buf, view[3].buf};
        TrackRules rules = {rule[0], rule[1], rule[2], rule[3], rule[4], (size_t)rule[5], (size_t)rule[7], rule[6]};
        track = straight_tracks(&centers, &rules, &count);
        Py_END_ALLOW_THREADS
    }
    PyObject *result =
        track ? PyBytes_FromStringAndSize((const char *)track, (Py_ssize_t)(count * sizeof *track)) : PyErr_NoMemory();
    free(track);
    free(column);
    return result;
}

static PyObject *tracks(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Description description[] = {{"position", "d", 2}, {"sigma", "d", 1}, {"piece", "lq", 1},
                                              {"laser", "lq", 1},   {"lens", "d", 1},  {"rules", "d", 1}};
    PyObject *o[6], *result = NULL;
    Py_buffer view[6];
    if (!PyArg_ParseTuple(arguments, "OOOOOO", &o[0], &o[1], &o[2], &o[3], &o[4], &o[5])) return NULL;
    if (!open_arrays(o, view, description, 6)) return NULL;
    result = tracks_of(view);
    for (int i = 0; i < 6; i++) PyBuffer_Release(&view[i]);
    return result;
}

static PyObject *arcs_of(const Py_buffer view[4], double circle_sigma) {
    int lasers = (int)view[0].shape[0], count = 0;
    if (view[0].shape[0] > MOST_ENDS / 2 || view[0].shape[1] != 2 || view[0].shape[2] != 2 ||
        view[1].shape[0] != lasers || view[1].shape[1] != 2 || view[2].shape[0] != lasers || view[2].shape[1] != 4 ||
        view[3].shape[0] != LENS) {
        PyErr_SetString(PyExc_ValueError, "arcs: arrays do not fit together");
        return NULL;
    }
    const double(*position)[2] = view[0].buf, *along = view[1].buf, (*plane)[4] = view[2].buf;
    double place[MOST_ENDS][2], light[MOST_ENDS][4], cost[MOST_ENDS + 3], result[MOST_ENDS + 3];
    End end[MOST_ENDS];
    int seen[MOST_ENDS];
    for (int k = 0; k < 2 * lasers; k++) {
        result[k + 1] = NAN;
        if (isnan(position[k][0])) continue;
        memcpy(place[count], position[k], sizeof place[0]);
        memcpy(light[count], plane[k / 2], sizeof light[0]);
        end[count] = (End){.arc = k % 2, .used = 1};
        seen[count++] = k;
    }
    Lens lens = lens_of(&view[3]);
    flatten_ends(place[0], light[0], &lens, end, count);
    for (int i = 0; i < count; i++) {
        double metres = end[i].sigma;
        end[i].along_sigma = along[seen[i]] * metres;
        end[i].sigma = hypot(end[i].along_sigma, circle_sigma * metres);
    }
    arc_costs(end, count, cost);
    result[0] = cost[0];
    for (int i = 0; i < count; i++) result[seen[i] + 1] = cost[i + 1];
    memcpy(result + 2 * lasers + 1, cost + count + 1, 2 * sizeof *cost);
    return PyBytes_FromStringAndSize((const char *)result, (Py_ssize_t)((size_t)(2 * lasers + 3) * sizeof *result));
}

static PyObject *arcs(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Description description[] = {
        {"position", "d", 3}, {"along", "d", 2}, {"planes", "d", 2}, {"lens", "d", 1}};
    PyObject *o[4], *result = NULL;
    Py_buffer view[4];
    double circle_sigma;
    if (!PyArg_ParseTuple(arguments, "OOOOd", &o[0], &o[1], &o[2], &o[3], &circle_sigma)) return NULL;
    if (!open_arrays(o, view, description, 4)) return NULL;
    result = arcs_of(view, circle_sigma);
    for (int i = 0; i < 4; i++) PyBuffer_Release(&view[i]);
    return result;
}

enum { END_RULES = 18, LINE_COLUMNS = 5 };

static PyObject *ends_of(const Py_buffer *lit, const Py_buffer *dark, const Py_buffer view[3]) {
    const double *lens = view[1].buf, *rule = view[2].buf;
    if (view[0].shape[1] != LINE_COLUMNS || view[1].shape[0] != LENS || view[2].shape[0] != END_RULES ||
        lit->shape[0] < 1 || lit->shape[1] < 1 ||
        (dark && (dark->shape[0] != lit->shape[0] || dark->shape[1] != lit->shape[1]))) {
        PyErr_SetString(PyExc_ValueError, "ends: arrays do not fit together");
        return NULL;
    }
    Images images = {lit->buf, dark ? dark->buf : NULL, lit->shape[0], lit->shape[1], lit->itemsize == 2};
    Lens camera = {lens[0], lens[1], lens[2], lens[3], lens[4],  lens[5],
                   lens[6], lens[7], lens[8], lens[9], lens[10], lens[11]};
    EndRules rules;
    memcpy(&rules, rule, sizeof rules);
    size_t lines = (size_t)view[0].shape[0];
    StripeEnd *end = malloc((lines ? lines : 1) * 2 * sizeof *end);
    int done = 0;
    if (end) {
        Py_BEGIN_ALLOW_THREADS
        done = stripe_ends(&images, view[0].buf, lines, &camera, &rules, end);
        Py_END_ALLOW_THREADS
    }
    PyObject *result =
        done ? PyBytes_FromStringAndSize((const char *)end, (Py_ssize_t)(lines * 2 * sizeof *end)) : PyErr_NoMemory();
    free(end);
    return result;
}

/* An image of 8 or 16 bits. */
static int open_image(PyObject *object, Py_buffer *view, const char *name) {
    Py_buffer peek;
    if (PyObject_GetBuffer(object, &peek, PyBUF_STRIDES) < 0) return 0;
    int wide = peek.itemsize == 2;
    PyBuffer_Release(&peek);
    return open_array(object, view, name, wide ? "H" : "B", wide ? 2 : 1, 2, 0);
}

static PyObject *ends(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Description description[] = {{"lines", "d", 2}, {"lens", "d", 1}, {"rules", "d", 1}};
    PyObject *lit, *dark, *o[3], *result = NULL;
    Py_buffer lit_view, dark_view, view[3];
    if (!PyArg_ParseTuple(arguments, "OOOOO", &lit, &dark, &o[0], &o[1], &o[2])) return NULL;
    if (!open_image(lit, &lit_view, "lit")) return NULL;
    int with_dark = dark != Py_None;
    if (!with_dark || open_image(dark, &dark_view, "dark")) {
        if (with_dark && dark_view.itemsize != lit_view.itemsize)
            PyErr_SetString(PyExc_TypeError, "dark: must be of the same type as lit");
        else if (open_arrays(o, view, description, 3)) {
            result = ends_of(&lit_view, with_dark ? &dark_view : NULL, view);
            for (int i = 0; i < 3; i++) PyBuffer_Release(&view[i]);
        }
        if (with_dark) PyBuffer_Release(&dark_view);
    }
    PyBuffer_Release(&lit_view);
    return result;
}

static PyMethodDef methods[] = {
    {"arcs", arcs, METH_VARARGS, "How well points fit two arcs about one centre."},
    {"ends", ends, METH_VARARGS, "Ends of stripes."},
    {"tracks", tracks, METH_VARARGS, "Straight tracks among stripe centres."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_ring", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__ring(void) { return PyModule_Create(&module); }
