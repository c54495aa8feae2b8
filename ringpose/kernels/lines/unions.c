/* Tracks that may be one: pieces of a stripe that speckle, a glint or a bracket broke, on lines that could be the
   same. */
#include <math.h>

#include "faces.h"
#include "track_line.h"

/* Whether the second track, which lies to the right, can be on the first one's line. */
static int meet(const Track *first, const Track *second, const UnionRules *rules) {
    double gap = second->x_start - first->x_end;
    double lengths = first->x_end - first->x_start + second->x_end - second->x_start;
    if (first->laser != second->laser || !(gap > 0 && gap <= rules->longest_gap * lengths)) return 0;
    double middle = first->x_end + gap / 2, apart = fabs(line_y(first, middle) - line_y(second, middle));
    if (!(apart < rules->farthest)) return 0;
    double sigma = hypot(line_sigma(first, middle, middle_sigma(first, rules->taken_by_fit, rules->least_columns)),
                         line_sigma(second, middle, middle_sigma(second, rules->taken_by_fit, rules->least_columns)));
    return apart < rules->apart + rules->apart_sigmas * sigma;
}

/* One track of both: the line and the scatter that all their centres together have. */
static Track united(const Track *first, const Track *second) {
    const Track *part[2] = {first, second};
    double count = first->count + second->count, xx = 0, xy = 0, yy = 0;
    double middle_x = (first->count * first->middle_x + second->count * second->middle_x) / count;
    double middle_y = (first->count * first->middle_y + second->count * second->middle_y) / count;
    for (int i = 0; i < 2; i++) {
        const Track *p = part[i];
        double dx = p->middle_x - middle_x, dy = p->middle_y - middle_y, length = fmax(p->x_end - p->x_start, 1);
        double own = length * length / 12;
        xx += p->count * (own + dx * dx);
        xy += p->count * (own * p->slope + dx * dy);
        yy += p->count * (own * p->slope * p->slope + p->scatter * p->scatter + dy * dy);
    }
    Track both = *first;
    both.count = count;
    both.x_end = second->x_end;
    both.middle_x = middle_x;
    both.middle_y = middle_y;
    both.slope = xy / xx;
    both.scatter = sqrt(fmax(yy - both.slope * xy, 0) / count);
    both.correlation = fmax(first->correlation, second->correlation);
    both.spilt = fmax(first->spilt - second->count, 0) + fmax(second->spilt - first->count, 0);
    return both;
}

static int add(List *list, const Track *track) {
    if (!reserve(list, 1)) return 0;
    ((Track *)list->data)[list->used++] = *track;
    return 1;
}

/* The unions of one track with all that continue it. */
static int unite(Track left, const List *pieces, const UnionRules *rules, List *unions) {
    const Track *piece = pieces->data;
    for (size_t j = 0; j < pieces->used; j++) {
        if (!meet(&left, &piece[j], rules)) continue;
        Track both = united(&left, &piece[j]);
        if (!add(unions, &both)) return 0;
    }
    return 1;
}

int unite_collinear(const Track *track, size_t count, const UnionRules *rules, List *unions) {
    List pieces = {NULL, 0, 0, sizeof *track};
    size_t first = unions->used;
    int done = 1;
    for (size_t i = 0; done && i < count; i++)
        if (track[i].spilt >= rules->least_spilt && !track[i].clipped) done = add(&pieces, &track[i]);
    const Track *piece = pieces.data;
    for (size_t i = 0; done && i < pieces.used; i++) done = unite(piece[i], &pieces, rules, unions);
    for (size_t round = 1; done && round < (size_t)rules->rounds; round++) {
        size_t last = unions->used;
        for (; done && first < last; first++) done = unite(((Track *)unions->data)[first], &pieces, rules, unions);
    }
    release(&pieces);
    return done;
}
