/* Covariances and flags of the ends of the ring's face. */
#include "marks.h"

#include <math.h>

#include "track_line.h"

/* Standard deviations of what a track's centres share, which does not show in their scatter: what lies beneath a stripe
   and shifts its peak by a share of itself shifts its centre by that share of its sigma; the other is that of
   clipping. */
typedef struct {
    double beneath, shared;
} Unseen;

static Unseen unseen_errors(const Track *track, const StripeEnd end[2], const MarkRules *rules) {
    double section = end[0].section_sigma, facets = track->count / (rules->facet_sigmas * section);
    int clipped = end[0].saturated > rules->saturated_share || end[1].saturated > rules->saturated_share;
    double rows = fmax(fabs(track->slope) * (track->x_end - track->x_start), 1);
    if (isnan(section)) return (Unseen){0, 0};
    return (Unseen){section * sqrt(end[0].beneath / fmax(facets, 1)), clipped ? rules->clipped_phase / section / rows : 0};
}

/* How well the middle of an edge is known: where in a chamfer the edge lies is another matter. */
static double middle_of_edge(const StripeEnd *end) {
    return end->blunt == 1 ? sqrt(fmax(end->sigma * end->sigma - end->width * end->width, 0)) : end->sigma;
}

static double flags_of(const StripeEnd *end, const MarkRules *rules) {
    int blunt = end->blunt == 1;
    return (end->saturated > rules->saturated_share ? rules->saturated : 0) +
           (end->outside > rules->kink_level ? rules->kink : 0) + (blunt ? rules->blunt : 0) +
           (middle_of_edge(end) > rules->unclear ? rules->unclear_flag : 0);
}

void clear_marks(Marks *marks) {
    for (ptrdiff_t k = 0; k < 2 * marks->lasers; k++) {
        for (int i = 0; i < 2; i++) marks->position[2 * k + i] = marks->straight[2 * k + i] = NAN;
        for (int i = 0; i < 4; i++) marks->covariance[4 * k + i] = NAN;
        marks->straight_sigma[k] = NAN;
        marks->flags[k] = 0;
    }
}

/* An end errs along its line by its own sigma, and with the line across. */
static void place(const StripeEnd *end, double across, double position[2], double covariance[4]) {
    double along = end->sigma * end->sigma;
    position[0] = end->x;
    position[1] = end->y;
    covariance[0] = along;
    covariance[1] = covariance[2] = along * end->slope;
    covariance[3] = along * end->slope * end->slope + across * across;
}

void mark_ends(const Track *track, const StripeEnd end[2], ptrdiff_t laser, const MarkRules *rules, Marks *marks) {
    Unseen unseen = unseen_errors(track, end, rules);
    double middle = fmax(middle_sigma(track, rules->taken_by_fit, rules->least_columns), unseen.beneath);
    for (int side = 0; side < 2; side++) {
        ptrdiff_t k = 2 * laser + side;
        double x = side ? track->x_end : track->x_start;
        int inside = end[side].x >= rules->border && end[side].x <= rules->width - 1 - rules->border;
        double across = hypot(line_sigma(track, end[side].x, middle), unseen.shared);
        if (inside) place(&end[side], across, marks->position + 2 * k, marks->covariance + 4 * k);
        marks->flags[k] = (int64_t)(inside ? flags_of(&end[side], rules) : rules->clipped);
        marks->straight[2 * k] = x;
        marks->straight[2 * k + 1] = line_y(track, x);
        marks->straight_sigma[k] = hypot(line_sigma(track, x, middle), unseen.shared);
    }
}
