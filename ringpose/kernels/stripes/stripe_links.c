/* Ridges of neighbouring columns are linked into pieces by a tracking filter: position and slope are predicted, the
   nearest ridge updates them. */
#include "stripe_links.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Gate: largest distance from the prediction, over the mean distance of the piece's ridges, within limits in pixels.
   Speckle makes ridges jump, and so does an edge between two surfaces. */
#define STEP 5.0f
#define MIN_STEP_PX 1.25f
#define MAX_STEP_PX 2.0f
#define NEXT_PX 1.0f

/* Initial value of that mean, and the weight of each further column. */
#define FIRST_SCATTER_PX 0.25f
#define SCATTER_SHARE 0.125f

/* The prediction is a line fitted to all columns at first, later to about this many. */
enum { COURSE_COLUMNS = 8 };

/* Distance of two ridges in a column that may be the shoulders of a flat top. */
enum { MIN_SHOULDER_ROWS = 5, MAX_SHOULDER_ROWS = 40 };

/* Between shoulders the signal stays above this share of theirs. */
#define PLATEAU_SHARE 0.8f

typedef struct {
    float y, expected, slope, scatter, distance; /* y: of the last ridge */
    int32_t nearest, missing, columns, strong_columns, piece;
} OpenPiece;

/* Open pieces, from the top; `spare` has the same capacity. */
typedef struct {
    const StripeParams *params;
    OpenPiece *open, *spare;
    size_t count, capacity;
    List *pieces;
} Course;

/* ---- flat tops ---- */

/* True if the signal between two ridges of a column stays near their own height. */
static int is_plateau(const StripeImage *image, ptrdiff_t outside, const Ridge *a, const Ridge *b) {
    if (a->response > 2 * b->response || b->response > 2 * a->response) return 0;
    size_t x = (size_t)a->x, width = image->width;
    float high = pixel_at(image, (size_t)a->row * width + x), other = pixel_at(image, (size_t)b->row * width + x);
    float above = pixel_at(image, clamped(a->row - outside, image->height) * width + x);
    float below = pixel_at(image, clamped(b->row + outside, image->height) * width + x);
    float base = above > below ? above : below, level = high < other ? high : other;
    float minimum = base + PLATEAU_SHARE * (level - base);
    if (level <= base) return 0;
    for (int32_t row = a->row + 1; row < b->row; row++)
        if (pixel_at(image, (size_t)row * width + x) < minimum) return 0;
    return 1;
}

/* Joins the shoulders of flat tops in one column; returns how many ridges are left. */
static size_t join_shoulders(const StripeImage *image, ptrdiff_t outside, Ridge *ridge, size_t count) {
    size_t kept = 0;
    for (size_t i = 0; i < count; i++) {
        Ridge here = ridge[i];
        int32_t apart = i + 1 < count ? ridge[i + 1].row - here.row : 0;
        if (apart >= MIN_SHOULDER_ROWS && apart <= MAX_SHOULDER_ROWS &&
            is_plateau(image, outside, &here, ridge + i + 1)) {
            i++;
            here.curvature = -0.5f * (ridge[i].y - here.y);
            here.y = 0.5f * (ridge[i].y + here.y);
            here.row = (int32_t)(here.y + 0.5f);
        }
        ridge[kept++] = here;
    }
    return kept;
}

/* ---- course ---- */

static float distance(float a, float b) { return fabsf(a - b); }

/* True if a ridge is within the gate, or next to the last one: a stripe may bend. */
static int is_next(const OpenPiece *open, float y, float apart) {
    float step = STEP * open->scatter;
    step = step < MIN_STEP_PX ? MIN_STEP_PX : step > MAX_STEP_PX ? MAX_STEP_PX : step;
    return apart <= step || (open->missing == 0 && distance(open->y, y) <= NEXT_PX);
}

/* Each ridge proposes to the nearest piece; a piece accepts the nearest one, the upper one if equal. */
static void match(Course *course, const Ridge *ridge, size_t count) {
    if (course->count == 0) return;
    OpenPiece *open = course->open, *last = open + course->count - 1;
    for (size_t i = 0; i < count; i++) {
        float apart = distance(open->expected, ridge[i].y);
        for (; open < last; open++) {
            float next = distance(open[1].expected, ridge[i].y);
            if (next >= apart) break;
            apart = next;
        }
        if (!is_next(open, ridge[i].y, apart) || (open->nearest >= 0 && apart >= open->distance)) continue;
        open->nearest = (int32_t)i;
        open->distance = apart;
    }
}

