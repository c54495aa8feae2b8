#include "kernels.h"

#include <stdlib.h>

int reserve(List *list, size_t extra) {
    if (extra <= list->capacity - list->used) return 1;
    if (extra > SIZE_MAX / 4 / list->item - list->used) return 0;
    size_t capacity = 2 * (list->used + extra);
    void *data = realloc(list->data, capacity * list->item);
    if (data == NULL) return 0;
    list->data = data;
    list->capacity = capacity;
    return 1;
}

void release(List *list) {
    free(list->data);
    list->data = NULL;
    list->used = list->capacity = 0;
}
