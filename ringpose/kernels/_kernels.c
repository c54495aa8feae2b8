/* The Python side of the kernels: arguments are checked here, and the GIL is released around the work.

   Every array arrives through the buffer protocol; results of unknown length leave as bytes. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <string.h>

#include "buffers.h"
#include "kernels.h"

/* Image indices are 32 bits wide. */
static int fits_32_bits(const Py_buffer *view, const char *name) {
    if (view->shape[0] > 0 && view->shape[1] > 0 && view->shape[0] <= INT32_MAX / view->shape[1]) return 1;
    PyErr_Format(PyExc_ValueError, "%s: %zd rows of %zd columns, must be 1 to 2^31 - 1 pixels", name, view->shape[0],
                 view->shape[1]);
    return 0;
}

static int within(long value, long least, long most, const char *name) {
    if (value >= least && value <= most) return 1;
    PyErr_Format(PyExc_ValueError, "%s: is %ld, must be %ld to %ld", name, value, least, most);
    return 0;
}

/* A list as bytes; releases it. */
static PyObject *one_bytes(int done, List *list) {
    PyObject *result =
        done ? PyBytes_FromStringAndSize(list->data, (Py_ssize_t)(list->used * list->item)) : PyErr_NoMemory();
    release(list);
    return result;
}

/* Two lists as two bytes objects; releases them. */
static PyObject *two_bytes(int done, List *first, List *second) {
    PyObject *one = one_bytes(done, first);
    PyObject *two = one ? one_bytes(done, second) : NULL;
    PyObject *result = two ? PyTuple_Pack(2, one, two) : NULL;
    release(second);
    Py_XDECREF(one);
    Py_XDECREF(two);
    return result;
}

static PyObject *gradient_of(const Py_buffer *image, const Py_buffer *magnitude, long upper, long bits) {
    const Image data = {image->buf, (size_t)image->shape[0], (size_t)image->shape[1], (int)bits};
    if (!fits_32_bits(image, "image") || !within(upper, 1, INT16_MAX, "upper")) return NULL;
    if (magnitude->shape[0] != image->shape[0] || magnitude->shape[1] != image->shape[1]) {
        PyErr_SetString(PyExc_ValueError, "magnitude: must have the shape of the image");
        return NULL;
    }
    Anchors anchors = {{NULL, 0, 0, sizeof(int32_t)}, {NULL, 0, 0, sizeof(uint8_t)}};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = find_gradient(&data, (int)upper, magnitude->buf, &anchors);
    Py_END_ALLOW_THREADS
    return two_bytes(done, &anchors.index, &anchors.orientation);
}

static PyObject *gradient(PyObject *module, PyObject *arguments) {
    (void)module;
    PyObject *image, *magnitude, *result = NULL;
    long upper, bits;
    Py_buffer image_view, magnitude_view;
    if (!PyArg_ParseTuple(arguments, "OllO", &image, &bits, &upper, &magnitude)) return NULL;
    if (!within(bits, 8, 16, "bits")) return NULL;
    if (!open_array(image, &image_view, "image", bits > 8 ? "H" : "B", bits > 8 ? 2 : 1, 2, 0)) return NULL;
    if (open_array(magnitude, &magnitude_view, "magnitude", "h", 2, 2, 1)) {
        result = gradient_of(&image_view, &magnitude_view, upper, bits);
        PyBuffer_Release(&magnitude_view);
    }
    PyBuffer_Release(&image_view);
    return result;
}

/* Whether every anchor is among the pixels that have a gradient. */
static int anchors_inside(const Py_buffer *magnitude, const Py_buffer *index) {
    const int32_t *anchor = index->buf;
    const int16_t *value = magnitude->buf;
    const uint32_t width = (uint32_t)magnitude->shape[1], height = (uint32_t)magnitude->shape[0];
    const uint32_t wide = width > 2 * MARGIN ? width - 2 * MARGIN : 0;
    const uint32_t high = height > 2 * MARGIN ? height - 2 * MARGIN : 0;
    for (Py_ssize_t i = 0; i < index->shape[0]; i++) {
        const uint32_t at = (uint32_t)anchor[i];
        if (at % width - MARGIN < wide && at / width - MARGIN < high && value[at] >= 0) continue;
        PyErr_Format(PyExc_ValueError, "anchors: number %zd has no gradient or a negative one", i);
        return 0;
    }
    return 1;
}

