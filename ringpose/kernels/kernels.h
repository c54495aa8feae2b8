/* Growing lists, and vectorised loops. */
#ifndef RINGPOSE_KERNELS_H
#define RINGPOSE_KERNELS_H

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

#endif
