/* Edge chains by walks from anchors (Edge Drawing), and their straight pieces by the length condition and the direction
   shares (ringpose-method(7), section 2).

   The magnitude of a pixel that belongs to a chain is negated during the walks; pixels of the most negative magnitude
   surround the region that has a gradient. Both are restored at the end. */
#include "arguments.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "segments.h"

typedef struct {
    int16_t *magnitude;
    size_t height, width;
    int lower; /* an edge has at least this magnitude */
} EdgeArea;

typedef struct {
    double max_deviation;    /* of estimated length from chord, pixels */
    double share_change; /* L1 difference of direction shares */
    size_t window;       /* steps */
    size_t min_pixels;     /* pixels */
} CutParams;

/* Clockwise as seen, because y points down: right, down right, down, down left, left, up left, up, up right. */
static const int STEP_X[8] = {1, 1, 0, -1, -1, -1, 0, 1};
static const int STEP_Y[8] = {0, 1, 1, 1, 0, -1, -1, -1};

enum { MAGNITUDES = INT16_MAX + 1, WALL = INT16_MIN };

typedef struct {
    int32_t index;
    uint32_t orientation;
} Anchor;

/* Candidates for the next step of a walk. */
typedef struct Way Way;
struct Way {
    ptrdiff_t straight, left, right;
    const Way *to_left, *to_right;
};

