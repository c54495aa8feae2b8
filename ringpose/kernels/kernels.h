/* Growing lists, vectorised loops, records of parameters, and rows of tables. */
#ifndef RINGPOSE_KERNELS_H
#define RINGPOSE_KERNELS_H

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

/* Compiles a loop twice, with and without AVX2; the loader selects the version that the processor supports. */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__GLIBC__) && !defined(RINGPOSE_PORTABLE)
#define VECTOR_LOOP __attribute__((target_clones("avx2", "default")))
#else
#define VECTOR_LOOP
#endif

/* A list that doubles; `item` is the size of one entry in bytes. Begin with {NULL, 0, 0, item}, end with release. */
typedef struct {
    void *data;
    size_t used, capacity, item;
} List;

/* Room for `extra` more entries; 0 if there is no memory. */
static inline int reserve(List *list, size_t extra) {
    if (extra <= list->capacity - list->used) return 1;
    if (extra > SIZE_MAX / 4 / list->item - list->used) return 0;
    size_t capacity = 2 * (list->used + extra);
    void *data = realloc(list->data, capacity * list->item);
    if (data == NULL) return 0;
    list->data = data;
    list->capacity = capacity;
    return 1;
}

static inline void release(List *list) {
    free(list->data);
    list->data = NULL;
    list->used = list->capacity = 0;
}

/* Records of parameters have one definition here, a list FIELDS(REAL, COUNT) of `REAL(name, lowest, highest)` and
   `COUNT(name, lowest, highest)`: the members of the struct, of 8 bytes each, and the attributes of the data class in
   Python, floats and ints. Records cross the border by these names (arguments.h). */
#define REAL_MEMBER(name, ...) double name;
#define COUNT_MEMBER(name, ...) int64_t name;
#define RECORD_STRUCT(type, FIELDS) typedef struct { FIELDS(REAL_MEMBER, COUNT_MEMBER) } type

/* Limits: any finite number, none below 0, only positive ones. */
#define FINITE -DBL_MAX, DBL_MAX
#define NOT_NEGATIVE 0, DBL_MAX
#define POSITIVE DBL_MIN, DBL_MAX

typedef struct {
    const char *name;
    int is_count;
    double lowest, highest; /* limits of its values */
} Field;

/* Rows of tables have one definition, too, a list COLUMNS(COLUMN, COLUMNS_OF): the members of the struct of a
   row, doubles (`COLUMN(name)`) and arrays of doubles (`COLUMNS_OF(name, count)`); Python finds the columns by
   these names. */
#define COLUMN_MEMBER(name) double name;
#define COLUMNS_MEMBER(name, count) double name[count];
#define ROW_STRUCT(type, COLUMNS) typedef struct { COLUMNS(COLUMN_MEMBER, COLUMNS_MEMBER) } type

typedef struct {
    const char *name;
    int count;
} Column;

typedef struct {
    const char *name;
    const Column *column;
    int count;
} Table;

/* Defines the table whose rows are structs of that type. */
#define COLUMN_ENTRY(name) {#name, 1},
#define COLUMNS_ENTRY(name, count) {#name, count},
#define TABLE(type, COLUMNS)                                                              \
    static const Column type##_columns[] = {COLUMNS(COLUMN_ENTRY, COLUMNS_ENTRY)};        \
    const Table type##_table = {#type, type##_columns, sizeof type##_columns / sizeof *type##_columns}

/* What an argument may be: elements of an array, a number, or a record. `type` is that of Python's module struct for
   elements, and the first letter of the kind for others. */
typedef struct {
    char type;
    const char *name;   /* of a record's data class */
    const Field *field; /* of a record */
    void **key;         /* the fields' names as Python's strings */
    int count;          /* of the fields */
} Kind;

/* Defines the kind of a record. */
#define REAL_FIELD(name, ...) {#name, 0, __VA_ARGS__},
#define COUNT_FIELD(name, ...) {#name, 1, __VA_ARGS__},
#define RECORD(type_, FIELDS)                                                          \
    static const Field type_##_fields[] = {FIELDS(REAL_FIELD, COUNT_FIELD)};           \
    static void *type_##_keys[sizeof type_##_fields / sizeof *type_##_fields];         \
    const Kind type_##_record = {.type = 'P',                                          \
                                 .name = #type_,                                       \
                                 .field = type_##_fields,                              \
                                 .key = type_##_keys,                                  \
                                 .count = sizeof type_##_fields / sizeof *type_##_fields}

#endif
