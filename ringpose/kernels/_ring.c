/* The Python side of the kernels that look for the ring; arguments are checked here. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "arcs.h"
#include "buffers.h"
#include "ends.h"
#include "marks.h"
#include "tracks.h"

#define NUMBERS(type) ((Py_ssize_t)(sizeof(type) / sizeof(double)))

/* Whether all centres are finite, their pieces ascend from 0, and every piece has a laser. */
static int centers_in_order(const Py_buffer view[4]) {
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
enum { RULES = 8, LEAST_COLUMNS = 4 };

static int track_rules_fit(const double *rule) {
    for (int i = 0; i < RULES; i++)
        if (!isfinite(rule[i])) return 0;
    return rule[5] >= LEAST_COLUMNS && rule[6] >= 1 && rule[6] < 1e6 && rule[7] >= 0;
}

static PyObject *tracks_of(const Py_buffer view[4], const Lens *lens, const double *rule) {
    Py_ssize_t n = view[0].shape[0];
    const double(*at)[2] = view[0].buf;
    if (view[0].shape[1] != 2 || view[1].shape[0] != n || view[2].shape[0] != n || n > INT32_MAX ||
        !track_rules_fit(rule)) {
        PyErr_SetString(PyExc_ValueError, "tracks: arrays do not fit together, or a rule is out of range");
        return NULL;
    }
    if (!centers_in_order(view)) return NULL;
    double *column = malloc((size_t)(n ? 3 * n : 1) * sizeof *column);
    Track *track = NULL;
    size_t count = 0;
    if (column) {
        Py_BEGIN_ALLOW_THREADS
        double *x = column + n, *y = x + n;
        for (Py_ssize_t i = 0; i < n; i++) {
            column[i] = x[i] = at[i][0];
            y[i] = at[i][1];
        }
        undistort(lens, x, y, (size_t)n);
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
    static const Description description[] = {
        {"position", "d", 2}, {"sigma", "d", 1}, {"piece", "lq", 1}, {"laser", "lq", 1}};
    PyObject *o[4], *lens_object, *rules_object, *result = NULL;
    Py_buffer view[4];
    Lens lens;
    double rule[RULES];
    if (!PyArg_ParseTuple(arguments, "OOOOOO", &o[0], &o[1], &o[2], &o[3], &lens_object, &rules_object) ||
        !read_numbers(lens_object, "lens", (double *)&lens, NUMBERS(Lens)) ||
        !read_numbers(rules_object, "rules", rule, RULES) || !open_arrays(o, view, description, 4))
        return NULL;
    result = tracks_of(view, &lens, rule);
    close_arrays(view, 4);
    return result;
}

/* Where ends were seen, as points on their arcs; `number` tells which they are. Returns how many. */
typedef struct {
    double place[MOST_ENDS][2], light[MOST_ENDS][4];
    End end[MOST_ENDS];
    int number[MOST_ENDS], arc[2];
} SeenEnds;

static int find_seen(const Py_buffer view[3], SeenEnds *seen) {
    const double(*position)[2] = view[0].buf, (*covariance)[4] = view[1].buf, (*plane)[4] = view[2].buf;
    int count = 0, all = 2 * (int)view[0].shape[0];
    seen->arc[0] = seen->arc[1] = 0;
    for (int k = 0; k < all; k++) {
        if (isnan(position[k][0])) continue;
        memcpy(seen->place[count], position[k], sizeof position[k]);
        memcpy(seen->light[count], plane[k / 2], sizeof plane[0]);
        seen->end[count] = (End){.arc = k % 2, .used = 1, .along_sigma = sqrt(covariance[k][0])};
        seen->number[count++] = k;
        seen->arc[k % 2]++;
    }
    return count;
}

static PyObject *arcs_of(const Py_buffer view[3], const Lens *lens, double circle_sigma, int exact) {
    Py_ssize_t lasers = view[0].shape[0];
    if (lasers > MOST_ENDS / 2 || view[0].shape[1] != 2 || view[0].shape[2] != 2 || view[1].shape[0] != lasers ||
        view[1].shape[1] != 2 || view[1].shape[2] != 2 || view[1].shape[3] != 2 || view[2].shape[0] != lasers ||
        view[2].shape[1] != 4) {
        PyErr_SetString(PyExc_ValueError, "arcs: arrays do not fit together");
        return NULL;
    }
    SeenEnds seen;
    double cost[MOST_ENDS + 3], without[MOST_ENDS];
    int count = find_seen(view, &seen);
    flatten_ends(seen.place[0], seen.light[0], lens, seen.end, count);
    for (int i = 0; i < count; i++) {
        double metres = seen.end[i].sigma, *along = &seen.end[i].along_sigma;
        *along = metres * (count <= exact ? hypot(*along, circle_sigma) : *along);
        seen.end[i].sigma = hypot(*along, circle_sigma * metres);
    }
    arc_costs(seen.end, count, cost);
    for (Py_ssize_t k = 0; k < 2 * lasers; k++) without[k] = INFINITY;
    for (int i = 0; i < count; i++) without[seen.number[i]] = cost[i + 1];
    PyObject *list = PyTuple_New(2 * lasers);
    for (Py_ssize_t k = 0; list && k < 2 * lasers; k++) PyTuple_SetItem(list, k, PyFloat_FromDouble(without[k]));
    return list ? Py_BuildValue("((ii)dNdd)", seen.arc[0], seen.arc[1], cost[0], list, cost[count + 1], cost[count + 2])
                : NULL;
}

static PyObject *arcs(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Description description[] = {{"position", "d", 3}, {"covariance", "d", 4}, {"planes", "d", 2}};
    PyObject *o[3], *lens_object, *result = NULL;
    Py_buffer view[3];
    Lens lens;
    double circle_sigma;
    int exact;
    if (!PyArg_ParseTuple(arguments, "OOOOdi", &o[0], &o[1], &o[2], &lens_object, &circle_sigma, &exact) ||
        !read_numbers(lens_object, "lens", (double *)&lens, NUMBERS(Lens)) || !open_arrays(o, view, description, 3))
        return NULL;
    result = arcs_of(view, &lens, circle_sigma, exact);
    close_arrays(view, 3);
    return result;
}

static PyObject *ends_of(const Py_buffer *lit, const Py_buffer *dark, const Py_buffer *line, const Lens *lens,
                         const EndRules *rules) {
    if (line->shape[1] != NUMBERS(StripeLine) || lit->shape[0] < 1 || lit->shape[1] < 1 ||
        (dark && (dark->shape[0] != lit->shape[0] || dark->shape[1] != lit->shape[1]))) {
        PyErr_SetString(PyExc_ValueError, "ends: arrays do not fit together");
        return NULL;
    }
    Images images = {lit->buf, dark ? dark->buf : NULL, lit->shape[0], lit->shape[1], lit->itemsize == 2};
    size_t lines = (size_t)line->shape[0];
    StripeEnd *end = malloc((lines ? lines : 1) * 2 * sizeof *end);
    int done = 0;
    if (end) {
        Py_BEGIN_ALLOW_THREADS
        done = stripe_ends(&images, line->buf, lines, lens, rules, end);
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
    PyObject *lit, *dark, *lines, *lens_object, *rules_object, *result = NULL;
    Py_buffer lit_view, dark_view, line_view;
    Lens lens;
    EndRules rules;
    if (!PyArg_ParseTuple(arguments, "OOOOO", &lit, &dark, &lines, &lens_object, &rules_object) ||
        !read_numbers(lens_object, "lens", (double *)&lens, NUMBERS(Lens)) ||
        !read_numbers(rules_object, "rules", (double *)&rules, NUMBERS(EndRules)) ||
        !open_image(lit, &lit_view, "lit"))
        return NULL;
    int with_dark = dark != Py_None;
    if (!with_dark || open_image(dark, &dark_view, "dark")) {
        if (with_dark && dark_view.itemsize != lit_view.itemsize)
            PyErr_SetString(PyExc_TypeError, "dark: must be of the same type as lit");
        else if (open_array(lines, &line_view, "lines", "d", sizeof(double), 2, 0)) {
            result = ends_of(&lit_view, with_dark ? &dark_view : NULL, &line_view, &lens, &rules);
            PyBuffer_Release(&line_view);
        }
        if (with_dark) PyBuffer_Release(&dark_view);
    }
    PyBuffer_Release(&lit_view);
    return result;
}

/* Whether tracks and ends belong together, and what shall be filled is as large as there are lasers. */
static int marks_fit(const Py_buffer view[7]) {
    Py_ssize_t tracks = view[0].shape[0], lasers = view[2].shape[0];
    int fit = view[0].shape[1] == NUMBERS(Track) && view[1].shape[0] == tracks && view[1].shape[1] == 2 &&
              view[1].shape[2] == NUMBERS(StripeEnd) && view[2].shape[2] == 2 && view[3].shape[2] == 2 &&
              view[3].shape[3] == 2 && view[5].shape[2] == 2;
    for (int i = 2; i < 7; i++) fit = fit && view[i].shape[0] == lasers && view[i].shape[1] == 2;
    if (!fit) PyErr_SetString(PyExc_ValueError, "marks: arrays do not fit together");
    return fit;
}

static PyObject *marks_of(const Py_buffer view[7], PyObject *lasers, const MarkRules *rules) {
    Marks marks = {view[2].shape[0], view[2].buf, view[3].buf, view[4].buf, view[5].buf, view[6].buf};
    if (!marks_fit(view)) return NULL;
    if (!PyTuple_Check(lasers) || PyTuple_Size(lasers) != view[0].shape[0]) {
        PyErr_SetString(PyExc_ValueError, "lasers: must be a tuple, one for each track");
        return NULL;
    }
    clear_marks(&marks);
    for (Py_ssize_t i = 0; i < view[0].shape[0]; i++) {
        long laser = PyLong_AsLong(PyTuple_GetItem(lasers, i));
        if (laser < 0 || laser >= marks.lasers) {
            if (!PyErr_Occurred()) PyErr_Format(PyExc_ValueError, "lasers: number %zd is not of the rig", i);
            return NULL;
        }
        mark_ends((const Track *)view[0].buf + i, (const StripeEnd *)view[1].buf + 2 * i, laser, rules, &marks);
    }
    Py_RETURN_NONE;
}

static PyObject *marks(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Description description[] = {{"tracks", "d", 2},    {"ends", "d", 3},   {">position", "d", 3},
                                              {">covariance", "d", 4}, {">flags", "lq", 2}, {">straight", "d", 3},
                                              {">sigma", "d", 2}};
    PyObject *o[7], *lasers, *rules_object, *result = NULL;
    Py_buffer view[7];
    MarkRules rules;
    if (!PyArg_ParseTuple(arguments, "OOOOOOOOO", &o[0], &o[1], &lasers, &rules_object, &o[2], &o[3], &o[4], &o[5],
                          &o[6]) ||
        !read_numbers(rules_object, "rules", (double *)&rules, NUMBERS(MarkRules)) ||
        !open_arrays(o, view, description, 7))
        return NULL;
    result = marks_of(view, lasers, &rules);
    close_arrays(view, 7);
    return result;
}

static PyMethodDef methods[] = {
    {"arcs", arcs, METH_VARARGS, "How well points fit two arcs about one centre."},
    {"ends", ends, METH_VARARGS, "Ends of stripes."},
    {"marks", marks, METH_VARARGS, "Covariances and flags of ends."},
    {"tracks", tracks, METH_VARARGS, "Straight tracks among stripe centres."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_ring", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__ring(void) { return PyModule_Create(&module); }
