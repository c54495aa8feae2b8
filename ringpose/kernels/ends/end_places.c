/* Other places where a stripe may end, and what they add to its variance. */
#include "end_places.h"

#include <math.h>

#include "end_sigmas.h"

/* Steps of whole columns on either side. */
enum { STEPS = LAST_PLACE - FIRST_PLACE };

/* Minus log likelihood over that of the best column above which no place nearest to a column is looked at again. */
#define OPEN 40

/* Likelihood, as a share of the best place's, below which the model of the noise is not to be trusted. */
#define LEAST_TOLD 0.05

#define ROOT_OF_TWO_PI 2.5066282746310002
#define LEAST_SHARE 1e-3

static double least_first(const EdgeFit *fit) {
    double least = INFINITY;
    for (int k = 0; k < PLACES; k++) least = fmin(least, fit->first[k]);
    return least;
}

/* Whole columns from an edge to other places where the end may be, by the costs of the first search. */
static int open_steps(const EdgeFit *fit, const Edge *edge, double *step) {
    double most = least_first(fit) + OPEN;
    int count = 0;
    for (int k = -STEPS; k <= STEPS; k++) {
        double nearest = rint(edge->position + k) - FIRST_PLACE;
        if (k && nearest >= 0 && nearest < PLACES && fit->first[(int)nearest] < most) step[count++] = k;
    }
    return count;
}

/* By how much less columns tell one place from another than if each erred by itself. */
static double independent_share(const Columns *columns, const Edge *edge, double place, double likeness) {
    Edge outer = *edge, other = *edge;
    other.position = place;
    outer.position = fmax(place, edge->position);
    double here[MOST_COLUMNS], there[MOST_COLUMNS], shown[MOST_COLUMNS], influence[MOST_COLUMNS], alone = 0;
    show_edge(columns, edge, here);
    show_edge(columns, &other, there);
    show_edge(columns, &outer, shown);
    for (int i = 0; i < columns->count; i++) {
        double variance = column_variance(columns, i, shown[i]);
        influence[i] = (1 - edge->outside) * (here[i] - there[i]) / variance;
        alone += influence[i] * influence[i] * variance;
    }
    double together = light_noise(columns, &outer, influence, likeness);
    return fmin(alone / fmax(fmax(together, LEAST_SHARE * alone), 1e-30), 1);
}

double variance_over_places(const Columns *columns, const EdgeFit *fit, const Edge *edge, double variance,
                            double likeness) {
    double step[2 * STEPS + 1], place[2 * STEPS + 1], cost[2 * STEPS + 1];
    int count = open_steps(fit, edge, step);
    double weights = ROOT_OF_TWO_PI * sqrt(variance), squares = weights * variance;
    if (!count) return variance;
    for (int k = 0; k < count; k++) place[k] = edge->position + step[k];
    place[count] = edge->position;
    edge_costs(columns, edge->width, place, count + 1, cost);
    for (int k = 0; k < count; k++) {
        double share = independent_share(columns, edge, place[k], likeness);
        double told = exp(-fmax(cost[k] - cost[count], 0) * share), square = step[k] * step[k];
        double weight = fmax(told - exp(-0.5 * square / variance) - LEAST_TOLD, 0);
        weights += weight;
        squares += weight * square;
    }
    return squares / weights;
}
