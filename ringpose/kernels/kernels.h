/* What the kernels share: growing lists, and the compiler's help. No Python in here. */
#ifndef RINGPOSE_KERNELS_H
#define RINGPOSE_KERNELS_H

#include <stddef.h>
#include <stdint.h>

/* Two versions of a vector loop in one portable library; the loader takes the one that the processor can do. */
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
int reserve(List *list, size_t extra);
void release(List *list);

#endif
