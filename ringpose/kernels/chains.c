/* The edge walk; twin: reference.chains.

   A pixel that belongs to a chain has its magnitude negated while the walks last; all are set right again at the
   end. */
#include "kernels.h"

#include <stdlib.h>
#include <string.h>

/* Clockwise as seen, because y points down: right, down right, down, down left, left, up left, up, up right. */
static const int STEP_X[8] = {1, 1, 0, -1, -1, -1, 0, 1};
static const int STEP_Y[8] = {0, 1, 1, 1, 0, -1, -1, -1};

enum { MAGNITUDES = INT16_MAX + 1 };

/* Anchors come in no spatial order: what the next ones need is fetched while the present one is walked. */
enum { AHEAD = 8 };
#if defined(__GNUC__)
#define FETCH(address) __builtin_prefetch(address, 1)
#else
#define FETCH(address) ((void)0)
#endif

typedef struct {
    int32_t index;
    uint32_t orientation;
} Anchor;

/* The anchors, strongest first, equals in their given order: a counting sort. */
static Anchor *descending(const int16_t *magnitude, const int32_t *index, const uint8_t *orientation, size_t anchors) {
    size_t *place = calloc(MAGNITUDES, sizeof *place);
    Anchor *sorted = malloc((anchors + AHEAD) * sizeof *sorted);
    if (place == NULL || sorted == NULL) {
        free(place);
        free(sorted);
        return NULL;
    }
    for (size_t i = 0; i < anchors; i++) place[magnitude[index[i]]]++;
    size_t next = 0;
    for (size_t value = MAGNITUDES; value-- > 0;) {
        size_t count = place[value];
        place[value] = next;
        next += count;
    }
    for (size_t i = 0; i < anchors; i++)
        sorted[place[magnitude[index[i]]]++] = (Anchor){index[i], orientation[i] & 3};
    memset(sorted + anchors, 0, AHEAD * sizeof *sorted);
    free(place);
    return sorted;
}

/* What a step is worth: the magnitude, and of equals straight (2) before left (1) before right (0). */
static int worth(int16_t value, int preference) { return 4 * (value < 0 ? -value : value) + preference; }

static int larger(int a, int b) { return a > b ? a : b; }

/* Walks from a pixel that is already taken; appends what it takes. It ends where a neighbour has no gradient, lest it
   turn aside along the margin. Returns 0 if there is no memory. */
static int walk(const EdgeArea *area, Pixel at, unsigned direction, List *pixels) {
    static const unsigned turn[3] = {1, 7, 0};
    const ptrdiff_t *step = area->step;
    const int32_t right_end = (int32_t)area->width - MARGIN - 1, lower_end = (int32_t)area->height - MARGIN - 1;
    int16_t *value = area->magnitude + (ptrdiff_t)at.y * (ptrdiff_t)area->width + at.x;
    while (at.x > MARGIN && at.x < right_end && at.y > MARGIN && at.y < lower_end) {
        int straight = worth(value[step[direction]], 2);
        int left = worth(value[step[(direction + 7) & 7]], 1), right = worth(value[step[(direction + 1) & 7]], 0);
        direction = (direction + turn[larger(straight, larger(left, right)) & 3]) & 7;
        value += step[direction];
        if (*value < area->lower) return 1;
        if (pixels->used == pixels->capacity && !reserve(pixels, 1)) return 0;
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
static int join_walks(const EdgeArea *area, size_t anchor, unsigned direction, List *pixels) {
    Pixel at = {(int32_t)(anchor % area->width), (int32_t)(anchor / area->width)};
    size_t first = pixels->used;
    if (!reserve(pixels, 1)) return 0;
    ((Pixel *)pixels->data)[pixels->used++] = at;
    area->magnitude[anchor] = (int16_t)-area->magnitude[anchor];
    if (!walk(area, at, (direction + 4) & 7, pixels)) return 0;
    reverse((Pixel *)pixels->data + first, pixels->used - first);
    return walk(area, at, direction, pixels);
}

static void restore(const EdgeArea *area, const List *pixels) {
    const Pixel *pixel = pixels->data;
    for (size_t i = 0; i < pixels->used; i++) {
        int16_t *value = area->magnitude + (size_t)pixel[i].y * area->width + (size_t)pixel[i].x;
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

static void fetch_around(const EdgeArea *area, size_t at) {
    FETCH(area->magnitude + at);
    if (at >= area->width) FETCH(area->magnitude + at - area->width);
    if (at + area->width < area->width * area->height) FETCH(area->magnitude + at + area->width);
}

int walk_chains(EdgeArea *area, const int32_t *anchor, const uint8_t *orientation, size_t anchors, size_t shortest,
                List *pixels, List *starts) {
    Anchor *sorted = descending(area->magnitude, anchor, orientation, anchors);
    if (sorted == NULL) return 0;
    for (int i = 0; i < 8; i++) area->step[i] = STEP_Y[i] * (ptrdiff_t)area->width + STEP_X[i];
    int done = 1;
    for (size_t i = 0; i < anchors && done; i++) {
        size_t at = (size_t)sorted[i].index;
        fetch_around(area, (size_t)sorted[i + AHEAD].index);
        if (area->magnitude[at] < area->lower) continue;
        done = reserve(starts, 1);
        if (!done) break;
        ((int32_t *)starts->data)[starts->used++] = (int32_t)pixels->used;
        done = join_walks(area, at, sorted[i].orientation, pixels);
    }
    restore(area, pixels);
    free(sorted);
    return done && keep_long(shortest, pixels, starts);
}
