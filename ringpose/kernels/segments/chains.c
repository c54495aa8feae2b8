/* The edge walk.

   A pixel that belongs to a chain has its magnitude negated while the walks last; a wall of the most negative one
   stands around the pixels that have a gradient. All is set right again at the end. */
#include "segments.h"

#include <stdlib.h>
#include <string.h>

/* Clockwise as seen, because y points down: right, down right, down, down left, left, up left, up, up right. */
static const int STEP_X[8] = {1, 1, 0, -1, -1, -1, 0, 1};
static const int STEP_Y[8] = {0, 1, 1, 1, 0, -1, -1, -1};

enum { MAGNITUDES = INT16_MAX + 1, WALL = INT16_MIN };

/* What is soon needed is fetched into the cache: the surroundings of the anchor that comes so many later, in no
   spatial order, and the pixel so many steps straight ahead of a walk. */
enum { ANCHORS_AHEAD = 8, STEPS_AHEAD = 3 };
#if defined(__GNUC__)
#define FETCH(address) __builtin_prefetch(address, 1)
#else
#define FETCH(address) ((void)0)
#endif

typedef struct {
    int32_t index;
    uint32_t orientation;
} Anchor;

/* Where the next step of a walk may go. */
typedef struct Way Way;
struct Way {
    ptrdiff_t straight, left, right;
    const Way *to_left, *to_right;
};

/* The anchors that have a gradient on all sides, strongest first, equals in their given order: a counting sort. The
   last one is repeated a few times, for those who look ahead. */
static int sort_anchors(const EdgeArea *area, const int32_t *index, const uint8_t *orientation, size_t anchors,
                        List *sorted) {
    uint32_t *place = calloc(MAGNITUDES, sizeof *place);
    if (place == NULL || !reserve(sorted, anchors + ANCHORS_AHEAD)) {
        free(place);
        return 0;
    }
    for (size_t i = 0; i < anchors; i++) place[area->magnitude[index[i]]]++;
    uint32_t next = 0;
    for (size_t value = MAGNITUDES; value-- > 0;) {
        uint32_t count = place[value];
        place[value] = next;
        next += count;
    }
    Anchor *anchor = sorted->data;
    for (size_t i = 0; i < anchors; i++)
        anchor[place[area->magnitude[index[i]]]++] = (Anchor){index[i], orientation[i] & 3};
    for (size_t i = 0; i < ANCHORS_AHEAD && anchors > 0; i++) anchor[anchors + i] = anchor[anchors - 1];
    sorted->used = anchors;
    free(place);
    return 1;
}

/* Walks from a pixel that is already taken; appends what it takes. Of equal neighbours it prefers the one straight
   on, then the left one. Returns 0 if there is no memory. Branches let the processor run ahead of the loads: a third
   faster than selecting. */
static int walk(const EdgeArea *area, int32_t at, const Way *way, List *path) {
    int16_t *value = area->magnitude + at;
    for (;;) {
        FETCH(value + STEPS_AHEAD * way->straight);
        int straight = abs(value[way->straight]), left = abs(value[way->left]), right = abs(value[way->right]);
        if (straight >= left && straight >= right) {
            value += way->straight;
        } else if (left >= right) {
            value += way->left;
            way = way->to_left;
        } else {
            value += way->right;
            way = way->to_right;
        }
        if (*value < area->lower) return 1;
        if (path->used == path->capacity && !reserve(path, 1)) return 0;
        *value = (int16_t)-*value;
        ((int32_t *)path->data)[path->used++] = (int32_t)(value - area->magnitude);
    }
}

static Pixel pixel_at(int32_t index, uint32_t width) {
    return (Pixel){(int32_t)((uint32_t)index % width), (int32_t)((uint32_t)index / width)};
}

/* A chain from its two walks: the first `back` pixels of its path backwards, its anchor, which comes last, and the
   rest. */
