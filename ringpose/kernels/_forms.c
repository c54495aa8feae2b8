/* The Python side of what solves for the ring; arguments are checked here. Twins: reference_forms.py, and what the rows
   are made of in ringpose/pose/ring_model.py. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "buffers.h"
#include "forms.h"
#include "ring_rows.h"

static PyObject *solve(const Py_buffer view[2], int constrained, double singular_below) {
    Py_ssize_t batch = view[0].shape[0], count = view[0].shape[1];
    const long long *edge = view[1].buf;
    if (view[0].shape[2] != 3 || view[1].shape[0] != count || count < 1 || count > MOST_POINTS) {
        PyErr_Format(PyExc_ValueError, "points: must be of 1 to %d points with as many edges", MOST_POINTS);
        return NULL;
    }
    for (Py_ssize_t i = 0; i < count; i++)
        if (edge[i] != 0 && edge[i] != 1) {
            PyErr_Format(PyExc_ValueError, "edges: number %zd is neither 0 nor 1", i);
            return NULL;
        }
    PyObject *result = PyBytes_FromStringAndSize(NULL, batch * FORM_NUMBERS * (Py_ssize_t)sizeof(double));
    if (!result) return NULL;
    double *form = (double *)PyBytes_AsString(result);
    const double(*points)[3] = view[0].buf;
    Problem problem = {(int)count, edge, singular_below};
    for (Py_ssize_t i = 0; i < batch; i++)
        (constrained ? constrained_form : paper_form)(&problem, points + i * count, form + i * FORM_NUMBERS);
    return result;
}

static PyObject *forms(PyObject *module, PyObject *arguments) {
    (void)module;
    PyObject *points, *edges, *result = NULL;
    int constrained;
    double singular_below;
    Py_buffer view[2];
    if (!PyArg_ParseTuple(arguments, "OOpd", &points, &edges, &constrained, &singular_below)) return NULL;
    if (!open_array(points, &view[0], "points", "d", sizeof(double), 3, 0)) return NULL;
    if (open_array(edges, &view[1], "edges", "ql", 8, 1, 0)) {
        result = solve(view, constrained, singular_below);
        PyBuffer_Release(&view[1]);
    }
    PyBuffer_Release(&view[0]);
    return result;
}

/* Numbers of a prediction, in the order in which they are returned. */
static void lay_out(double *to, Py_ssize_t ends, Py_ssize_t points, Prediction *laid) {
    Py_ssize_t sights = ends + points, at = 0;
    Prediction parts = {.residual = to};
    at += sights;
    parts.by_state = (double(*)[STATE])(to + at), at += STATE * sights;
    parts.slope = to + at, at += sights;
    parts.steepness = to + at, at += sights;
    parts.y_by_plane = (double(*)[3])(to + at), at += 3 * sights;
    parts.ray = (double(*)[3])(to + at), at += 3 * sights;
    parts.distance = to + at, at += points;
    parts.by_ray = (double(*)[2])(to + at), at += 2 * points;
    parts.arc_by_state = (double(*)[STATE])(to + at), at += STATE * points;
    parts.by_x = to + at, at += points;
    parts.scale = to + at, at += points;
    parts.origin = to + at;
    *laid = parts;
}

static PyObject *rows_of(const Py_buffer view[5]) {
    Py_ssize_t sights = view[1].shape[0], ends = view[3].shape[0], points = view[4].shape[0];
    if (view[0].shape[0] != 9 || view[1].shape[1] != 3 || view[2].shape[0] != sights || view[2].shape[1] != 4 ||
        view[3].shape[1] != ends || view[4].shape[1] != 2 || ends % 2 || ends + points != sights || points < 1 ||
        sights > 100000) {
        PyErr_SetString(PyExc_ValueError, "rows: arrays do not fit together");
        return NULL;
    }
    Prediction laid;
    Py_ssize_t count = 16 * sights + 12 * points + ORIGIN_NUMBERS;
    PyObject *result = PyBytes_FromStringAndSize(NULL, count * (Py_ssize_t)sizeof(double));
    if (!result) return NULL;
    lay_out((double *)PyBytes_AsString(result), ends, points, &laid);
    const double *s = view[0].buf;
    RingState state = {{s[0], s[1], s[2]}, {s[3], s[4], s[5]}, s[6], s[7], s[8]};
    Sighted sighted = {(int)ends, (int)points, view[1].buf, view[2].buf, view[3].buf, view[4].buf};
    predict(&state, &sighted, &laid);
    return result;
}

static PyObject *rows(PyObject *module, PyObject *arguments) {
    (void)module;
    static const struct {
        const char *name;
        int axes;
    } description[5] = {{"state", 1}, {"rays", 2}, {"light", 2}, {"whitening", 2}, {"points", 2}};
    PyObject *o[5], *result = NULL;
    Py_buffer view[5];
    int opened = 0;
    if (!PyArg_ParseTuple(arguments, "OOOOO", &o[0], &o[1], &o[2], &o[3], &o[4])) return NULL;
    while (opened < 5 && open_array(o[opened], &view[opened], description[opened].name, "d", sizeof(double),
                                    description[opened].axes, 0))
        opened++;
    if (opened == 5) result = rows_of(view);
    while (opened > 0) PyBuffer_Release(&view[--opened]);
    return result;
}

static PyMethodDef methods[] = {
    {"rows", rows, METH_VARARGS, "What a ring predicts of stripes and break points, with all derivatives."},
    {"forms", forms, METH_VARARGS, "The closed forms of a batch of points."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_forms", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__forms(void) { return PyModule_Create(&module); }
