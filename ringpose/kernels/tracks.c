/* Straight tracks: pieces cut at their kinks, joined across gaps. Twin: reference_tracks.py. */
#include "tracks.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "select.h"

enum { SMOOTHED = 7, BLOCKS = 8 };

/* A track in the making: up to BLOCKS runs of neighbouring centres, in ascending x. */
typedef struct {
    Track track;
    size_t first[BLOCKS], last[BLOCKS], blocks; /* last is one beyond */
} Draft;

typedef struct {
    Draft *data;
    size_t used, capacity;
} Drafts;

typedef struct {
    const Centers *centers;
    const TrackRules *rules;
    double *x, *y, *scratch; /* room for all centres */
} Work;

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

/* Where a run of centres is farthest from the chord of its smoothed ends, and how far; -1 if nowhere by more than
   is allowed: a median is no farther than the farthest of its values, so most runs need none. */
static double farthest_from_chord(const double *x, const double *y, ptrdiff_t n, double allowed, ptrdiff_t *where) {
    double start = smoothed(y, n, 0), end = smoothed(y, n, n - 1), most = -1, lean = 0;
    double slope = (end - start) / (x[n - 1] - x[0]);
    for (ptrdiff_t i = 0; i < n; i++) most = fmax(most, fabs(y[i] - (start + slope * (x[i] - x[0]))));
    for (ptrdiff_t i = 1; i < n; i++) lean = fmax(lean, x[i] - x[i - 1]);
    if (most + fabs(slope) * lean * (SMOOTHED / 2) <= allowed) return -1;
    most = -1;
    for (ptrdiff_t i = 0; i < n; i++) {
        double bend = fabs(smoothed(y, n, i) - (start + slope * (x[i] - x[0])));
        if (bend > most) {
            most = bend;
            *where = i;
        }
    }
    return most;
}

/* Copies a draft's centres together; returns how many. */
static size_t gather(const Draft *draft, const double *from, double *to) {
    size_t n = 0;
    for (size_t b = 0; b < draft->blocks; b++) {
        size_t length = draft->last[b] - draft->first[b];
        memcpy(to + n, from + draft->first[b], length * sizeof *to);
        n += length;
    }
    return n;
}

/* 1 + 2 times the sum of the autocorrelation, as far as it stays positive. */
static double correlation_columns(double *residual, size_t n, const TrackRules *rules) {
    double mean = 0, variance = 0, columns = 1;
    for (size_t i = 0; i < n; i++) mean += residual[i];
    mean /= (double)n;
    for (size_t i = 0; i < n; i++) {
        residual[i] -= mean;
        variance += residual[i] * residual[i];
    }
    for (size_t lag = 1; lag < rules->longest_lag && lag < n / 3; lag++) {
        double likeness = 0;
        for (size_t i = lag; i < n; i++) likeness += residual[i] * residual[i - lag];
        likeness /= fmax(variance, 1e-12);
        if (!(likeness > 0)) break;
        columns += 2 * likeness;
    }
    return rules->short_series * columns;
}

/* The line through a draft's centres, by two rounds of least squares, the second without outliers. */
static void fit(Draft *draft, const Work *work) {
    Track *track = &draft->track;
    double *x = work->x, *y = work->y, *r = work->scratch, limit = INFINITY;
    size_t n = gather(draft, work->centers->x, x);
    gather(draft, work->centers->y, y);
    track->middle_x = track->middle_y = track->slope = 0;
    for (int round = 0; round < 2; round++) {
        double count = 0, sum_x = 0, sum_y = 0, xx = 0, xy = 0, origin_x = x[n / 2], origin_y = y[n / 2];
        double lean = track->slope, shift = origin_y - track->middle_y - lean * (origin_x - track->middle_x);
        for (size_t i = 0; i < n; i++) {
            double dx = x[i] - origin_x, dy = y[i] - origin_y;
            if (round > 0 && !(fabs(dy + shift - lean * dx) < limit)) continue;
            count += 1;
            sum_x += dx;
            sum_y += dy;
            xx += dx * dx;
            xy += dx * dy;
        }
        track->slope = (xy - sum_x * sum_y / count) / (xx - sum_x * sum_x / count);
        track->middle_x = origin_x + sum_x / count;
        track->middle_y = origin_y + sum_y / count;
        for (size_t i = 0; i < n; i++) r[i] = fabs(y[i] - track->middle_y - track->slope * (x[i] - track->middle_x));
        track->scatter = fmax(1.4826 * median(r, n), 0.01);
        limit = 3 * track->scatter;
    }
    size_t inliers = 0;
    for (size_t i = 0; i < n; i++) {
        double residual = y[i] - track->middle_y - track->slope * (x[i] - track->middle_x);
        if (fabs(residual) < limit) r[inliers++] = residual;
    }
    track->correlation = correlation_columns(r, inliers, work->rules);
    track->count = (double)n;
    track->x_start = x[0];
    track->x_end = x[n - 1];
    double left = work->centers->column[draft->first[0]];
    double right = work->centers->column[draft->last[draft->blocks - 1] - 1];
    double border = work->rules->border, width = work->rules->width;
    track->clipped = left < border || left > width - 1 - border || right < border || right > width - 1 - border;
}

