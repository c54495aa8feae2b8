/* Validation of the kernels' arguments against a table. */
#ifndef RINGPOSE_ARGUMENTS_H
#define RINGPOSE_ARGUMENTS_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "kernels.h"

enum { MAX_ARGUMENTS = 26, MAX_AXES = 4, MAX_NUMBERS = 24 };

/* Symbolic extents of an array: any, or N, M and K, each of which is the same number in all arguments of a call. */
enum { ANY = -1, N = -2, M = -3, K = -4 };

/* Elements of arrays; IMAGE: UINT8 or UINT16, at least one pixel. */
extern const Kind ELEMENT[];
enum { FLOAT64_, FLOAT32_, INT64_, INT32_, INT16_, UINT8_, BOOL_, IMAGE_, REAL_, WHOLE_, TUPLE_ };
#define FLOAT64 &ELEMENT[FLOAT64_]
#define FLOAT32 &ELEMENT[FLOAT32_]
#define INT64 &ELEMENT[INT64_]
#define INT32 &ELEMENT[INT32_]
#define INT16 &ELEMENT[INT16_]
#define UINT8 &ELEMENT[UINT8_]
#define BOOL &ELEMENT[BOOL_]
#define IMAGE &ELEMENT[IMAGE_]

/* A number, an integer from extent[0] to extent[1], a tuple of anything, which the kernel opens by itself. */
#define REAL &ELEMENT[REAL_]
#define WHOLE &ELEMENT[WHOLE_]
#define TUPLE &ELEMENT[TUPLE_]

/* What an argument must be: a contiguous array of that many axes, a number, or a record (`&EndParams_record`). A name
   that begins with '>' is that of an array which the kernel fills, one with '?' may be None, and one with '=' is that
   of an image with elements of the type of the image before it. */
typedef struct {
    const char *name;
    const Kind *kind;
    int extent[MAX_AXES];
} Parameter;

/* Members of a record; a number is the first. */
typedef union {
    double real;
    int64_t whole;
} Number;

typedef struct {
    int count;
    Py_buffer view[MAX_ARGUMENTS]; /* `obj` is NULL for what is not an array */
    Number number[MAX_ARGUMENTS][MAX_NUMBERS];
} Arguments;

/* Checks and opens the arguments of a call; 0 and a Python exception if one of them does not fit. */
int open_arguments(PyObject *tuple, const Parameter *parameter, size_t count, Arguments *arguments);
#define OPEN(tuple, parameter, arguments) \
    open_arguments(tuple, parameter, sizeof(parameter) / sizeof *(parameter), arguments)

/* Releases the arguments and returns the result. */
PyObject *close_arguments(Arguments *arguments, PyObject *result);

/* Names and types (int, float) of the fields of records, as a dictionary of dictionaries, and prepares the records for
   `open_arguments`. */
PyObject *declared_records(const Kind *const record[], size_t count);

/* Numbers of columns of tables by name and name of the column, in order. */
PyObject *declared_tables(const Table *const table[], size_t count);

/* Sets a ValueError if the condition is false; returns the condition. */
int require(int condition, const char *message);

/* The list as a bytes object, or MemoryError if `done` is 0; releases the list. */
PyObject *list_bytes(int done, List *list);

/* Number of doubles in a struct of doubles. */
#define NUMBERS(type) ((int)(sizeof(type) / sizeof(double)))

#endif