/* Recursive line fit: gains of the growing window, then of an exponential one. */
static void follow(OpenPiece *open, Ridge *ridge, const StripeParams *params) {
    static const float gain[COURSE_COLUMNS + 1] = {0, 1, 1, 5 / 6.f, 7 / 10.f, 3 / 5.f, 11 / 21.f, 13 / 28.f, 5 / 12.f};
    static const float slope_gain[COURSE_COLUMNS + 1] = {0, .3f, .3f, .3f, .3f, 1 / 5.f, 1 / 7.f, 3 / 28.f, 1 / 12.f};
    float off = ridge->y - open->expected;
    int32_t n = ++open->columns < COURSE_COLUMNS ? open->columns : COURSE_COLUMNS;
    open->slope += open->missing ? off * slope_gain[n] / (float)(open->missing + 1) : off * slope_gain[n];
    open->expected += off * gain[n] + open->slope;
    open->scatter += SCATTER_SHARE * (distance(off, 0) - open->scatter);
    open->y = ridge->y;
    open->strong_columns += ridge->response >= (float)params->begin_sigmas * ridge->noise;
    open->missing = 0;
    open->nearest = -1;
    ridge->piece = open->piece;
}

static void end_piece(const Course *course, const OpenPiece *open) {
    ((StripePiece *)course->pieces->data)[open->piece] = (StripePiece){open->columns, open->strong_columns};
}

/* Advances all pieces by a column: update, prediction only, or end. A gap ends a piece that is shorter than the gap,
   because noise starts many pieces. Returns the number of accepted ridges. */
static size_t advance(Course *course, Ridge *ridge) {
    size_t kept = 0, taken = 0;
    OpenPiece *open = course->open;
    for (size_t i = 0; i < course->count; i++) {
        if (open[i].nearest >= 0) {
            follow(open + i, ridge + open[i].nearest, course->params);
            taken++;
        } else {
            open[i].expected += open[i].slope;
            if (++open[i].missing > (int32_t)course->params->gap || open[i].missing >= open[i].columns) {
                end_piece(course, open + i);
                continue;
            }
        }
        if (kept < i) open[kept] = open[i];
        for (size_t j = kept++; j > 0 && open[j - 1].expected > open[j].expected; j--) {
            OpenPiece upper = open[j];
            open[j] = open[j - 1];
            open[j - 1] = upper;
        }
    }
    course->count = kept;
    return taken;
}

static int reserve_open(Course *course, size_t count) {
    if (count <= course->capacity) return 1;
    OpenPiece *spare = realloc(course->spare, 2 * count * sizeof *spare);
    if (spare) course->spare = spare;
    OpenPiece *open = spare ? realloc(course->open, 2 * count * sizeof *open) : NULL;
    if (open == NULL) return 0;
    course->open = open;
    course->capacity = 2 * count;
    return 1;
}

/* Starts pieces with the remaining ridges and merges them into the sorted list. */
static int begin_pieces(Course *course, Ridge *ridge, size_t count) {
    if (!reserve(course->pieces, count) || !reserve_open(course, course->count + count)) return 0;
    OpenPiece *spare = course->spare;
    size_t t = 0, all = 0;
    for (size_t i = 0; i < count; i++) {
        if (ridge[i].piece >= 0) continue;
        while (t < course->count && course->open[t].expected <= ridge[i].y) spare[all++] = course->open[t++];
        ridge[i].piece = (int32_t)course->pieces->used++;
        int strong = ridge[i].response >= (float)course->params->begin_sigmas * ridge[i].noise;
        spare[all++] = (OpenPiece){ridge[i].y, ridge[i].y, 0, FIRST_SCATTER_PX, 0, -1, 0, 1, strong, ridge[i].piece};
    }
    while (t < course->count) spare[all++] = course->open[t++];
    course->spare = course->open;
    course->open = spare;
    course->count = all;
    return 1;
}

/* ---- all ---- */

static int link_columns(const StripeImage *image, ptrdiff_t outside, Course *course, List *ridges) {
    Ridge *ridge = ridges->data;
    size_t kept = 0, first = 0, end = 0;
    for (int32_t x = 0; first < ridges->used; first = end, x++) {
        for (; x < ridge[first].x && course->count; x++) advance(course, NULL);
        x = ridge[first].x;
        for (end = first; end < ridges->used && ridge[end].x == x; end++) continue;
        size_t count = end - first > 1 ? join_shoulders(image, outside, ridge + first, end - first) : 1;
        if (kept < first) memmove(ridge + kept, ridge + first, count * sizeof *ridge);
        match(course, ridge + kept, count);
        if (advance(course, ridge + kept) < count && !begin_pieces(course, ridge + kept, count)) return 0;
        kept += count;
    }
    ridges->used = kept;
    for (size_t i = 0; i < course->count; i++) end_piece(course, course->open + i);
    return 1;
}

int link_ridges(const StripeImage *image, const Filter *filter, const StripeParams *params, List *ridges,
                List *pieces) {
    Course course = {.params = params, .pieces = pieces};
    int done = link_columns(image, (ptrdiff_t)(3 * filter->sigma + 0.5), &course, ridges);
    free(course.open);
    free(course.spare);
    return done;
}