/* Cuts a piece where it is farthest from its chord (Ramer), as long as that is far. */
static int cut(size_t first, size_t last, double laser, const Work *work, Drafts *drafts) {
    size_t n = last - first;
    if (n < work->rules->minimum) return 1;
    const double *x = work->centers->x + first, *y = work->centers->y + first;
    memcpy(work->scratch, work->centers->sigma + first, n * sizeof(double));
    double allowed = work->rules->kink + 1.5 * median(work->scratch, n);
    ptrdiff_t where = 0;
    if (farthest_from_chord(x, y, (ptrdiff_t)n, allowed, &where) > allowed) {
        size_t at = (size_t)(where < 1 ? 1 : where > (ptrdiff_t)n - 1 ? (ptrdiff_t)n - 1 : where);
        return cut(first, first + at, laser, work, drafts) && cut(first + at, last, laser, work, drafts);
    }
    Draft draft = {.first = {first}, .last = {last}, .blocks = 1};
    draft.track.laser = laser;
    fit(&draft, work);
    return push(drafts, &draft);
}

static double line_y(const Track *track, double x) { return track->middle_y + track->slope * (x - track->middle_x); }

static double line_sigma(const Track *track, double x) {
    double n = fmax(track->count / track->correlation, 2), spread = fmax(track->x_end - track->x_start, 1) / sqrt(12);
    return track->scatter / sqrt(n) * hypot(1, (x - track->middle_x) / spread);
}

/* Whether the second track lies on the first one's line, not too far beyond its end. */
static int continues(const Track *first, const Track *second, const TrackRules *rules) {
    double gap = second->x_start - first->x_end;
    double length = first->x_end - first->x_start, other = second->x_end - second->x_start;
    if (first->laser != second->laser || !(gap >= 0) || gap > fmax(12, 0.5 * fmin(length, other))) return 0;
    double middle = (first->x_end + second->x_start) / 2;
    double apart = fabs(line_y(first, middle) - line_y(second, middle));
    double turned = fabs(first->slope - second->slope) * fmin(fmin(length, other), fmax(length, other) / 2) / 2;
    double allowed = rules->joined + 2 * hypot(line_sigma(first, middle), line_sigma(second, middle));
    return fmax(apart, turned) < allowed;
}

static int by_start(const void *first, const void *second) {
    const Draft *a = first, *b = second;
    if (a->track.x_start != b->track.x_start) return a->track.x_start < b->track.x_start ? -1 : 1;
    return (a->first[0] > b->first[0]) - (a->first[0] < b->first[0]);
}

/* Makes one track of those that continue each other; tracks that went into another have no blocks left. */
static int join(Drafts *drafts, const Work *work) {
    qsort(drafts->data, drafts->used, sizeof *drafts->data, by_start);
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
            fit(&both, work);
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

/* Adds the centres on a track's line between two columns. */
static void count_side(Track *track, double from, double to, const int32_t *head, const int32_t *next,
                       const Work *work) {
    const Centers *c = work->centers;
    double width = work->rules->width;
    size_t last = (size_t)fmin(fmax(to, 0), width);
    for (size_t column = (size_t)fmin(fmax(from, 0), width); column <= last; column++)
        for (int32_t i = head[column]; i >= 0; i = next[i]) {
            double laser = (double)c->laser[c->piece[i]];
            if (!(c->x[i] > from && c->x[i] < to) || (track->laser >= 0 && laser != track->laser)) continue;
            track->spilt += fabs(c->y[i] - line_y(track, c->x[i])) < work->rules->on_line;
        }
}

/* For every track the centres on its line that lie beyond its ends, found through lists of centres by column. */
static int count_spilt(Drafts *drafts, const Work *work) {
    const Centers *c = work->centers;
    size_t columns = (size_t)work->rules->width + 2;
    int32_t *next = malloc((c->n ? c->n : 1) * sizeof *next), *head = malloc(columns * sizeof *head);
    if (!next || !head) {
        free(next);
        free(head);
        return 0;
    }
    memset(head, -1, columns * sizeof *head);
    for (size_t i = 0; i < c->n; i++) {
        double at = fmin(fmax(c->x[i], 0), work->rules->width);
        next[i] = head[(size_t)at];
        head[(size_t)at] = (int32_t)i;
    }
    for (size_t t = 0; t < drafts->used; t++) {
        Track *track = &drafts->data[t].track;
        double length = track->x_end - track->x_start, reach = fmin(length, 100) + 40;
        count_side(track, track->x_start - reach, track->x_start - 2, head, next, work);
        count_side(track, track->x_end + 2, track->x_end + reach, head, next, work);
    }
    free(next);
    free(head);
    return 1;
}

Track *straight_tracks(const Centers *centers, const TrackRules *rules, size_t *count) {
    size_t n = centers->n ? centers->n : 1;
    Work work = {centers, rules, malloc(n * sizeof(double)), malloc(n * sizeof(double)), malloc(n * sizeof(double))};
    Drafts drafts = {NULL, 0, 0};
    Track *tracks = NULL;
    int done = work.x && work.y && work.scratch;
    for (size_t first = 0, last; done && first < centers->n; first = last) {
        for (last = first + 1; last < centers->n && centers->piece[last] == centers->piece[first];) last++;
        done = cut(first, last, (double)centers->laser[centers->piece[first]], &work, &drafts);
    }
    if (done && join(&drafts, &work) && count_spilt(&drafts, &work)) {
        tracks = malloc((drafts.used ? drafts.used : 1) * sizeof *tracks);
        *count = 0;
        for (size_t i = 0; tracks && i < drafts.used; i++)
            if (drafts.data[i].blocks) tracks[(*count)++] = drafts.data[i].track;
    }
    free(drafts.data);
    free(work.x);
    free(work.y);
    free(work.scratch);
    return tracks;
}
