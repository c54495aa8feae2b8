/* Centres on a track's line beyond its ends. */
#include "drafts.h"

#include <math.h>
#include <stdlib.h>

#include "kernels.h"

/* Centres by column: those of column c are start[c] to start[c + 1]. */
typedef struct {
    double *x, *y, *laser;
    int32_t *start;
    size_t columns;
} ByColumn;

static size_t column_of(double x, const Work *work) {
    double width = work->rules->width;
    return (size_t)(x < 0 ? 0 : x < width ? x : width);
}

static int sort_by_column(const Work *work, ByColumn *sorted) {
    const Centers *c = work->centers;
    sorted->columns = (size_t)work->rules->width + 1;
    sorted->x = malloc(3 * c->n * sizeof(double) + 1);
    sorted->start = calloc(sorted->columns + 2, sizeof(int32_t));
    if (sorted->x == NULL || sorted->start == NULL) return 0;
    sorted->y = sorted->x + c->n;
    sorted->laser = sorted->y + c->n;
    int32_t *next = sorted->start + 1; /* one ahead: where the next centre of a column goes */
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

/* How many centres lie on a track's line between two columns. */
static double on_line(const Track *track, double from, double to, const ByColumn *sorted, const Work *work) {
    const double *restrict x = sorted->x, *restrict y = sorted->y, *restrict laser = sorted->laser;
    double own = track->laser, middle_x = track->middle_x, middle_y = track->middle_y, slope = track->slope;
    double limit = work->rules->on_line;
    size_t first = (size_t)sorted->start[column_of(from, work)];
    size_t end = (size_t)sorted->start[column_of(to, work) + 1];
    int count = 0;
    for (size_t i = first; i < end; i++)
        count += (x[i] > from) & (x[i] < to) & ((own < 0) | (laser[i] == own)) &
                 (fabs(y[i] - (middle_y + slope * (x[i] - middle_x))) < limit);
    return count;
}

int count_spilt(Draft *drafts, size_t count, const Work *work) {
    ByColumn sorted = {0};
    int done = sort_by_column(work, &sorted);
    for (size_t t = 0; done && t < count; t++) {
        Track *track = &drafts[t].track;
        double length = track->x_end - track->x_start, reach = (length < 100 ? length : 100) + 40;
        track->spilt = on_line(track, track->x_start - reach, track->x_start - 2, &sorted, work) +
                       on_line(track, track->x_end + 2, track->x_end + reach, &sorted, work);
    }
    free(sorted.x);
    free(sorted.start);
    return done;
}

