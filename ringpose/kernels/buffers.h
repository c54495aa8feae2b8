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

#endif
