/* Straight segments: pieces of stripe centres are split at their kinks and joined across gaps; lines are fitted to them,
   with the correlation length of the residuals; and centres on a line beyond its ends are counted. */
#include "arguments.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "kernels.h"
#include "median.h"
#include "stripe_segments.h"

/* A piece must be at least as long as half the window of the running median. */
#define SEGMENT_PARAMS(REAL, COUNT)                                                                                   \
    COUNT(image_width, 1, 1000000)                                                                                  \
    REAL(border_px, FINITE)                                                                                         \
    REAL(kink_px, NOT_NEGATIVE)                                                                                     \
    REAL(joined_px, FINITE)                                                                                         \
    REAL(short_series, FINITE)                                                                                      \
    REAL(on_line_px, FINITE)                                                                                        \
    COUNT(min_columns, 4, INT32_MAX)
RECORD_STRUCT(SegmentParams, SEGMENT_PARAMS);
RECORD(SegmentParams, SEGMENT_PARAMS);
TABLE(Segment, SEGMENT_COLUMNS);

typedef struct {
    size_t n;
    const double *column; /* distorted */
    const double *x, *y;  /* undistorted */
    const double *sigma;
    const int64_t *piece, *laser; /* of each centre; of each piece */
} Centers;

/* Largest number of runs of neighbouring centres in one segment. */
enum { BLOCKS = 8 };

/* A segment and its runs of centres, in ascending x. */
typedef struct {
    Segment segment;
    size_t first[BLOCKS], last[BLOCKS], blocks; /* last is one beyond */
} Draft;

typedef struct {
    const Centers *centers;
    const SegmentParams *params;
    double *x, *y, *residual, *scratch; /* room for all centres */
} Work;

/* Partial sums, as a vector register holds them. */
enum { PARTS = 4 };

/* Copies the centres of all runs into one array; returns their number. */
static size_t gather(const Draft *draft, const double *from, double *to) {
    size_t n = 0;
    for (size_t b = 0; b < draft->blocks; b++) {
        size_t length = draft->last[b] - draft->first[b];
        memcpy(to + n, from + draft->first[b], length * sizeof *to);
        n += length;
    }
    return n;
}

