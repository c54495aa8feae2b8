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

/* Opens arrays one after the other; 1 if all are as described (axes, 'd' doubles, 'i' int32, 'q' int64). */
typedef struct {
    const char *name, *format;
    int axes;
} Description;

static inline int open_arrays(PyObject *const object[], Py_buffer view[], const Description description[], int count) {
    for (int i = 0; i < count; i++) {
        const Description *d = &description[i];
        if (open_array(object[i], &view[i], d->name, d->format, d->format[0] == 'i' ? 4 : 8, d->axes, 0)) continue;
        while (i > 0) PyBuffer_Release(&view[--i]);
        return 0;
    }
    return 1;
}

#endif
