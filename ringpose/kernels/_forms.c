/* The Python side of what solves for the ring; arguments are checked here. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "buffers.h"
#include "forms.h"
#include "misfit.h"
#include "ring_rows.h"

/* Whether points, of as many axes as that, and edges go together; a Python exception if not. */
static int are_points(const Py_buffer *points, const Py_buffer *edges) {
    Py_ssize_t count = points->shape[points->ndim - 2];
    const long long *edge = edges->buf;
    if (points->shape[points->ndim - 1] != 3 || edges->shape[0] != count || count < 1 || count > MOST_POINTS) {
        PyErr_Format(PyExc_ValueError, "points: must be of 1 to %d points with as many edges", MOST_POINTS);
        return 0;
    }
    for (Py_ssize_t i = 0; i < count; i++)
        if (edge[i] != 0 && edge[i] != 1) {
            PyErr_Format(PyExc_ValueError, "edges: number %zd is neither 0 nor 1", i);
            return 0;
        }
    return 1;
}

static PyObject *solve(const Py_buffer view[2], int constrained, double singular_below) {
    if (!are_points(&view[0], &view[1])) return NULL;
    Py_ssize_t batch = view[0].shape[0], count = view[0].shape[1];
    PyObject *result = PyBytes_FromStringAndSize(NULL, batch * FORM_NUMBERS * (Py_ssize_t)sizeof(double));
    if (!result) return NULL;
    double *form = (double *)PyBytes_AsString(result);
    const double(*points)[3] = view[0].buf;
    Problem problem = {(int)count, view[1].buf, singular_below, 0};
    for (Py_ssize_t i = 0; i < batch; i++)
        (constrained ? constrained_form : paper_form)(&problem, points + i * count, form + i * FORM_NUMBERS);
    return result;
}

static PyObject *differentiate(const Py_buffer view[2], int constrained, double singular_below, double step) {
    if (!are_points(&view[0], &view[1])) return NULL;
    Py_ssize_t count = view[0].shape[0], numbers = FORM_NUMBERS + SOLUTION_NUMBERS * 3 * count;
    PyObject *result = PyBytes_FromStringAndSize(NULL, numbers * (Py_ssize_t)sizeof(double));
    if (!result) return NULL;
    double *form = (double *)PyBytes_AsString(result);
    Problem problem = {(int)count, view[1].buf, singular_below, 0};
    form_derivatives(constrained ? constrained_form : paper_form, &problem, view[0].buf, step, form,
                     form + FORM_NUMBERS);
    return result;
}

static PyObject *forms(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Description description[2] = {{"points", "d", 3}, {"edges", "ql", 1}};
    PyObject *o[2];
    int constrained;
    double singular_below;
    Py_buffer view[2];
    if (!PyArg_ParseTuple(arguments, "OOpd", &o[0], &o[1], &constrained, &singular_below)) return NULL;
    if (!open_arrays(o, view, description, 2)) return NULL;
    PyObject *result = solve(view, constrained, singular_below);
    close_arrays(view, 2);
    return result;
}

static PyObject *plane(PyObject *module, PyObject *points) {
    (void)module;
    Py_buffer view;
    if (!open_array(points, &view, "points", "d", 8, 2, 0)) return NULL;
    double found[PLANE_NUMBERS];
    int fits = view.shape[1] == 3 && view.shape[0] > 0 && view.shape[0] <= MOST_POINTS;
    if (fits) nearest_plane(view.buf, (int)view.shape[0], found);
    PyBuffer_Release(&view);
    if (fits) return PyBytes_FromStringAndSize((const char *)found, sizeof found);
    return PyErr_Format(PyExc_ValueError, "points: must be 1 to %d of three numbers", MOST_POINTS);
}

static PyObject *derivatives(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Description description[2] = {{"points", "d", 2}, {"edges", "ql", 1}};
    PyObject *o[2];
    int constrained;
    double singular_below, step;
    Py_buffer view[2];
    if (!PyArg_ParseTuple(arguments, "OOpdd", &o[0], &o[1], &constrained, &singular_below, &step)) return NULL;
    if (!open_arrays(o, view, description, 2)) return NULL;
    PyObject *result = differentiate(view, constrained, singular_below, step);
    close_arrays(view, 2);
    return result;
}

/* OpenCV's matrix and coefficients as one lens; 0 and a Python exception if they are none. */
static int read_lens(const Py_buffer *matrix, const Py_buffer *coefficients, Lens *lens) {
    const double *m = matrix->buf, *c = coefficients->buf;
    double all[8] = {0};
    if (matrix->shape[0] != 3 || matrix->shape[1] != 3 || coefficients->shape[0] > 8) {
        PyErr_SetString(PyExc_ValueError, "lens: must be a matrix of 3 by 3 and at most 8 coefficients");
        return 0;
    }
    memcpy(all, c, (size_t)coefficients->shape[0] * sizeof(double));
    *lens = (Lens){m[0], m[4], m[2], m[5], all[0], all[1], all[2], all[3], all[4], all[5], all[6], all[7]};
    return 1;
}

