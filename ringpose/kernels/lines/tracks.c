/* Straight tracks: pieces cut at their kinks, joined across gaps. */
#include "drafts.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "select.h"
#include "track_line.h"

/* Values of a running median. */
enum { SMOOTHED = 7 };

/* Columns over which the speckle of two centres has become independent, and differences that tell a scatter. */
enum { LAG = 4, LEAST_DIFFERENCES = 8 };

typedef struct {
    Draft *data;
    size_t used, capacity;
} Drafts;

static int push(Drafts *drafts, const Draft *draft) {
    if (drafts->used == drafts->capacity) {
        size_t capacity = drafts->capacity ? 2 * drafts->capacity : 64;
        Draft *data = realloc(drafts->data, capacity * sizeof *data);
        if (!data) return 0;
        drafts->data = data;
        drafts->capacity = capacity;
    }
    drafts->data[drafts->used++] = *draft;
    return 1;
}

/* Median of the seven values around i, mirrored at the ends of the run without repeating the end itself. */
static double smoothed(const double *y, ptrdiff_t n, ptrdiff_t i) {
    double window[SMOOTHED];
    for (int k = 0; k < SMOOTHED; k++) {
        ptrdiff_t j = i + k - SMOOTHED / 2;
        if (j < 0) j = -j;
        if (j >= n) j = 2 * (n - 1) - j;
        double value = y[j];
        int place = k;
        for (; place > 0 && window[place - 1] > value; place--) window[place] = window[place - 1];
        window[place] = value;
    }
    return window[SMOOTHED / 2];
}

/* The chord of a run's smoothed ends. */
typedef struct {
    double x, y, slope;
} Chord;

static Chord chord_of(const double *x, const double *y, ptrdiff_t n) {
    double start = smoothed(y, n, 0), end = smoothed(y, n, n - 1);
    return (Chord){x[0], start, (end - start) / (x[n - 1] - x[0])};
}

static double chord_y(const Chord *chord, double x) { return chord->y + chord->slope * (x - chord->x); }

/* How far the smoothed run can be from its chord: a median is no farther than the farthest of its values. */
static double farthest_possible(const Chord *chord, const double *x, const double *y, ptrdiff_t n) {
    double most = 0, lean = 0;
    for (ptrdiff_t i = 0; i < n; i++) {
        double off = fabs(y[i] - chord_y(chord, x[i])), step = i ? x[i] - x[i - 1] : 0;
        most = off > most ? off : most;
        lean = step > lean ? step : lean;
    }
    return most + fabs(chord->slope) * lean * (SMOOTHED / 2);
}

/* Where the smoothed run is farthest from its chord, if by more than is allowed: else -1. Only where a value near by
   is that far need a median be looked for. */
static ptrdiff_t farthest_place(const Chord *chord, const double *x, const double *y, ptrdiff_t n, double allowed,
                                double slack) {
    ptrdiff_t where = -1, half = SMOOTHED / 2, next = 0;
    double most = allowed;
    for (ptrdiff_t j = 0; j < n; j++) {
        if (fabs(y[j] - chord_y(chord, x[j])) + slack <= allowed) continue;
        for (ptrdiff_t i = j - half > next ? j - half : next; i <= j + half && i < n; i++) {
            double bend = fabs(smoothed(y, n, i) - chord_y(chord, x[i]));
            next = i + 1;
            if (bend <= most) continue;
            most = bend;
            where = i;
        }
    }
    return where;
}

/* Standard deviation of a run's centres as the median of their second differences has it, which few jumps do not raise;
   infinite if there are too few. */
static double scatter_of(const double *y, size_t n, double *scratch) {
    size_t count = n > 2 * LAG ? n - 2 * LAG : 0;
    if (count < LEAST_DIFFERENCES) return INFINITY;
    for (size_t i = 0; i < count; i++) scratch[i] = fabs(y[i] + y[i + 2 * LAG] - 2 * y[i + LAG]);
    return 1.4826 * median(scratch, count) / sqrt(6);
}

/* Where a run is to be cut: where it is farthest from its chord, if that is far; else -1.

   `sigma`: the least that was said of the runs that it was cut from; what its own sigmas and scatter say is taken into
   account. A jump raises the sigmas of all the piece, which must not hide it. */
