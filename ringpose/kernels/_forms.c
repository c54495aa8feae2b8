/* The Python side of the rows of the most likely ring; arguments are checked here. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "buffers.h"
#include "ring_rows.h"

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
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_forms", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__forms(void) { return PyModule_Create(&module); }