static PyObject *chains_of(const Py_buffer *magnitude, const Py_buffer *index, const Py_buffer *turn, long lower,
                           long shortest) {
    if (index->shape[0] != turn->shape[0]) {
        PyErr_SetString(PyExc_ValueError, "orientation: must have one entry for each anchor");
        return NULL;
    }
    if (!fits_32_bits(magnitude, "magnitude") || !anchors_inside(magnitude, index)) return NULL;
    if (!within(lower, 1, INT16_MAX, "lower") || !within(shortest, 1, INT32_MAX, "shortest")) return NULL;
    if (index->shape[0] == 0) return Py_BuildValue("(y#y#)", "", (Py_ssize_t)0, "\0\0\0\0", (Py_ssize_t)4);
    const EdgeArea area = {magnitude->buf, (size_t)magnitude->shape[0], (size_t)magnitude->shape[1], (int)lower};
    List pixels = {NULL, 0, 0, sizeof(Pixel)}, starts = {NULL, 0, 0, sizeof(int32_t)};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = walk_chains(&area, index->buf, turn->buf, (size_t)index->shape[0], (size_t)shortest, &pixels, &starts);
    Py_END_ALLOW_THREADS
    return two_bytes(done, &pixels, &starts);
}

static PyObject *chains(PyObject *module, PyObject *arguments) {
    (void)module;
    PyObject *magnitude, *index, *turn, *result = NULL;
    long lower, shortest;
    Py_buffer magnitude_view, index_view, turn_view;
    if (!PyArg_ParseTuple(arguments, "OOOll", &magnitude, &index, &turn, &lower, &shortest)) return NULL;
    if (!open_array(magnitude, &magnitude_view, "magnitude", "h", 2, 2, 1)) return NULL;
    if (open_array(index, &index_view, "anchors", "il", 4, 1, 0)) {
        if (open_array(turn, &turn_view, "orientation", "B", 1, 1, 0)) {
            result = chains_of(&magnitude_view, &index_view, &turn_view, lower, shortest);
            PyBuffer_Release(&turn_view);
        }
        PyBuffer_Release(&index_view);
    }
    PyBuffer_Release(&magnitude_view);
    return result;
}

static int starts_ascend(const Py_buffer *starts, Py_ssize_t pixels) {
    const int32_t *start = starts->buf;
    Py_ssize_t count = starts->shape[0];
    int ascend = count > 0 && start[0] >= 0 && start[count - 1] <= pixels && pixels <= INT32_MAX;
    for (Py_ssize_t i = 1; ascend && i < count; i++) ascend = start[i - 1] <= start[i];
    if (!ascend)
        PyErr_SetString(PyExc_ValueError, "starts: must ascend from 0 or more to at most the number of pixels");
    return ascend;
}

static int are_pairs(const Py_buffer *view, const char *name) {
    if (view->shape[1] == 2) return 1;
    PyErr_Format(PyExc_ValueError, "%s: must be pairs", name);
    return 0;
}

static PyObject *cuts_of(const Py_buffer *pixels, const Py_buffer *starts, CutRules rules) {
    if (!are_pairs(pixels, "pixels") || !starts_ascend(starts, pixels->shape[0])) return NULL;
    List pieces = {NULL, 0, 0, sizeof(Piece)};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = cut_chains(pixels->buf, starts->buf, (size_t)starts->shape[0] - 1, rules, &pieces);
    Py_END_ALLOW_THREADS
    return one_bytes(done, &pieces);
}

static PyObject *cuts(PyObject *module, PyObject *arguments) {
    (void)module;
    PyObject *pixels, *starts, *result = NULL;
    double deviation, share_change;
    long window, shortest;
    Py_buffer pixels_view, starts_view;
    if (!PyArg_ParseTuple(arguments, "OOddll", &pixels, &starts, &deviation, &share_change, &window, &shortest))
        return NULL;
    if (!within(window, 2, INT32_MAX, "window") || !within(shortest, 2, INT32_MAX, "shortest")) return NULL;
    CutRules rules = {deviation, share_change, (size_t)window, (size_t)shortest};
    if (!open_array(pixels, &pixels_view, "pixels", "il", 4, 2, 0)) return NULL;
    if (open_array(starts, &starts_view, "starts", "il", 4, 1, 0)) {
        result = cuts_of(&pixels_view, &starts_view, rules);
        PyBuffer_Release(&starts_view);
    }
    PyBuffer_Release(&pixels_view);
    return result;
}

static int pieces_inside(const Py_buffer *pieces, Py_ssize_t pixels) {
    const Piece *piece = pieces->buf;
    for (Py_ssize_t i = 0; i < pieces->shape[0]; i++) {
        if (piece[i].first >= 0 && piece[i].first <= piece[i].last && piece[i].last < pixels) continue;
        PyErr_Format(PyExc_ValueError, "pieces: number %zd is not within the pixels", i);
        return 0;
    }
    return 1;
}