/* The anchors that have a gradient on all sides, strongest first, equals in their given order: a counting sort. */
static int sort_anchors(const EdgeArea *area, const int32_t *index, const uint8_t *orientation, size_t anchors,
                        List *sorted) {
    uint32_t *place = calloc(MAGNITUDES, sizeof *place);
    if (place == NULL || !reserve(sorted, anchors)) {
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

/* All chains; `path` gets every pixel taken, of short ones too. */
static int take_chains(const EdgeArea *area, const Way *way, const List *sorted, size_t min_pixels, List *path,
                       List *pixels, List *starts) {
    const Anchor *anchor = sorted->data;
    for (size_t i = 0; i < sorted->used; i++) {
        int32_t at = anchor[i].index;
        if (area->magnitude[at] < area->lower) continue;
        area->magnitude[at] = (int16_t)-area->magnitude[at];
        size_t first = path->used;
        if (!walk(area, at, way + anchor[i].orientation + 4, path)) return 0;
        size_t back = path->used - first;
        if (!walk(area, at, way + anchor[i].orientation, path) || !reserve(path, 1)) return 0;
        ((int32_t *)path->data)[path->used++] = at;
        size_t count = path->used - first;
        if (count < min_pixels) continue;
        if (!add_chain((int32_t *)path->data + first, back, count, area->width, pixels, starts)) return 0;
    }
    if (!reserve(starts, 1)) return 0;
    ((int32_t *)starts->data)[starts->used++] = (int32_t)pixels->used;
    return 1;
}

/* Exchanges the ring of pixels around the region that has a gradient with the values in `other`. */
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

/* The most negative magnitude for each pixel of that ring; `swap_wall` keeps the right magnitudes in this memory. */
static int16_t *make_wall(const EdgeArea *area) {
    const size_t count = 2 * (area->width + area->height);
    int16_t *wall = malloc(count * sizeof *wall);
    for (size_t i = 0; wall != NULL && i < count; i++) wall[i] = WALL;
    return wall;
}

static int walk_chains(const EdgeArea *area, const int32_t *anchor, const uint8_t *orientation, size_t anchors,
                size_t min_pixels, List *pixels, List *starts) {
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
        done = take_chains(area, way, &sorted, min_pixels, &path, pixels, starts);
        restore(area, &path);
        swap_wall(area, wall);
    }
    free(wall);
    release(&sorted);
    release(&path);
    return done;
}

/* Counts of steps; all others are oblique. */
typedef struct {
    int64_t horizontal, vertical;
} Steps;

static Steps step_between(Pixel from, Pixel to) {
    const int horizontal = from.y == to.y;
    return (Steps){horizontal, !horizontal & (from.x == to.x)};
}

/* True if the estimated length, Eq. (2.1), exceeds the chord by more than the deviation. Their difference is that of
   the squares by their sum, and the sum is at least that of the longer sides: mostly this spares the roots. */
static int exceeds(Steps steps, int64_t all, Pixel from, Pixel to, double max_deviation) {
    const double wide = (double)(all - steps.vertical), high = (double)(all - steps.horizontal);
    const double dx = fabs((double)to.x - from.x), dy = fabs((double)to.y - from.y);
    const double length = wide * wide + high * high, chord = dx * dx + dy * dy;
    const double sides = (wide > high ? wide : high) + (dx > dy ? dx : dy);
    if (length - chord <= max_deviation * sides && max_deviation >= 0) return 0;
    return sqrt(length) - sqrt(chord) > max_deviation;
}

/* The pixel that lies farthest from the chord, the first such; at least one step on, so that cutting ends. */
static size_t farthest(const Pixel *pixel, size_t first, size_t last) {
    double dx = (double)pixel[last].x - pixel[first].x, dy = (double)pixel[last].y - pixel[first].y, maximum = 0;
    size_t at = first + 1;
    for (size_t k = first + 1; k < last; k++) {
        double x = (double)pixel[k].x - pixel[first].x, y = (double)pixel[k].y - pixel[first].y;
        double off = fabs(dx * y - dy * x);
        if (off > maximum) {
            maximum = off;
            at = k;
        }
    }
    return at;
}

/* Last pixel of the straight piece that begins at `first`; `end` is one past the chain. */
static size_t piece_end(const Pixel *pixel, size_t first, size_t end, CutParams params) {
    Steps steps = {0, 0}, head = {0, 0}, window = {0, 0};
    const double maximum = params.share_change * (double)params.window;
    for (size_t k = first + 1; k < end; k++) {
        const Steps now = step_between(pixel[k - 1], pixel[k]);
        steps.horizontal += now.horizontal;
        steps.vertical += now.vertical;
        if (exceeds(steps, (int64_t)(k - first), pixel[first], pixel[k], params.max_deviation))
            return farthest(pixel, first, k);
        if (k - first <= params.window) {
            head = window = steps;
            continue;
        }
        const Steps old = step_between(pixel[k - params.window - 1], pixel[k - params.window]);
        window.horizontal += now.horizontal - old.horizontal;
        window.vertical += now.vertical - old.vertical;
        const int64_t horizontal = window.horizontal - head.horizontal, vertical = window.vertical - head.vertical;
        /* window times the change of the shares, Eq. (2.2); the oblique steps are the others */
        const int64_t change = llabs(horizontal) + llabs(vertical) + llabs(horizontal + vertical);
        if ((double)change > maximum) return k - params.window / 2;
    }
    return end - 1;
}

static int cut_chains(const Pixel *pixels, const int32_t *starts, size_t chains, CutParams params, List *pieces) {
    for (size_t i = 0; i < chains; i++) {
        size_t first = (size_t)starts[i], end = (size_t)starts[i + 1];
        while (end - first >= params.min_pixels) {
            size_t last = piece_end(pixels, first, end, params);
            if (last - first + 1 >= params.min_pixels) {
                if (!reserve(pieces, 1)) return 0;
                ((Piece *)pieces->data)[pieces->used++] = (Piece){(int32_t)first, (int32_t)last};
            }
            first = last;
            if (last + 1 == end) break;
        }
    }
    return 1;
}

/* True if every anchor is among the pixels that have a gradient. */
static int anchors_inside(const Py_buffer *magnitude, const Py_buffer *index) {
    const int32_t *anchor = index->buf;
    const int16_t *value = magnitude->buf;
    const uint32_t width = (uint32_t)magnitude->shape[1], height = (uint32_t)magnitude->shape[0];
    const uint32_t wide = width > 2 * MARGIN ? width - 2 * MARGIN : 0;
    const uint32_t high = height > 2 * MARGIN ? height - 2 * MARGIN : 0;
    for (Py_ssize_t i = 0; i < index->shape[0]; i++) {
        const uint32_t at = (uint32_t)anchor[i];
        if (at % width - MARGIN < wide && at / width - MARGIN < high && value[at] >= 0) continue;
        PyErr_Format(PyExc_ValueError, "anchors: number %zd has no gradient or a negative one", i);
        return 0;
    }
    return 1;
}

PyObject *call_chains(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{">magnitude", INT16, {ANY, ANY}},
                                          {"anchors", INT32, {N}},
                                          {"orientation", UINT8, {N}},
                                          {"lower", WHOLE, {1, INT16_MAX}},
                                          {"shortest", WHOLE, {1, INT32_MAX}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    if (!anchors_inside(&a.view[0], &a.view[1])) return close_arguments(&a, NULL);
    const size_t anchors = (size_t)a.view[1].shape[0], min_pixels = (size_t)a.number[4][0].whole;
    if (!anchors)
        return close_arguments(&a, Py_BuildValue("(y#y#)", "", (Py_ssize_t)0, "\0\0\0\0", (Py_ssize_t)4));
    const EdgeArea area = {a.view[0].buf, (size_t)a.view[0].shape[0], (size_t)a.view[0].shape[1], (int)a.number[3][0].whole};
    List pixels = {NULL, 0, 0, sizeof(Pixel)}, starts = {NULL, 0, 0, sizeof(int32_t)};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = walk_chains(&area, a.view[1].buf, a.view[2].buf, anchors, min_pixels, &pixels, &starts);
    Py_END_ALLOW_THREADS
    return close_arguments(&a, Py_BuildValue("(NN)", list_bytes(done, &pixels), list_bytes(done, &starts)));
}

static int starts_ascend(const Py_buffer *starts, Py_ssize_t pixels) {
    const int32_t *start = starts->buf;
    Py_ssize_t count = starts->shape[0];
    int ascend = count > 0 && start[0] >= 0 && start[count - 1] <= pixels && pixels <= INT32_MAX;
    for (Py_ssize_t i = 1; ascend && i < count; i++) ascend = start[i - 1] <= start[i];
    return require(ascend, "starts: must ascend from 0 or more to at most the number of pixels");
}

PyObject *call_cuts(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"pixels", INT32, {ANY, 2}},       {"starts", INT32, {ANY}},
                                          {"deviation", REAL, {0}},         {"share_change", REAL, {0}},
                                          {"window", WHOLE, {2, INT32_MAX}}, {"shortest", WHOLE, {2, INT32_MAX}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    if (!starts_ascend(&a.view[1], a.view[0].shape[0])) return close_arguments(&a, NULL);
    const CutParams params = {a.number[2][0].real, a.number[3][0].real, (size_t)a.number[4][0].whole,
                              (size_t)a.number[5][0].whole};
    List pieces = {NULL, 0, 0, sizeof(Piece)};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = cut_chains(a.view[0].buf, a.view[1].buf, (size_t)a.view[1].shape[0] - 1, params, &pieces);
    Py_END_ALLOW_THREADS
    return close_arguments(&a, list_bytes(done, &pieces));
}
