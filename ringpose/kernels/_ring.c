/* The Python side of the kernels that look for the ring; arguments are checked here. Twin: reference_ring.py. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "arcs.h"
#include "buffers.h"
#include "ends.h"
#include "ring.h"
#include "tracks.h"

/* Inverse depth at both ends, and the end's share in the equations of a plane: 1/z = p . (x, y, 1), each weighted
   by what a pixel's error across the track does to the inverse depth. */
static void complete(Candidate *candidate, const double light[3], double across_sigma, double focal_y) {
    double sigma = fmax(across_sigma * fabs(light[1]) / focal_y, 1e-12), weight = 1 / (sigma * sigma);
    for (int side = 0; side < 2; side++) {
        double x = candidate->x[side], y = candidate->y[side], w = light[0] * x + light[1] * y + light[2];
        double product[6] = {x * x, x * y, x, y * y, y, 1};
        candidate->inverse_depth[side] = w;
        for (int k = 0; k < 6; k++) candidate->normal_matrix[k] += weight * product[k];
        candidate->right_side[0] += weight * x * w;
        candidate->right_side[1] += weight * y * w;
        candidate->right_side[2] += weight * w;
        candidate->square += weight * w * w;
    }
}

static PyObject *group(const Best *best, int size) {
    return Py_BuildValue("(iiidd)", best->index[0], size > 1 ? best->index[1] : -1, size > 2 ? best->index[2] : -1,
                         best->score, best->rival);
}

enum { PARAMETERS = 16 };

static PyObject *groups_of(Py_buffer view[6]) {
    Py_ssize_t count = view[0].shape[0];
    const double *parameter = view[5].buf;
    if (view[1].shape[0] != count || view[2].shape[0] != count || view[2].shape[1] != 4 ||
        view[3].shape[0] != count || view[4].shape[1] != 3 || view[5].shape[0] != PARAMETERS || count > 10000) {
        PyErr_SetString(PyExc_ValueError, "groups: arrays do not fit together");
        return NULL;
    }
    Scene scene = {(int)view[4].shape[0],
                   (const double(*)[3])view[4].buf,
                   parameter[0], parameter[1], parameter[2], parameter[3], parameter[4], parameter[5],
                   {parameter[7], parameter[8], parameter[9], parameter[10], parameter[11], parameter[12],
                    parameter[13], parameter[14], parameter[15]}};
    Candidate *all = calloc((size_t)(count > 0 ? count : 1), sizeof *all);
    if (!all) return PyErr_NoMemory();
    for (Py_ssize_t i = 0; i < count; i++) {
        const double *end = (const double *)view[2].buf + 4 * i;
        int32_t laser = ((const int32_t *)view[1].buf)[i];
        if (laser < 0 || laser >= scene.lasers) {
            free(all);
            PyErr_Format(PyExc_ValueError, "laser: number %zd is not of the rig", i);
            return NULL;
        }
        all[i] = (Candidate){.track = ((const int32_t *)view[0].buf)[i],
                             .laser = laser,
                             .x = {end[0], end[2]},
                             .y = {end[1], end[3]},
                             .merit = ((const double *)view[3].buf)[i]};
        complete(&all[i], scene.plane[laser], parameter[6], scene.focal_y);
    }
    Best best[MOST_MEMBERS];
    Py_BEGIN_ALLOW_THREADS
    for (int size = 1; size <= MOST_MEMBERS; size++) best[size - 1] = best_group(all, (int)count, size, &scene);
    Py_END_ALLOW_THREADS
    free(all);
    return Py_BuildValue("(NNN)", group(&best[0], 1), group(&best[1], 2), group(&best[2], 3));
}

/* Opens arrays one after the other; 1 if all are as described (axes, 'd' doubles, 'i' int32, 'q' int64). */
typedef struct {
    const char *name, *format;
    int axes;
} Description;

static int size_of(char format) { return format == 'i' ? 4 : 8; }

static int open_arrays(PyObject *const object[], Py_buffer view[], const Description description[], int count) {
    for (int i = 0; i < count; i++) {
        const Description *d = &description[i];
        if (open_array(object[i], &view[i], d->name, d->format, size_of(d->format[0]), d->axes, 0)) continue;
        while (i > 0) PyBuffer_Release(&view[--i]);
        return 0;
    }
    return 1;
}

static PyObject *groups(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Description description[] = {{"track", "i", 1}, {"laser", "i", 1},  {"ends", "d", 2},
                                              {"merit", "d", 1}, {"planes", "d", 2}, {"parameters", "d", 1}};
    PyObject *o[6], *result = NULL;
    Py_buffer view[6];
    if (!PyArg_ParseTuple(arguments, "OOOOOO", &o[0], &o[1], &o[2], &o[3], &o[4], &o[5])) return NULL;
    if (!open_arrays(o, view, description, 6)) return NULL;
    result = groups_of(view);
    for (int i = 0; i < 6; i++) PyBuffer_Release(&view[i]);
    return result;
}

enum { LENS = 12, RULES = 8 };

static Lens lens_of(const Py_buffer *view) {
    const double *v = view->buf;
    return (Lens){v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9], v[10], v[11]};
}