static PyObject *fits_of(const Py_buffer *magnitude, const Py_buffer *pixels, const Py_buffer *pieces, long trim) {
    if (!fits_32_bits(magnitude, "magnitude") || !within(trim, 0, INT32_MAX, "trim")) return NULL;
    if (!are_pairs(pixels, "pixels") || !are_pairs(pieces, "pieces")) return NULL;
    if (!pieces_inside(pieces, pixels->shape[0])) return NULL;
    Magnitude area = {magnitude->buf, (size_t)magnitude->shape[0], (size_t)magnitude->shape[1]};
    List lines = {NULL, 0, 0, sizeof(Line)}, moments = {NULL, 0, 0, sizeof(Moments)};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = fit_pieces(&area, pixels->buf, pieces->buf, (size_t)pieces->shape[0], (size_t)trim, &lines, &moments);
    Py_END_ALLOW_THREADS
    return two_bytes(done, &lines, &moments);
}

static PyObject *fits(PyObject *module, PyObject *arguments) {
    (void)module;
    PyObject *magnitude, *pixels, *pieces, *result = NULL;
    long trim;
    Py_buffer magnitude_view, pixels_view, pieces_view;
    if (!PyArg_ParseTuple(arguments, "OOOl", &magnitude, &pixels, &pieces, &trim)) return NULL;
    if (!open_array(magnitude, &magnitude_view, "magnitude", "h", 2, 2, 0)) return NULL;
    if (open_array(pixels, &pixels_view, "pixels", "il", 4, 2, 0)) {
        if (open_array(pieces, &pieces_view, "pieces", "il", 4, 2, 0)) {
            result = fits_of(&magnitude_view, &pixels_view, &pieces_view, trim);
            PyBuffer_Release(&pieces_view);
        }
        PyBuffer_Release(&pixels_view);
    }
    PyBuffer_Release(&magnitude_view);
    return result;
}

static PyObject *joins_of(const Py_buffer *lines, const Py_buffer *moments, const Py_buffer *pieces, JoinRules rules) {
    const Py_ssize_t count = lines->shape[0];
    if (moments->shape[0] != count || pieces->shape[0] != count || lines->shape[1] != 4 || moments->shape[1] != 6) {
        PyErr_SetString(PyExc_ValueError, "lines, moments, pieces: must have 4, 6 and 2 columns and equal lengths");
        return NULL;
    }
    if (!are_pairs(pieces, "pieces")) return NULL;
    List joined = {NULL, 0, 0, sizeof(Line)}, support = {NULL, 0, 0, sizeof(int64_t)};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = join_lines(lines->buf, moments->buf, pieces->buf, (size_t)count, rules, &joined, &support);
    Py_END_ALLOW_THREADS
    return two_bytes(done, &joined, &support);
}

static PyObject *joins(PyObject *module, PyObject *arguments) {
    (void)module;
    PyObject *lines, *moments, *pieces, *result = NULL;
    double gap, aside;
    long shortest;
    Py_buffer lines_view, moments_view, pieces_view;
    if (!PyArg_ParseTuple(arguments, "OOOddl", &lines, &moments, &pieces, &gap, &aside, &shortest)) return NULL;
    if (!(gap >= 0 && gap < 1e6 && aside > 0 && aside < 1e6)) {
        PyErr_SetString(PyExc_ValueError, "gap, aside: must be 0 to 1e6, and aside more than 0");
        return NULL;
    }
    const JoinRules rules = {gap, aside, shortest};
    if (!open_array(lines, &lines_view, "lines", "d", 8, 2, 0)) return NULL;
    if (open_array(moments, &moments_view, "moments", "d", 8, 2, 0)) {
        if (open_array(pieces, &pieces_view, "pieces", "il", 4, 2, 0)) {
            result = joins_of(&lines_view, &moments_view, &pieces_view, rules);
            PyBuffer_Release(&pieces_view);
        }
        PyBuffer_Release(&moments_view);
    }
    PyBuffer_Release(&lines_view);
    return result;
}

static PyMethodDef methods[] = {
    {"gradient", gradient, METH_VARARGS, "gradient(image, bits, upper, magnitude) -> (anchors, orientation)"},
    {"chains", chains, METH_VARARGS,
     "chains(magnitude, anchors, orientation, lower, shortest) -> (pixels, starts)"},
    {"cuts", cuts, METH_VARARGS, "cuts(pixels, starts, deviation, share_change, window, shortest) -> pieces"},
    {"fits", fits, METH_VARARGS, "fits(magnitude, pixels, pieces, trim) -> (lines, moments)"},
    {"joins", joins, METH_VARARGS, "joins(lines, moments, pieces, gap, aside, shortest) -> (lines, support)"},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_kernels", NULL, 0, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__kernels(void) { return PyModule_Create(&definition); }
