/* Validation of the kernels' arguments against a table. */
#include "arguments.h"

#include <string.h>

/* Formats of the buffer protocol that an element may have, and its size. */
static const char *formats_of(char type, int *size) {
    static const struct {
        char type;
        const char *formats;
        int size;
    } element[] = {{'d', "d", 8}, {'f', "f", 4}, {'q', "ql", 8}, {'i', "il", 4},
                   {'h', "h", 2}, {'B', "B", 1}, {'?', "?", 1},  {'H', "H", 2}};
    size_t i = 0;
    while (element[i].type != type) i++;
    *size = element[i].size;
    return element[i].formats;
}

static int has_elements(const Py_buffer *view, const Parameter *parameter, const char *name) {
    int size;
    const char type = parameter->type != 'I' ? parameter->type : view->itemsize == 2 ? 'H' : 'B';
    const char *format = view->format ? view->format : "B", *formats = formats_of(type, &size);
    if (*format == '@' || *format == '=') format++;
    if (view->itemsize == size && format[0] && !format[1] && strchr(formats, format[0])) return 1;
    PyErr_Format(PyExc_TypeError, "%s: elements are '%s' of %zd bytes, must be '%c' of %d", name, format,
                 view->itemsize, formats[0], size);
    return 0;
}

/* `named`: values of the named extents N, M and K, -1 until an argument determines them. */
static int has_extents(const Py_buffer *view, const Parameter *parameter, const char *name, Py_ssize_t named[3]) {
    int axes = 0;
    while (axes < MAX_AXES && parameter->extent[axes]) axes++;
    if (view->ndim != axes) {
        PyErr_Format(PyExc_ValueError, "%s: has %d axes, must have %d", name, view->ndim, axes);
        return 0;
    }
    for (int i = 0; i < axes; i++) {
        const int extent = parameter->extent[i];
        Py_ssize_t *known = extent < ANY ? &named[N - extent] : NULL, must = extent;
        if (known && *known < 0) *known = view->shape[i];
        if (known) must = *known;
        if (extent == ANY || view->shape[i] == must) continue;
        PyErr_Format(PyExc_ValueError, "%s: has extent %zd along axis %d, must have %zd", name, view->shape[i], i, must);
        return 0;
    }
    return 1;
}

/* Indices of pixels are 32 bits wide. */
static int has_pixels(const Py_buffer *view, const char *name) {
    const Py_ssize_t rows = view->shape[0], columns = view->shape[1];
    if (rows > 0 && columns > 0 && rows <= INT32_MAX / columns) return 1;
    PyErr_Format(PyExc_ValueError, "%s: %zd rows of %zd columns, must be 1 to 2^31 - 1 pixels", name, rows, columns);
    return 0;
}

static int open_array(PyObject *object, const Parameter *parameter, const char *name, Py_ssize_t named[3],
                      Py_buffer *view) {
    const int fill = parameter->name[0] == '>', image = parameter->type == 'I' || parameter->type == 'h';
    if (PyObject_GetBuffer(object, view, PyBUF_STRIDES | PyBUF_FORMAT) < 0) return 0;
    if (has_elements(view, parameter, name) && has_extents(view, parameter, name, named) &&
        (!image || has_pixels(view, name))) {
        if (PyBuffer_IsContiguous(view, 'C') && !(fill && view->readonly)) return 1;
        PyErr_Format(PyExc_ValueError, "%s: must be contiguous in rows%s", name, fill ? " and writable" : "");
    }
    PyBuffer_Release(view);
    return 0;
}

static int is_tuple(PyObject *object, const Parameter *parameter) {
    if (PyTuple_Check(object)) return 1;
    PyErr_Format(PyExc_TypeError, "%s: must be a tuple", parameter->name);
    return 0;
}

static int read_tuple(PyObject *object, const Parameter *parameter, double *number) {
    const int count = parameter->extent[0];
    if (!PyTuple_Check(object) || PyTuple_Size(object) != count) {
        PyErr_Format(PyExc_ValueError, "%s: must be a tuple of %d numbers", parameter->name, count);
        return 0;
    }
    for (int i = 0; i < count; i++) {
        number[i] = PyFloat_AsDouble(PyTuple_GetItem(object, i));
        if (number[i] == -1 && PyErr_Occurred()) return 0;
    }
    return 1;
}

static int read_integer(PyObject *object, const Parameter *parameter, double *number) {
    const long value = PyLong_AsLong(object), minimum = parameter->extent[0], maximum = parameter->extent[1];
    if (value == -1 && PyErr_Occurred()) return 0;
    *number = (double)value;
    if (value >= minimum && value <= maximum) return 1;
    PyErr_Format(PyExc_ValueError, "%s: is %ld, must be %ld to %ld", parameter->name, value, minimum, maximum);
    return 0;
}

static int read_real(PyObject *object, double *number) {
    *number = PyFloat_AsDouble(object);
    return !(*number == -1 && PyErr_Occurred());
}

int open_arguments(PyObject *tuple, const Parameter *parameter, size_t count, Arguments *arguments) {
    Py_ssize_t named[3] = {-1, -1, -1};
    arguments->count = 0;
    if (!PyTuple_Check(tuple) || PyTuple_Size(tuple) != (Py_ssize_t)count) {
        PyErr_Format(PyExc_TypeError, "takes %zu arguments", count);
        return 0;
    }
    for (size_t i = 0; i < count; i++) {
        PyObject *object = PyTuple_GetItem(tuple, (Py_ssize_t)i);
        const char *name = parameter[i].name + strspn(parameter[i].name, ">?");
        double *number = arguments->number[i];
        int fits = 1;
        arguments->view[i].obj = NULL;
        switch (parameter[i].type) {
        case 'T': fits = read_tuple(object, &parameter[i], number); break;
        case 'L': fits = read_integer(object, &parameter[i], number); break;
        case 'R': fits = read_real(object, number); break;
        case 'O': fits = is_tuple(object, &parameter[i]); break;
        default:
            if (object != Py_None || !memchr(parameter[i].name, '?', 2))
                fits = open_array(object, &parameter[i], name, named, &arguments->view[i]);
        }
        if (!fits) {
            close_arguments(arguments, NULL);
            return 0;
        }
        arguments->count++;
    }
    return 1;
}

PyObject *close_arguments(Arguments *arguments, PyObject *result) {
    for (int i = 0; i < arguments->count; i++)
        if (arguments->view[i].obj) PyBuffer_Release(&arguments->view[i]);
    return result;
}

int require(int condition, const char *message) {
    if (!condition) PyErr_SetString(PyExc_ValueError, message);
    return condition;
}

PyObject *list_bytes(int done, List *list) {
    PyObject *result =
        done ? PyBytes_FromStringAndSize(list->data, (Py_ssize_t)(list->used * list->item)) : PyErr_NoMemory();
    release(list);
    return result;
}