/* Sum of value[i] value[i + lag]. */
static double sum_of_lagged_products(const double *value, size_t n, size_t lag) {
    const double *other = value + lag;
    double sum[PARTS] = {0};
    size_t pairs = n - lag, i = 0;
    for (; i + PARTS <= pairs; i += PARTS)
        for (size_t j = 0; j < PARTS; j++) sum[j] += value[i + j] * other[i + j];
    for (; i < pairs; i++) sum[0] += value[i] * other[i];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* Integrated autocorrelation, 1 + 2 sum_l rho(l) up to the first lag at which it is not positive, corrected for the
   bias of short series. */
static double correlation_columns(double *residual, size_t n, const SegmentParams *params) {
    double mean = 0, columns = 1;
    for (size_t i = 0; i < n; i++) mean += residual[i];
    mean /= (double)n;
    for (size_t i = 0; i < n; i++) residual[i] -= mean;
    double variance = fmax(sum_of_lagged_products(residual, n, 0), 1e-12);
    for (size_t lag = 1; lag < n / 3; lag++) {
        double correlation = sum_of_lagged_products(residual, n, lag) / variance;
        if (!(correlation > 0)) break;
        columns += 2 * correlation;
    }
    return 1 + params->short_series * (columns - 1);
}

/* GNU C vectors: compilers do not reorder floating-point sums by themselves. */
typedef double Doubles __attribute__((vector_size(8 * PARTS), aligned(8), may_alias));
typedef int64_t Masks __attribute__((vector_size(8 * PARTS), aligned(8), may_alias));
#define DOUBLES(address) (*(const Doubles *)(address))

/* Moments about an origin of the centres whose residual is below a limit. */
typedef struct {
    Doubles count, x, y, xx, xy;
} Sums;

static void add_inliers(const double *x, const double *y, const double *residual, size_t n, double limit, size_t origin,
                        Sums *sums) {
    double origin_x = x[origin], origin_y = y[origin];
    const Doubles one = {1, 1, 1, 1};
    Sums s = {{0}, {0}, {0}, {0}, {0}};
    size_t whole = n - n % PARTS;
    for (size_t i = 0; i < whole; i += PARTS) {
        Doubles weight = (Doubles)((DOUBLES(residual + i) < limit) & (Masks)one);
        Doubles dx = DOUBLES(x + i) - origin_x, dy = DOUBLES(y + i) - origin_y, weighted = weight * dx;
        s.count += weight;
        s.x += weighted;
        s.y += weight * dy;
        s.xx += weighted * dx;
        s.xy += weighted * dy;
    }
    for (size_t i = whole; i < n; i++) {
        double weight = residual[i] < limit ? 1 : 0, dx = x[i] - origin_x, dy = y[i] - origin_y;
        s.count[0] += weight;
        s.x[0] += weight * dx;
        s.y[0] += weight * dy;
        s.xx[0] += weight * dx * dx;
        s.xy[0] += weight * dx * dy;
    }
    *sums = s;
}

static double total(const Doubles *part) { return ((*part)[0] + (*part)[1]) + ((*part)[2] + (*part)[3]); }

/* Distances from a segment's line. */
static void find_residuals(const Segment *segment, const double *restrict x, const double *restrict y, size_t n,
                           double *restrict residual) {
    double middle_x = segment->middle_x, middle_y = segment->middle_y, slope = segment->slope;
    for (size_t i = 0; i < n; i++) residual[i] = fabs(y[i] - middle_y - slope * (x[i] - middle_x));
}

/* The line through a draft's centres, by two rounds of least squares, the second without outliers. */
static void fit_line(Draft *draft, const Work *work) {
    Segment *segment = &draft->segment;
    double *x = work->x, *y = work->y, *r = work->residual, limit = INFINITY;
    size_t n = gather(draft, work->centers->x, x);
    gather(draft, work->centers->y, y);
    memset(r, 0, n * sizeof *r);
    const size_t cut = cut_centres(n);
    for (int round = 0; round < 2; round++) {
        Sums sums;
        add_inliers(x + cut, y + cut, r + cut, n - 2 * cut, limit, n / 2 - cut, &sums);
        double count = total(&sums.count), sum_x = total(&sums.x), sum_y = total(&sums.y);
        segment->slope = (total(&sums.xy) - sum_x * sum_y / count) / (total(&sums.xx) - sum_x * sum_x / count);
        segment->middle_x = x[n / 2] + sum_x / count;
        segment->middle_y = y[n / 2] + sum_y / count;
        find_residuals(segment, x, y, n, r);
        memcpy(work->scratch, r, n * sizeof *r);
        segment->scatter = fmax(1.4826 * median(work->scratch, n), 0.01);
        limit = 3 * segment->scatter;
    }
    size_t inliers = 0;
    for (size_t i = 0; i < n; i++) {
        work->scratch[inliers] = y[i] - segment->middle_y - segment->slope * (x[i] - segment->middle_x);
        inliers += r[i] < limit;
    }
    segment->correlation = correlation_columns(work->scratch, inliers, work->params);
    segment->centers = (double)n;
    segment->x_start = x[0];
    segment->x_end = x[n - 1];
    double left = work->centers->column[draft->first[0]];
    double right = work->centers->column[draft->last[draft->blocks - 1] - 1];
    double border = work->params->border_px, width = work->params->image_width;
    segment->clipped = left < border || left > width - 1 - border || right < border || right > width - 1 - border;
}

/* Centres by column: those of column c are start[c] to start[c + 1]. */
typedef struct {
    double *x, *y, *laser;
    int32_t *start;
    size_t columns;
} ByColumn;

static size_t column_of(double x, const Work *work) {
    double width = work->params->image_width;
    return (size_t)(x < 0 ? 0 : x < width ? x : width);
}

static int sort_by_column(const Work *work, ByColumn *sorted) {
    const Centers *c = work->centers;
    sorted->columns = (size_t)work->params->image_width + 1;
    sorted->x = malloc(3 * c->n * sizeof(double) + 1);
    sorted->start = calloc(sorted->columns + 2, sizeof(int32_t));
    if (sorted->x == NULL || sorted->start == NULL) return 0;
    sorted->y = sorted->x + c->n;
    sorted->laser = sorted->y + c->n;
    int32_t *next = sorted->start + 1; /* one ahead: index of the next centre of a column */
    for (size_t i = 0; i < c->n; i++) next[column_of(c->x[i], work) + 1]++;
    for (size_t column = 0; column < sorted->columns; column++) next[column + 1] += next[column];
    for (size_t i = 0; i < c->n; i++) {
        size_t at = (size_t)next[column_of(c->x[i], work)]++;
        sorted->x[at] = c->x[i];
        sorted->y[at] = c->y[i];
        sorted->laser[at] = (double)c->laser[c->piece[i]];
    }
    return 1;
}

/* Number of centres on a segment's line between two columns. */
static double count_on_line(const Segment *segment, double from, double to, const ByColumn *sorted, const Work *work) {
    const double *restrict x = sorted->x, *restrict y = sorted->y, *restrict laser = sorted->laser;
    double own = segment->laser, middle_x = segment->middle_x, middle_y = segment->middle_y, slope = segment->slope;
    double limit = work->params->on_line_px;
    size_t first = (size_t)sorted->start[column_of(from, work)];
    size_t end = (size_t)sorted->start[column_of(to, work) + 1];
    int count = 0;
    for (size_t i = first; i < end; i++)
        count += (x[i] > from) & (x[i] < to) & ((own < 0) | (laser[i] == own)) &
                 (fabs(y[i] - (middle_y + slope * (x[i] - middle_x))) < limit);
    return count;
}

/* Counts, for every segment, the centres on its line beyond its ends. 0 if there is no memory. */
static int count_beyond_ends(Draft *drafts, size_t count, const Work *work) {
    ByColumn sorted = {0};
    int done = sort_by_column(work, &sorted);
    for (size_t t = 0; done && t < count; t++) {
        Segment *segment = &drafts[t].segment;
        double length = segment->x_end - segment->x_start, reach = (length < 100 ? length : 100) + 40;
        segment->before_start = count_on_line(segment, segment->x_start - reach, segment->x_start - 2, &sorted, work);
        segment->after_end = count_on_line(segment, segment->x_end + 2, segment->x_end + reach, &sorted, work);
    }
    free(sorted.x);
    free(sorted.start);
    return done;
}

/* Length of the running median. */
enum { SMOOTHED = 7 };

/* Lag at which the speckle of two centres is independent, and fewest differences for an estimate of the scatter. */
enum { LAG = 4, MIN_DIFFERENCES = 8 };

static int push(List *drafts, const Draft *draft) {
    if (!reserve(drafts, 1)) return 0;
    ((Draft *)drafts->data)[drafts->used++] = *draft;
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

/* Chord between the smoothed ends of a run. */
typedef struct {
    double x, y, slope;
} Chord;

static Chord chord_of(const double *x, const double *y, ptrdiff_t n) {
    double start = smoothed(y, n, 0), end = smoothed(y, n, n - 1);
    return (Chord){x[0], start, (end - start) / (x[n - 1] - x[0])};
}

static double chord_y(const Chord *chord, double x) { return chord->y + chord->slope * (x - chord->x); }

/* Upper bound of the distance of the smoothed run from its chord: that of the farthest value. */
static double max_possible_distance(const Chord *chord, const double *x, const double *y, ptrdiff_t n) {
    double maximum = 0, max_step = 0;
    for (ptrdiff_t i = 0; i < n; i++) {
        double off = fabs(y[i] - chord_y(chord, x[i])), step = i ? x[i] - x[i - 1] : 0;
        maximum = off > maximum ? off : maximum;
        max_step = step > max_step ? step : max_step;
    }
    return maximum + fabs(chord->slope) * max_step * (SMOOTHED / 2);
}

/* Index at which the smoothed run is farthest from its chord, or -1 if by no more than `allowed`. Medians are computed
   only near values that are that far away. */
static ptrdiff_t farthest_index(const Chord *chord, const double *x, const double *y, ptrdiff_t n, double allowed,
                                double slack) {
    ptrdiff_t where = -1, half = SMOOTHED / 2, next = 0;
    double maximum = allowed;
    for (ptrdiff_t j = 0; j < n; j++) {
        if (fabs(y[j] - chord_y(chord, x[j])) + slack <= allowed) continue;
        for (ptrdiff_t i = j - half > next ? j - half : next; i <= j + half && i < n; i++) {
            double bend = fabs(smoothed(y, n, i) - chord_y(chord, x[i]));
            next = i + 1;
            if (bend <= maximum) continue;
            maximum = bend;
            where = i;
        }
    }
    return where;
}

/* Robust standard deviation of a run's centres, from the median of second differences; infinite if there are
   too few. */
static double scatter_of(const double *y, size_t n, double *scratch) {
    size_t count = n > 2 * LAG ? n - 2 * LAG : 0;
    if (count < MIN_DIFFERENCES) return INFINITY;
    for (size_t i = 0; i < count; i++) scratch[i] = fabs(y[i] + y[i + 2 * LAG] - 2 * y[i + LAG]);
    return 1.4826 * median(scratch, count) / sqrt(6);
}

/* Index at which a run is split, or -1 if it is straight.

   `sigma` is the smallest estimate so far, including those of the longer runs that contained this one: a jump raises
   the sigmas of the whole piece, which must not hide it. */
static ptrdiff_t kink_index(size_t first, size_t n, const Work *work, double *sigma) {
    const double *x = work->centers->x + first, *y = work->centers->y + first;
    Chord chord = chord_of(x, y, (ptrdiff_t)n);
    double maximum = max_possible_distance(&chord, x, y, (ptrdiff_t)n);
    if (maximum <= work->params->kink_px) return -1;
    memcpy(work->scratch, work->centers->sigma + first, n * sizeof(double));
    *sigma = fmin(*sigma, median(work->scratch, n));
    *sigma = fmin(*sigma, scatter_of(y, n, work->scratch));
    double allowed = work->params->kink_px + 1.5 * *sigma, max_step = 0;
    if (maximum <= allowed) return -1;
    for (size_t i = 1; i < n; i++) max_step = x[i] - x[i - 1] > max_step ? x[i] - x[i - 1] : max_step;
    double slack = fabs(chord.slope) * max_step * (SMOOTHED / 2);
    return farthest_index(&chord, x, y, (ptrdiff_t)n, allowed, slack);
}

/* Splits a piece recursively where it is farthest from its chord (Ramer-Douglas-Peucker). */
static int cut(size_t first, size_t last, double sigma, double laser, const Work *work, List *drafts) {
    size_t n = last - first;
    if ((double)n < work->params->min_columns) return 1;
    ptrdiff_t where = kink_index(first, n, work, &sigma);
    if (where >= 0) {
        size_t at = (size_t)(where < 1 ? 1 : where > (ptrdiff_t)n - 1 ? (ptrdiff_t)n - 1 : where);
        return cut(first, first + at, sigma, laser, work, drafts) && cut(first + at, last, sigma, laser, work, drafts);
    }
    Draft draft = {.first = {first}, .last = {last}, .blocks = 1};
    draft.segment.laser = laser;
    fit_line(&draft, work);
    return push(drafts, &draft);
}

static double sigma_at(const Segment *segment, double x) { return line_sigma(segment, x, middle_sigma(segment, 0, 2)); }

/* True if the second segment continues the line of the first after a short gap. */
static int continues(const Segment *first, const Segment *second, const SegmentParams *params) {
    double gap = second->x_start - first->x_end;
    double length = first->x_end - first->x_start, other = second->x_end - second->x_start;
    if (first->laser != second->laser || !(gap >= 0) || gap > fmax(12, 0.5 * fmin(length, other))) return 0;
    double middle = (first->x_end + second->x_start) / 2;
    double apart = fabs(line_y(first, middle) - line_y(second, middle));
    double turned = fabs(first->slope - second->slope) * fmin(fmin(length, other), fmax(length, other) / 2) / 2;
    double allowed = params->joined_px + 2 * hypot(sigma_at(first, middle), sigma_at(second, middle));
    return fmax(apart, turned) < allowed;
}

static int by_start(const void *first, const void *second) {
    const Draft *a = first, *b = second;
    if (a->segment.x_start != b->segment.x_start) return a->segment.x_start < b->segment.x_start ? -1 : 1;
    return (a->first[0] > b->first[0]) - (a->first[0] < b->first[0]);
}

/* Joins segments that continue each other; segments that were joined to another one keep no blocks. */
static int join(List *drafts, const Work *work) {
    if (drafts->used) qsort(drafts->data, drafts->used, sizeof(Draft), by_start);
    List joined = {NULL, 0, 0, sizeof(Draft)};
    for (size_t i = 0; i < drafts->used; i++) {
        Draft draft = ((Draft *)drafts->data)[i];
        for (size_t j = joined.used; j-- > 0;) {
            Draft *partner = (Draft *)joined.data + j;
            if (!partner->blocks || partner->blocks + draft.blocks > BLOCKS) continue;
            if (!continues(&partner->segment, &draft.segment, work->params)) continue;
            Draft both = *partner;
            both.first[both.blocks] = draft.first[0];
            both.last[both.blocks++] = draft.last[0];
            partner->blocks = 0;
            fit_line(&both, work);
            draft = both;
            break;
        }
        if (!push(&joined, &draft)) {
            release(&joined);
            return 0;
        }
    }
    release(drafts);
    *drafts = joined;
    return 1;
}

/* Returns 0 if there is no memory. */
static int find_segments(const Centers *centers, const SegmentParams *params, List *segments) {
    size_t n = centers->n ? centers->n : 1;
    double *memory = malloc(4 * n * sizeof *memory);
    Work work = {centers, params, memory, memory + n, memory + 2 * n, memory + 3 * n};
    List drafts = {NULL, 0, 0, sizeof(Draft)};
    int done = memory != NULL;
    for (size_t first = 0, last; done && first < centers->n; first = last) {
        for (last = first + 1; last < centers->n && centers->piece[last] == centers->piece[first];) last++;
        done = cut(first, last, INFINITY, (double)centers->laser[centers->piece[first]], &work, &drafts);
    }
    done = done && join(&drafts, &work) && count_beyond_ends(drafts.data, drafts.used, &work) &&
           reserve(segments, drafts.used);
    const Draft *draft = drafts.data;
    for (size_t i = 0; done && i < drafts.used; i++)
        if (draft[i].blocks) ((Segment *)segments->data)[segments->used++] = draft[i].segment;
    release(&drafts);
    free(memory);
    return done;
}

/* True if all centres are finite, their pieces ascend from 0, and every piece has a laser. */
static int centers_in_order(const Py_buffer view[4]) {
    const double(*at)[2] = view[0].buf, *sigma = view[1].buf;
    const int64_t *piece = view[2].buf;
    for (Py_ssize_t i = 0; i < view[0].shape[0]; i++) {
        int in_order = piece[i] >= (i ? piece[i - 1] : 0) && piece[i] < view[3].shape[0];
        if (in_order && isfinite(at[i][0]) && isfinite(at[i][1]) && isfinite(sigma[i])) continue;
        PyErr_Format(PyExc_ValueError, "centers: number %zd is not finite, or its piece is out of order", i);
        return 0;
    }
    return 1;
}

static int segments_of(const Py_buffer view[4], const Lens *lens, const SegmentParams *params, List *segments) {
    const size_t n = (size_t)view[0].shape[0];
    const double(*at)[2] = view[0].buf;
    double *column = malloc((n ? 3 * n : 1) * sizeof *column);
    if (column == NULL) return 0;
    double *x = column + n, *y = x + n;
    for (size_t i = 0; i < n; i++) {
        column[i] = x[i] = at[i][0];
        y[i] = at[i][1];
    }
    undistort(lens, x, y, n);
    Centers centers = {n, column, x, y, view[1].buf, view[2].buf, view[3].buf};
    int done = find_segments(&centers, params, segments);
    free(column);
    return done;
}

PyObject *call_stripe_segments(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"position", FLOAT64, {N, 2}}, {"sigma", FLOAT64, {N}},
                                          {"piece", INT64, {N}},       {"laser", INT64, {ANY}},
                                          {"lens", &Lens_record, {0}}, {"params", &SegmentParams_record, {0}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const SegmentParams *params = (const SegmentParams *)a.number[5];
    if (!centers_in_order(a.view)) return close_arguments(&a, NULL);
    List segments = {NULL, 0, 0, sizeof(Segment)};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = segments_of(a.view, (const Lens *)a.number[4], params, &segments);
    Py_END_ALLOW_THREADS
    return close_arguments(&a, list_bytes(done, &segments));
}
