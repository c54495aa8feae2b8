/* The Python side of the closed forms; arguments are checked here. Twin: reference_forms.py. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "buffers.h"
#include "forms.h"

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

static PyMethodDef methods[] = {
    {"forms", forms, METH_VARARGS, "The closed forms of a batch of points."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_forms", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__forms(void) { return PyModule_Create(&module); }