static PyObject *misfit_of(const Py_buffer view[9], double offset_m) {
    Py_ssize_t count = view[0].shape[0];
    Lens lens;
    if (!are_points(&view[0], &view[1]) || !read_lens(&view[7], &view[8], &lens)) return NULL;
    if (view[2].shape[0] != count || view[2].shape[1] != 3 || view[3].shape[0] != count || view[3].shape[1] != 2 ||
        view[4].shape[0] != 3 || view[5].shape[0] != 3 || view[6].shape[0] != 2) {
        PyErr_SetString(PyExc_ValueError, "misfit: points, normals and the solution do not fit together");
        return NULL;
    }
    Sights sights = {(int)count, view[0].buf, view[1].buf, view[2].buf, view[3].buf};
    Solution solution = {view[4].buf, view[5].buf, view[6].buf, offset_m};
    return PyFloat_FromDouble(misfit_px(&sights, &solution, &lens));
}

static PyObject *misfit(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Description description[9] = {
        {"points", "d", 2}, {"edges", "ql", 1},  {"normals", "d", 2}, {"positions", "d", 2},   {"normal", "d", 1},
        {"center", "d", 1}, {"radii", "d", 1}, {"matrix", "d", 2},  {"coefficients", "d", 1},
    };
    PyObject *o[9];
    double offset_m;
    Py_buffer view[9];
    if (!PyArg_ParseTuple(arguments, "OOOOOOOOOd", &o[0], &o[1], &o[2], &o[3], &o[4], &o[5], &o[6], &o[7], &o[8],
                          &offset_m))
        return NULL;
    if (!open_arrays(o, view, description, 9)) return NULL;
    PyObject *result = misfit_of(view, offset_m);
    close_arrays(view, 9);
    return result;
}

static PyObject *spread_of(const Py_buffer view[5]) {
    Py_ssize_t count = view[0].shape[0], bytes = 9 * count * count * (Py_ssize_t)sizeof(double);
    Lens lens;
    if (!read_lens(&view[3], &view[4], &lens)) return NULL;
    if (view[0].shape[1] != 3 || view[1].shape[0] != count || view[1].shape[1] != 3 || view[2].shape[0] != count ||
        view[2].shape[1] != 2 || view[2].shape[2] != 2 || count > MOST_POINTS) {
        PyErr_SetString(PyExc_ValueError, "spread: points, normals and covariances do not fit together");
        return NULL;
    }
    PyObject *result = PyBytes_FromStringAndSize(NULL, bytes);
    if (!result) return NULL;
    double *covariance = (double *)PyBytes_AsString(result);
    memset(covariance, 0, (size_t)bytes);
    Sights sights = {(int)count, view[0].buf, NULL, view[1].buf, NULL};
    add_spread_m2(&sights, view[2].buf, &lens, covariance);
    return result;
}

static PyObject *spread(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Description description[5] = {
        {"points", "d", 2}, {"normals", "d", 2}, {"covariances", "d", 3}, {"matrix", "d", 2}, {"coefficients", "d", 1},
    };
    PyObject *o[5];
    Py_buffer view[5];
    if (!PyArg_ParseTuple(arguments, "OOOOO", &o[0], &o[1], &o[2], &o[3], &o[4])) return NULL;
    if (!open_arrays(o, view, description, 5)) return NULL;
    PyObject *result = spread_of(view);
    close_arrays(view, 5);
    return result;
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
    Py_ssize_t count = prediction_numbers((int)ends, (int)points);
    PyObject *result = PyBytes_FromStringAndSize(NULL, count * (Py_ssize_t)sizeof(double));
    if (!result) return NULL;
    lay_out((double *)PyBytes_AsString(result), (int)ends, (int)points, &laid);
    const double *s = view[0].buf;
    RingState state = {{s[0], s[1], s[2]}, {s[3], s[4], s[5]}, s[6], s[7], s[8]};
    Sighted sighted = {(int)ends, (int)points, view[1].buf, view[2].buf, view[3].buf, view[4].buf};
    predict(&state, &sighted, &laid);
    return result;
}

static PyObject *rows(PyObject *module, PyObject *arguments) {
    (void)module;
    static const Description description[5] = {
        {"state", "d", 1}, {"rays", "d", 2}, {"light", "d", 2}, {"whitening", "d", 2}, {"points", "d", 2},
    };
    PyObject *o[5];
    Py_buffer view[5];
    if (!PyArg_ParseTuple(arguments, "OOOOO", &o[0], &o[1], &o[2], &o[3], &o[4])) return NULL;
    if (!open_arrays(o, view, description, 5)) return NULL;
    PyObject *result = rows_of(view);
    close_arrays(view, 5);
    return result;
}

static PyMethodDef methods[] = {
    {"rows", rows, METH_VARARGS, "What a ring predicts of stripes and break points, with all derivatives."},
    {"forms", forms, METH_VARARGS, "The closed forms of a batch of points."},
    {"derivatives", derivatives, METH_VARARGS, "A closed form and how it moves with its points."},
    {"plane", plane, METH_O, "The plane nearest to points, and their singular values."},
    {"spread", spread, METH_VARARGS, "Covariance of points in light planes, of that of their break points."},
    {"misfit", misfit, METH_VARARGS, "How far a pose's break points lie from those that were seen."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_forms", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__forms(void) { return PyModule_Create(&module); }
