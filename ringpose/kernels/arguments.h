/* Validation of the kernels' arguments against a table. */
#ifndef RINGPOSE_ARGUMENTS_H
#define RINGPOSE_ARGUMENTS_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "kernels.h"

enum { MAX_ARGUMENTS = 26, MAX_AXES = 4, MAX_NUMBERS = 20 };

/* Symbolic extents of an array: any, or N, M and K, each of which is the same number in all arguments of a call. */
enum { ANY = -1, N = -2, M = -3, K = -4 };

/* What an argument must be. A name that begins with '>' is that of an array which the kernel fills, one with '?' may be
   None. Types: 'd' float64, 'f' float32, 'q' int64, 'i' int32, 'h' int16, 'B' uint8, '?' bool, 'I' an image (uint8 or
   uint16): contiguous arrays of that many axes; 'T' a tuple of extent[0] numbers, 'R' a number, 'L' an integer from
   extent[0] to extent[1], 'O' a tuple of anything, which the kernel opens by itself. */
typedef struct {
    const char *name;
    char type;
    int extent[MAX_AXES];
} Parameter;

typedef struct {
    int count;
    Py_buffer view[MAX_ARGUMENTS];             /* `obj` is NULL for what is not an array */
    double number[MAX_ARGUMENTS][MAX_NUMBERS]; /* elements of tuples; a scalar is the first */
} Arguments;

/* Checks and opens the arguments of a call; 0 and a Python exception if one of them does not fit. */
int open_arguments(PyObject *tuple, const Parameter *parameter, size_t count, Arguments *arguments);
#define OPEN(tuple, parameter, arguments) \
    open_arguments(tuple, parameter, sizeof(parameter) / sizeof *(parameter), arguments)

/* Releases the arguments and returns the result. */
PyObject *close_arguments(Arguments *arguments, PyObject *result);

/* Sets a ValueError if the condition is false; returns the condition. */
int require(int condition, const char *message);

/* The list as a bytes object, or MemoryError if `done` is 0; releases the list. */
PyObject *list_bytes(int done, List *list);

/* Number of doubles in a struct of doubles. */
#define NUMBERS(type) ((int)(sizeof(type) / sizeof(double)))

#endif
