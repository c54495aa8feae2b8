/* The edge walk; twin: reference.chains.

   A pixel that belongs to a chain has its magnitude negated while the walk lasts; all are set right again at the end. */
#include "kernels.h"

#include <stdlib.h>
#include <string.h>

/* Clockwise as seen, because y points down: right, down right, down, down left, left, up left, up, up right. */
static const int STEP_X[8] = {1, 1, 0, -1, -1, -1, 0, 1};
static const int STEP_Y[8] = {0, 1, 1, 1, 0, -1, -1, -1};

enum { MAGNITUDES = INT16_MAX + 1 };

/* Numbers of the anchors, strongest first, equals in their given order. */
static int32_t *descending(const int16_t *magnitude, const int32_t *anchor, size_t anchors) {
    size_t *place = calloc(MAGNITUDES + 1, sizeof *place);
    int32_t *order = malloc((anchors ? anchors : 1) * sizeof *order);
    if (place != NULL && order != NULL) {
        for (size_t i = 0; i < anchors; i++) place[magnitude[anchor[i]]]++;
        size_t next = 0;
        for (size_t value = MAGNITUDES; value-- > 0;) {
            size_t count = place[value];
            place[value] = next;
            next += count;
        }
        for (size_t i = 0; i < anchors; i++) order[place[magnitude[anchor[i]]]++] = (int32_t)i;
    } else {
        free(order);
        order = NULL;
    }
    free(place);
    return order;
}

static int strength(int16_t value) { return value < 0 ? -value : value; }

/* Walks from a pixel that is already taken; appends what it takes. Returns 0 if there is no memory. */
static int walk(EdgeArea area, Pixel at, int direction, List *pixels) {
    ptrdiff_t width = (ptrdiff_t)area.width;
    int16_t *value = area.magnitude + at.y * width + at.x;
    ptrdiff_t step[8];
    for (int i = 0; i < 8; i++) step[i] = STEP_Y[i] * width + STEP_X[i];
    while (at.x > 0 && at.y > 0 && at.x + 1 < (ptrdiff_t)area.width && at.y + 1 < (ptrdiff_t)area.height) {
        int left = (direction + 7) & 7, right = (direction + 1) & 7, best = direction;
        int most = strength(value[step[direction]]);
        if (strength(value[step[left]]) > most) most = strength(value[step[best = left]]);
        if (strength(value[step[right]]) > most) most = strength(value[step[best = right]]);
        value += step[best];
        if (*value < area.lower) return 1;
        if (!reserve(pixels, 1)) return 0;
        direction = best;
        at.x += STEP_X[direction];
        at.y += STEP_Y[direction];
        *value = (int16_t)-*value;
        ((Pixel *)pixels->data)[pixels->used++] = at;
    }
    return 1;
}

static void reverse(Pixel *pixels, size_t count) {
    for (size_t i = 0; i < count / 2; i++) {
        Pixel other = pixels[count - 1 - i];
        pixels[count - 1 - i] = pixels[i];
        pixels[i] = other;
    }
}

/* Both walks from one anchor, joined there. */
static int join_walks(EdgeArea area, size_t anchor, int direction, List *pixels) {
    Pixel at = {(int32_t)(anchor % area.width), (int32_t)(anchor / area.width)};
    size_t first = pixels->used;
    if (!reserve(pixels, 1)) return 0;
    ((Pixel *)pixels->data)[pixels->used++] = at;
    area.magnitude[anchor] = (int16_t)-area.magnitude[anchor];
    if (!walk(area, at, direction + 4, pixels)) return 0;
    reverse((Pixel *)pixels->data + first, pixels->used - first);
    return walk(area, at, direction, pixels);
}

static void restore(EdgeArea area, const List *pixels) {
    const Pixel *pixel = pixels->data;
    for (size_t i = 0; i < pixels->used; i++) {
        int16_t *value = area.magnitude + (size_t)pixel[i].y * area.width + (size_t)pixel[i].x;
        *value = (int16_t)-*value;
    }
}

/* Drops the short chains; `starts` then holds one entry more than there are chains. */
static int keep_long(size_t shortest, List *pixels, List *starts) {
    Pixel *pixel = pixels->data;
    size_t chains = starts->used, used = 0, kept = 0;
    if (!reserve(starts, 1)) return 0;
    int32_t *start = starts->data;
    start[chains] = (int32_t)pixels->used;
    for (size_t i = 0; i < chains; i++) {
        size_t first = (size_t)start[i], count = (size_t)(start[i + 1] - start[i]);
        if (count < shortest) continue;
        memmove(pixel + used, pixel + first, count * sizeof *pixel);
        start[kept++] = (int32_t)used;
        used += count;
    }
    start[kept++] = (int32_t)used;
    starts->used = kept;
    pixels->used = used;
    return 1;
}

int walk_chains(EdgeArea area, const int32_t *anchor, const uint8_t *orientation, size_t anchors, size_t shortest,
                List *pixels, List *starts) {
    int32_t *order = descending(area.magnitude, anchor, anchors);
    if (order == NULL) return 0;
    int done = 1;
    for (size_t i = 0; i < anchors && done; i++) {
        size_t number = (size_t)order[i], at = (size_t)anchor[number];
        if (area.magnitude[at] < area.lower) continue;
        done = reserve(starts, 1);
        if (!done) break;
        ((int32_t *)starts->data)[starts->used++] = (int32_t)pixels->used;
        done = join_walks(area, at, orientation[number] & 3, pixels);
    }
    restore(area, pixels);
    free(order);
    return done && keep_long(shortest, pixels, starts);
}
