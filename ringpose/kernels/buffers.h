/* How the Python sides of the kernels open arrays. */
#ifndef RINGPOSE_BUFFERS_H
#define RINGPOSE_BUFFERS_H

#include <Python.h>

#include <string.h>

/* Opens a contiguous buffer of that element; a Python exception and 0 if the object has none. */
static int open_array(PyObject *object, Py_buffer *view, const char *name, const char *formats, int size, int axes,
                      int writable) {
    if (PyObject_GetBuffer(object, view, PyBUF_STRIDES | PyBUF_FORMAT) < 0) return 0;
    const char *format = view->format ? view->format : "B";
    if (*format == '@' || *format == '=') format++;
    if (view->itemsize != size || format[0] == '\0' || format[1] != '\0' || strchr(formats, format[0]) == NULL)
        PyErr_Format(PyExc_TypeError, "%s: elements are '%s' of %zd bytes, must be '%c' of %d", name, format,
                     view->itemsize, formats[0], size);
    else if (view->ndim != axes)
        PyErr_Format(PyExc_ValueError, "%s: has %d axes, must have %d", name, view->ndim, axes);
    else if (!PyBuffer_IsContiguous(view, 'C'))
        PyErr_Format(PyExc_ValueError, "%s: is not contiguous in rows", name);
    else if (writable && view->readonly)
        PyErr_Format(PyExc_ValueError, "%s: is read-only", name);
    else
        return 1;
    PyBuffer_Release(view);
    return 0;
}

/* Opens arrays one after the other; 1 if all are as described (axes, 'd' doubles, 'i' int32, 'q' int64). Those that
   shall be filled have names that begin with '>'. */
typedef struct {
    const char *name, *format;
    int axes;
} Description;

static inline void close_arrays(Py_buffer view[], int count) {
    for (int i = 0; i < count; i++) PyBuffer_Release(&view[i]);
}

static inline int open_arrays(PyObject *const object[], Py_buffer view[], const Description description[], int count) {
    for (int i = 0; i < count; i++) {
        const Description *d = &description[i];
        int size = d->format[0] == 'i' ? 4 : 8, fill = d->name[0] == '>';
        if (open_array(object[i], &view[i], d->name + fill, d->format, size, d->axes, fill)) continue;
        close_arrays(view, i);
        return 0;
    }
    return 1;
}

/* Reads a tuple of numbers; a Python exception and 0 if it is none, or not of that length. */
static inline int read_numbers(PyObject *object, const char *name, double *number, Py_ssize_t count) {
    if (!PyTuple_Check(object) || PyTuple_Size(object) != count) {
        PyErr_Format(PyExc_ValueError, "%s: must be a tuple of %zd numbers", name, count);
        return 0;
    }
    for (Py_ssize_t i = 0; i < count; i++) {
        number[i] = PyFloat_AsDouble(PyTuple_GetItem(object, i));
        if (number[i] == -1 && PyErr_Occurred()) return 0;
    }
    return 1;
}

#endif
