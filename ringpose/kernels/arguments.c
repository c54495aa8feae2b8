/* Validation of the kernels' arguments against a table. */
#include "arguments.h"

#include <stdio.h>
#include <string.h>

const Kind ELEMENT[] = {[FLOAT64_] = {.type = 'd'}, [FLOAT32_] = {.type = 'f'}, [INT64_] = {.type = 'q'},
                        [INT32_] = {.type = 'i'},   [INT16_] = {.type = 'h'},   [UINT8_] = {.type = 'B'},
                        [BOOL_] = {.type = '?'},    [IMAGE_] = {.type = 'I'},   [REAL_] = {.type = 'R'},
                        [WHOLE_] = {.type = 'W'},   [TUPLE_] = {.type = 'T'}};

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

/* `before`: size of the elements of the image before, which a name with '=' requires. */
static int has_elements(const Py_buffer *view, const Parameter *parameter, const char *name, Py_ssize_t before) {
    int size;
    const char own = parameter->kind->type;
    const Py_ssize_t of_image = strchr(parameter->name, '=') ? before : view->itemsize;
    const char type = own != 'I' ? own : of_image == 2 ? 'H' : 'B';
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

/* Opens argument number `at`, whose name without signs is given. */
static int open_array(PyObject *object, const Parameter *parameter, const char *name, Py_ssize_t named[3], int at,
                      Arguments *arguments) {
    const char type = parameter->kind->type;
    const int fill = parameter->name[0] == '>', image = type == 'I' || type == 'h';
    Py_buffer *view = &arguments->view[at];
    if (PyObject_GetBuffer(object, view, PyBUF_STRIDES | PyBUF_FORMAT) < 0) return 0;
    if (has_elements(view, parameter, name, at ? view[-1].itemsize : 0) &&
        has_extents(view, parameter, name, named) && (!image || has_pixels(view, name))) {
        if (PyBuffer_IsContiguous(view, 'C') && !(fill && view->readonly)) return 1;
        PyErr_Format(PyExc_ValueError, "%s: must be contiguous in rows%s", name, fill ? " and writable" : "");
    }
    PyBuffer_Release(view);
    return 0;
}

static int is_within(const char *record, const char *name, double value, double lowest, double highest) {
    char text[160];
    if (value >= lowest && value <= highest) return 1;
    snprintf(text, sizeof text, "is %.9g, must be %.9g to %.9g", value, lowest, highest);
    PyErr_Format(PyExc_ValueError, "%s%s%s: %s", record, *record ? "." : "", name, text);
    return 0;
}

static int read_real(PyObject *object, Number *number) {
    number->real = PyFloat_AsDouble(object);
    return !(number->real == -1 && PyErr_Occurred());
}

static int read_whole(PyObject *object, Number *number) {
    number->whole = PyLong_AsLongLong(object);
    return !(number->whole == -1 && PyErr_Occurred());
}

/* The attributes of a data class, each to the member of its name. */
static int read_record(PyObject *object, const Parameter *parameter, Number *number) {
    const Kind *record = parameter->kind;
    for (int i = 0; i < record->count; i++, number++) {
        const Field *field = &record->field[i];
        PyObject *value = PyObject_GetAttr(object, record->key[i]);
        const int is_number = value && (field->is_count ? read_whole(value, number) : read_real(value, number));
        Py_XDECREF(value);
        if (!value) PyErr_Clear();
        if (!is_number) {
            PyErr_Format(PyExc_TypeError, "%s: %s of a %s must be %s", parameter->name, field->name, record->name,
                         field->is_count ? "an integer" : "a number");
            return 0;
        }
        if (!is_within(parameter->name, field->name, field->is_count ? (double)number->whole : number->real,
                       field->lowest, field->highest))
            return 0;
    }
    return 1;
}

static int open_argument(PyObject *object, const Parameter *parameter, Py_ssize_t named[3], int at,
                         Arguments *arguments) {
    const char *name = parameter->name + strspn(parameter->name, ">?=");
    Number *number = arguments->number[at];
    switch (parameter->kind->type) {
    case 'P': return read_record(object, parameter, number);
    case 'R': return read_real(object, number);
    case 'W':
        return read_whole(object, number) &&
               is_within("", name, (double)number->whole, parameter->extent[0], parameter->extent[1]);
    case 'T':
        if (PyTuple_Check(object)) return 1;
        PyErr_Format(PyExc_TypeError, "%s: must be a tuple", name);
        return 0;
    default:
        return (object == Py_None && memchr(parameter->name, '?', 2)) ||
               open_array(object, parameter, name, named, at, arguments);
    }
}

int open_arguments(PyObject *tuple, const Parameter *parameter, size_t count, Arguments *arguments) {
    Py_ssize_t named[3] = {-1, -1, -1};
    arguments->count = 0;
    if (!PyTuple_Check(tuple) || PyTuple_Size(tuple) != (Py_ssize_t)count) {
        PyErr_Format(PyExc_TypeError, "takes %zu arguments", count);
        return 0;
    }
    for (int i = 0; i < (int)count; i++) {
        arguments->view[i].obj = NULL;
        if (!open_argument(PyTuple_GetItem(tuple, i), &parameter[i], named, i, arguments)) {
            close_arguments(arguments, NULL);
            return 0;
        }
        arguments->count++;
    }
    return 1;
}

/* The types of a record's fields in Python by their names; NULL and a Python exception if that fails. */
static PyObject *field_types(const Kind *record) {
    PyObject *types = PyDict_New();
    for (int i = 0; types && i < record->count; i++) {
        PyObject *type = (PyObject *)(record->field[i].is_count ? &PyLong_Type : &PyFloat_Type);
        record->key[i] = PyUnicode_InternFromString(record->field[i].name);
        if (!record->key[i] || PyDict_SetItem(types, record->key[i], type) < 0) Py_CLEAR(types);
    }
    return types;
}

PyObject *declared_records(const Kind *const record[], size_t count) {
    PyObject *all = PyDict_New();
    for (size_t i = 0; all && i < count; i++) {
        PyObject *types = field_types(record[i]);
        if (!types || PyDict_SetItemString(all, record[i]->name, types) < 0) Py_CLEAR(all);
        Py_XDECREF(types);
    }
    return all;
}

PyObject *declared_tables(const Table *const table[], size_t count) {
    PyObject *all = PyDict_New();
    for (size_t i = 0; all && i < count; i++) {
        PyObject *columns = PyDict_New();
        for (int k = 0; columns && k < table[i]->count; k++) {
            PyObject *number = PyLong_FromLong(table[i]->column[k].count);
            if (!number || PyDict_SetItemString(columns, table[i]->column[k].name, number) < 0) Py_CLEAR(columns);
            Py_XDECREF(number);
        }
        if (!columns || PyDict_SetItemString(all, table[i]->name, columns) < 0) Py_CLEAR(all);
        Py_XDECREF(columns);
    }
    return all;
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