static ptrdiff_t kink_of(size_t first, size_t n, const Work *work, double *sigma) {
    const double *x = work->centers->x + first, *y = work->centers->y + first;
    Chord chord = chord_of(x, y, (ptrdiff_t)n);
    double most = farthest_possible(&chord, x, y, (ptrdiff_t)n);
    if (most <= work->rules->kink) return -1;
    memcpy(work->scratch, work->centers->sigma + first, n * sizeof(double));
    *sigma = fmin(*sigma, median(work->scratch, n));
    *sigma = fmin(*sigma, scatter_of(y, n, work->scratch));
    double allowed = work->rules->kink + 1.5 * *sigma, lean = 0;
    if (most <= allowed) return -1;
    for (size_t i = 1; i < n; i++) lean = x[i] - x[i - 1] > lean ? x[i] - x[i - 1] : lean;
    double slack = fabs(chord.slope) * lean * (SMOOTHED / 2);
    return farthest_place(&chord, x, y, (ptrdiff_t)n, allowed, slack);
}

/* Cuts a piece where it is farthest from its chord (Ramer), as long as that is far. */
static int cut(size_t first, size_t last, double sigma, double laser, const Work *work, Drafts *drafts) {
    size_t n = last - first;
    if (n < work->rules->minimum) return 1;
    ptrdiff_t where = kink_of(first, n, work, &sigma);
    if (where >= 0) {
        size_t at = (size_t)(where < 1 ? 1 : where > (ptrdiff_t)n - 1 ? (ptrdiff_t)n - 1 : where);
        return cut(first, first + at, sigma, laser, work, drafts) && cut(first + at, last, sigma, laser, work, drafts);
    }
    Draft draft = {.first = {first}, .last = {last}, .blocks = 1};
    draft.track.laser = laser;
    fit_line(&draft, work);
    return push(drafts, &draft);
}

static double sigma_at(const Track *track, double x) { return line_sigma(track, x, middle_sigma(track, 0, 2)); }

/* Whether the second track lies on the first one's line, not too far beyond its end. */
static int continues(const Track *first, const Track *second, const TrackRules *rules) {
    double gap = second->x_start - first->x_end;
    double length = first->x_end - first->x_start, other = second->x_end - second->x_start;
    if (first->laser != second->laser || !(gap >= 0) || gap > fmax(12, 0.5 * fmin(length, other))) return 0;
    double middle = (first->x_end + second->x_start) / 2;
    double apart = fabs(line_y(first, middle) - line_y(second, middle));
    double turned = fabs(first->slope - second->slope) * fmin(fmin(length, other), fmax(length, other) / 2) / 2;
    double allowed = rules->joined + 2 * hypot(sigma_at(first, middle), sigma_at(second, middle));
    return fmax(apart, turned) < allowed;
}

static int by_start(const void *first, const void *second) {
    const Draft *a = first, *b = second;
    if (a->track.x_start != b->track.x_start) return a->track.x_start < b->track.x_start ? -1 : 1;
    return (a->first[0] > b->first[0]) - (a->first[0] < b->first[0]);
}

/* Makes one track of those that continue each other; tracks that went into another have no blocks left. */
static int join(Drafts *drafts, const Work *work) {
    if (drafts->used) qsort(drafts->data, drafts->used, sizeof *drafts->data, by_start);
    Drafts joined = {NULL, 0, 0};
    for (size_t i = 0; i < drafts->used; i++) {
        Draft draft = drafts->data[i];
        for (size_t j = joined.used; j-- > 0;) {
            Draft *partner = &joined.data[j];
            if (!partner->blocks || partner->blocks + draft.blocks > BLOCKS) continue;
            if (!continues(&partner->track, &draft.track, work->rules)) continue;
            Draft both = *partner;
            both.first[both.blocks] = draft.first[0];
            both.last[both.blocks++] = draft.last[0];
            partner->blocks = 0;
            fit_line(&both, work);
            draft = both;
            break;
        }
        if (!push(&joined, &draft)) {
            free(joined.data);
            return 0;
        }
    }
    free(drafts->data);
    *drafts = joined;
    return 1;
}

Track *straight_tracks(const Centers *centers, const TrackRules *rules, size_t *count) {
    size_t n = centers->n ? centers->n : 1;
    double *memory = malloc(4 * n * sizeof *memory);
    Work work = {centers, rules, memory, memory + n, memory + 2 * n, memory + 3 * n};
    Drafts drafts = {NULL, 0, 0};
    Track *tracks = NULL;
    int done = memory != NULL;
    for (size_t first = 0, last; done && first < centers->n; first = last) {
        for (last = first + 1; last < centers->n && centers->piece[last] == centers->piece[first];) last++;
        done = cut(first, last, INFINITY, (double)centers->laser[centers->piece[first]], &work, &drafts);
    }
    if (done && join(&drafts, &work) && count_spilt(drafts.data, drafts.used, &work)) {
        tracks = malloc((drafts.used ? drafts.used : 1) * sizeof *tracks);
        *count = 0;
        for (size_t i = 0; tracks && i < drafts.used; i++)
            if (drafts.data[i].blocks) tracks[(*count)++] = drafts.data[i].track;
    }
    free(drafts.data);
    free(memory);
    return tracks;
}
