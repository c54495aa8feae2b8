/* The Python side of the kernels that look for the ring; arguments are checked here. Twin: reference_ring.py. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
#include <stdlib.h>

#include "buffers.h"
#include "ring.h"

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

enum { PARAMETERS = 14 };

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
                    parameter[13]}};
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

static PyObject *groups(PyObject *module, PyObject *arguments) {
    (void)module;
    static const char *const names[] = {"track", "laser", "ends", "merit", "planes", "parameters"};
    static const char *const formats[] = {"i", "i", "d", "d", "d", "d"};
    static const int axes[] = {1, 1, 2, 1, 2, 1};
    PyObject *object[6], *result = NULL;
    Py_buffer view[6];
    if (!PyArg_ParseTuple(arguments, "OOOOOO", &object[0], &object[1], &object[2], &object[3], &object[4], &object[5]))
        return NULL;
    int opened = 0;
    while (opened < 6 && open_array(object[opened], &view[opened], names[opened], formats[opened],
                                    formats[opened][0] == 'i' ? 4 : 8, axes[opened], 0))
        opened++;
    if (opened == 6) result = groups_of(view);
    while (opened > 0) PyBuffer_Release(&view[--opened]);
    return result;
}

static PyMethodDef methods[] = {
    {"groups", groups, METH_VARARGS, "Best groups of one, two and three tracks."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_ring", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__ring(void) { return PyModule_Create(&module); }
