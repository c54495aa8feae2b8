/* How wide the edges of an image are. */
#include "end_widths.h"

#include <math.h>

#define LEAST_INFORMATION 1e-3

enum { ROUNDS = 2 };

/* The middle of the three sharp widths that lie about number k. */
static int inner_width(int k) { return k < 1 ? 1 : k > SHARP_WIDTHS - 2 ? SHARP_WIDTHS - 2 : k; }

static int least_sharp(const double *cost) {
    int k = 0;
    for (int s = 1; s < SHARP_WIDTHS; s++)
        if (cost[s] < cost[k]) k = s;
    return k;
}

EdgeWidth own_width(const Columns *columns, const EdgeFit *fit, double sigma, double likeness) {
    int best = least_sharp(fit->cost), k = inner_width(best);
    const double *w = &WIDTH[k], *cost = &fit->cost[k];
    double before = (cost[0] - cost[-1]) / (w[0] - w[-1]), after = (cost[1] - cost[0]) / (w[1] - w[0]);
    double bend = (after - before) / (w[1] - w[-1]);
    if (!(bend > 0)) return (EdgeWidth){log(WIDTH[best] * sigma), LEAST_INFORMATION};
    double width = fmin(fmax(0.5 * (w[-1] + w[0]) - 0.5 * before / bend, w[-1]), w[1]);
    double alike = columns_alike_for_width(columns, likeness, width * sigma);
    return (EdgeWidth){log(width * sigma), fmax(2 * bend * width * width / alike, LEAST_INFORMATION)};
}

/* What an end's width says of all: it differs from the others' by itself. */
static double weight_of(const EdgeWidth *width, const EndRules *rules) {
    return 1 / (1 / width->information + rules->width_spread * rules->width_spread);
}

/* The lower of the weighted medians. */
static double middle_width(const EdgeWidth *width, size_t ends, const EndRules *rules) {
    double all = 0, middle = INFINITY;
    for (size_t i = 0; i < ends; i++) all += weight_of(&width[i], rules);
    for (size_t i = 0; i < ends; i++) {
        double below = 0;
        for (size_t j = 0; j < ends; j++)
            if (width[j].logarithm <= width[i].logarithm) below += weight_of(&width[j], rules);
        if (below >= 0.5 * all && width[i].logarithm < middle) middle = width[i].logarithm;
    }
    return middle;
}

EdgeWidth common_width(const EdgeWidth *width, size_t ends, const EndRules *rules) {
    EdgeWidth common = {middle_width(width, ends, rules), 0};
    for (int round = 0; round < ROUNDS; round++) {
        double sum = 0, weights = 0;
        for (size_t i = 0; i < ends; i++) {
            double weight = weight_of(&width[i], rules), away = width[i].logarithm - common.logarithm;
            weight /= 1 + 0.25 * weight * away * away; /* Cauchy's */
            sum += weight * width[i].logarithm;
            weights += weight;
        }
        common = (EdgeWidth){sum / weights, weights};
    }
    return common;
}

EdgeWidth settled_width(const EdgeWidth *own, const EdgeWidth *common, const EndRules *rules) {
    double others = 1 / (1 / common->information + rules->width_spread * rules->width_spread);
    double all = own->information + others;
    return (EdgeWidth){(own->logarithm * own->information + common->logarithm * others) / all, all};
}

/* The three widths about one: a parabola through what was found with them. */
Edge edge_of_width(const EdgeFit *fit, double sigma, double width) {
    double at = fmin(fmax(width / sigma, WIDTH[0]), WIDTH[SHARP_WIDTHS - 1]);
    int k = 0;
    for (int s = 1; s < SHARP_WIDTHS; s++)
        if (at * at > WIDTH[s - 1] * WIDTH[s]) k = s;
    k = inner_width(k);
    const double *w = &WIDTH[k], *position = &fit->position[k];
    double a = at - w[-1], b = at - w[0], c = at - w[1];
    double first = position[-1] / ((w[-1] - w[0]) * (w[-1] - w[1]));
    double second = position[0] / ((w[0] - w[-1]) * (w[0] - w[1]));
    double third = position[1] / ((w[1] - w[-1]) * (w[1] - w[0]));
    int low = at < w[0] ? -1 : 0;
    double share = (at - w[low]) / (w[low + 1] - w[low]);
    const double *outside = &fit->outside[k];
    return (Edge){first * b * c + second * a * c + third * a * b, at * sigma,
                  outside[low] + (outside[low + 1] - outside[low]) * share,
                  (first * (b + c) + second * (a + c) + third * (a + b)) * at};
}