/* Whether all centres are finite, their pieces ascend from 0, and every piece has a laser. */
static int centers_in_order(const Py_buffer view[7]) {
    const double *x = view[0].buf, *y = view[1].buf, *sigma = view[2].buf;
    const int64_t *piece = view[3].buf;
    Py_ssize_t n = view[0].shape[0];
    for (Py_ssize_t i = 0; i < n; i++) {
        int in_order = piece[i] >= (i ? piece[i - 1] : 0) && piece[i] < view[4].shape[0];
        if (in_order && isfinite(x[i]) && isfinite(y[i]) && isfinite(sigma[i])) continue;
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

static PyObject *tracks_of(const Py_buffer view[7]) {
    Py_ssize_t n = view[0].shape[0];
    const double *rule = view[6].buf;
    if (view[1].shape[0] != n || view[2].shape[0] != n || view[3].shape[0] != n || view[5].shape[0] != LENS ||
        view[6].shape[0] != RULES || n > INT32_MAX || !track_rules_fit(rule)) {
        PyErr_SetString(PyExc_ValueError, "tracks: arrays do not fit together, or a rule is out of range");
        return NULL;
    }
    if (!centers_in_order(view)) return NULL;
    double *x = malloc((size_t)(n ? n : 1) * sizeof *x), *y = malloc((size_t)(n ? n : 1) * sizeof *y);
    Lens lens = lens_of(&view[5]);
    Track *track = NULL;
    size_t count = 0;
    if (x && y) {
        Py_BEGIN_ALLOW_THREADS
        memcpy(x, view[0].buf, (size_t)n * sizeof *x);
        memcpy(y, view[1].buf, (size_t)n * sizeof *y);
        undistort(&lens, x, y, (size_t)n);
        Centers centers = {(size_t)n, (size_t)view[4].shape[0], view[0].buf, x, y, view[2].buf, view[3].buf,
                           view[4].buf};
        TrackRules rules = {rule[0], rule[1], rule[2], rule[3], rule[4], (size_t)rule[5], (size_t)rule[7], rule[6]};
        track = straight_tracks(&centers, &rules, &count);
        Py_END_ALLOW_THREADS
    }
    PyObject *result =
        track ? PyBytes_FromStringAndSize((const char *)track, (Py_ssize_t)(count * sizeof *track)) : PyErr_NoMemory();
    free(track);
    free(x);
    free(y);
    return result;
}

static PyObject *tracks(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Description description[] = {{"column", "d", 1}, {"row", "d", 1},  {"sigma", "d", 1},
                                              {"piece", "lq", 1}, {"laser", "lq", 1}, {"lens", "d", 1},
                                              {"rules", "d", 1}};
    PyObject *o[7], *result = NULL;
    Py_buffer view[7];
    if (!PyArg_ParseTuple(arguments, "OOOOOOO", &o[0], &o[1], &o[2], &o[3], &o[4], &o[5], &o[6])) return NULL;
    if (!open_arrays(o, view, description, 7)) return NULL;
    result = tracks_of(view);
    for (int i = 0; i < 7; i++) PyBuffer_Release(&view[i]);
    return result;
}

static PyObject *arcs_of(const Py_buffer view[5], double circle_sigma) {
    int count = (int)view[0].shape[0];
    if (view[0].shape[0] > MOST_ENDS || view[0].shape[1] != 2 || view[1].shape[0] != count ||
        view[2].shape[0] != count || view[3].shape[0] != count || view[3].shape[1] != 4 || view[4].shape[0] != LENS) {
        PyErr_SetString(PyExc_ValueError, "arcs: arrays do not fit together");
        return NULL;
    }
    End end[MOST_ENDS];
    double result[MOST_ENDS + 3];
    const double *along = view[2].buf;
    for (int k = 0; k < count; k++) end[k] = (End){.arc = ((const int32_t *)view[1].buf)[k] != 0, .used = 1};
    Lens lens = lens_of(&view[4]);
    flatten_ends(view[0].buf, view[3].buf, &lens, end, count);
    for (int k = 0; k < count; k++) {
        double metres = end[k].sigma;
        end[k].along_sigma = along[k] * metres;
        end[k].sigma = hypot(end[k].along_sigma, circle_sigma * metres);
    }
    arc_costs(end, count, result);
    return PyBytes_FromStringAndSize((const char *)result, (Py_ssize_t)((size_t)(count + 3) * sizeof *result));
}

static PyObject *arcs(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Description description[] = {
        {"position", "d", 2}, {"arc", "i", 1}, {"along", "d", 1}, {"planes", "d", 2}, {"lens", "d", 1}};
    PyObject *o[5], *result = NULL;
    Py_buffer view[5];
    double circle_sigma;
    if (!PyArg_ParseTuple(arguments, "OOOOOd", &o[0], &o[1], &o[2], &o[3], &o[4], &circle_sigma)) return NULL;
    if (!open_arrays(o, view, description, 5)) return NULL;
    result = arcs_of(view, circle_sigma);
    for (int i = 0; i < 5; i++) PyBuffer_Release(&view[i]);
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
    {"groups", groups, METH_VARARGS, "Best groups of one, two and three tracks."},
    {"arcs", arcs, METH_VARARGS, "How well points fit two arcs about one centre."},
    {"ends", ends, METH_VARARGS, "Ends of stripes."},
    {"tracks", tracks, METH_VARARGS, "Straight tracks among stripe centres."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_ring", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__ring(void) { return PyModule_Create(&module); }