static int add_chain(const int32_t *path, size_t back, size_t count, size_t width, List *pixels, List *starts) {
    if (!reserve(pixels, count) || !reserve(starts, 1)) return 0;
    ((int32_t *)starts->data)[starts->used++] = (int32_t)pixels->used;
    Pixel *pixel = (Pixel *)pixels->data + pixels->used;
    for (size_t i = 0; i < back; i++) pixel[i] = pixel_at(path[back - 1 - i], (uint32_t)width);
    pixel[back] = pixel_at(path[count - 1], (uint32_t)width);
    for (size_t i = back + 1; i < count; i++) pixel[i] = pixel_at(path[i - 1], (uint32_t)width);
    pixels->used += count;
    return 1;
}

static void fetch_around(const EdgeArea *area, int32_t index) {
    const int32_t width = (int32_t)area->width;
    for (int32_t row = -MARGIN; row <= MARGIN; row++) FETCH(area->magnitude + index + row * width);
}

/* All chains; `path` gets every pixel taken, of short ones too. */
static int take_chains(const EdgeArea *area, const Way *way, const List *sorted, size_t shortest, List *path,
                       List *pixels, List *starts) {
    const Anchor *anchor = sorted->data;
    for (size_t i = 0; i < sorted->used; i++) {
        int32_t at = anchor[i].index;
        fetch_around(area, anchor[i + ANCHORS_AHEAD].index);
        if (area->magnitude[at] < area->lower) continue;
        area->magnitude[at] = (int16_t)-area->magnitude[at];
        size_t first = path->used;
        if (!walk(area, at, way + anchor[i].orientation + 4, path)) return 0;
        size_t back = path->used - first;
        if (!walk(area, at, way + anchor[i].orientation, path) || !reserve(path, 1)) return 0;
        ((int32_t *)path->data)[path->used++] = at;
        size_t count = path->used - first;
        if (count < shortest) continue;
        if (!add_chain((int32_t *)path->data + first, back, count, area->width, pixels, starts)) return 0;
    }
    if (!reserve(starts, 1)) return 0;
    ((int32_t *)starts->data)[starts->used++] = (int32_t)pixels->used;
    return 1;
}

/* Exchanges the pixels around those that have a gradient for others. */
static void swap_wall(const EdgeArea *area, int16_t *other) {
    const size_t width = area->width, first = MARGIN - 1, right = width - MARGIN, bottom = area->height - MARGIN;
    for (size_t y = first; y <= bottom; y++) {
        const size_t step = y == first || y == bottom ? 1 : right - first;
        for (size_t x = first; x <= right; x += step) {
            int16_t *value = area->magnitude + y * width + x;
            int16_t kept = *value;
            *value = *other;
            *other++ = kept;
        }
    }
}

static void restore(const EdgeArea *area, const List *path) {
    const int32_t *index = path->data;
    for (size_t i = 0; i < path->used; i++) {
        int16_t *value = area->magnitude + index[i];
        *value = (int16_t)-*value;
    }
}

/* Magnitudes of a wall, in the place of which the right ones are kept meanwhile. */
static int16_t *make_wall(const EdgeArea *area) {
    const size_t count = 2 * (area->width + area->height);
    int16_t *wall = malloc(count * sizeof *wall);
    for (size_t i = 0; wall != NULL && i < count; i++) wall[i] = WALL;
    return wall;
}

int walk_chains(const EdgeArea *area, const int32_t *anchor, const uint8_t *orientation, size_t anchors,
                size_t shortest, List *pixels, List *starts) {
    static const int turn_left = 7, turn_right = 1;
    Way way[8];
    ptrdiff_t step[8];
    for (int i = 0; i < 8; i++) step[i] = STEP_Y[i] * (ptrdiff_t)area->width + STEP_X[i];
    for (int i = 0; i < 8; i++) {
        const int left = (i + turn_left) & 7, right = (i + turn_right) & 7;
        way[i] = (Way){step[i], step[left], step[right], way + left, way + right};
    }
    List sorted = {NULL, 0, 0, sizeof(Anchor)}, path = {NULL, 0, 0, sizeof(int32_t)};
    int16_t *wall = make_wall(area);
    int done = wall != NULL && sort_anchors(area, anchor, orientation, anchors, &sorted);
    if (done) {
        swap_wall(area, wall);
        done = take_chains(area, way, &sorted, shortest, &path, pixels, starts);
        restore(area, &path);
        swap_wall(area, wall);
    }
    free(wall);
    release(&sorted);
    release(&path);
    return done;
}
