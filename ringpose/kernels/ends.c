/* Where stripes end: the edges that fit best, of one blur, and how well they are known. Twin: reference_ends.py. */
#include "ends.h"

#include <math.h>
#include <stdlib.h>

#include "end_fits.h"
#include "normal_cdf.h"

/* One end in the making. */
typedef struct {
    int fitted;
    double near; /* column */
    Columns columns;
    EdgeFit fit;
} Draft;

static int least(const double *cost, int count) {
    int k = 0;
    for (int s = 1; s < count; s++)
        if (cost[s] < cost[k]) k = s;
    return k;
}

/* Number of the width that suits all ends of an image best: one lens blurs them. */
static int common_width(const Draft *draft, size_t ends, const EndRules *rules) {
    double excess[SHARP_WIDTHS] = {0};
    for (size_t i = 0; i < ends; i++) {
        if (!draft[i].fitted) continue;
        const double *cost = draft[i].fit.cost;
        double lowest = cost[least(cost, SHARP_WIDTHS)];
        for (int s = 0; s < SHARP_WIDTHS; s++) excess[s] += fmin(cost[s] - lowest, rules->most_excess);
    }
    return least(excess, SHARP_WIDTHS);
}

/* By how much widths beyond that of the stripe's section explain all ends of an image better; of a ring's edges one
   is made like the other. */
static double bluntness(const Draft *draft, size_t ends) {
    double gain = 0;
    for (size_t i = 0; i < ends; i++) {
        if (!draft[i].fitted) continue;
        const double *cost = draft[i].fit.cost;
        gain += cost[least(cost, SHARP_WIDTHS)] - cost[least(cost, WIDTHS)];
    }
    return gain;
}

/* Variance about a level of what neighbours share; what each column has of its own shows in their differences. */
static double slow_variance(const double *value, int count, double level) {
    double square = 0, difference = 0;
    if (count < 3) return 0;
    for (int i = 0; i < count; i++) {
        square += (value[i] - level) * (value[i] - level);
        if (i) difference += (value[i] - value[i - 1]) * (value[i] - value[i - 1]);
    }
    return fmax(square / count - 0.5 * difference / (count - 1), 0);
}

typedef struct {
    double position, width, outside, hidden;
} Edge;

/* What all ends of an image say about their widths. */
typedef struct {
    int common;
    double bluntness;
} Blur;

/* Relative variance of the levels on both sides of an edge that neighbouring columns share: speckle, what lies beneath. */
static double slow_levels(const Columns *columns, const Edge *edge, double speckle, const EndRules *rules) {
    double full[MOST_COLUMNS], beyond[MOST_COLUMNS];
    int inner = 0, outer = 0;
    for (int i = 0; i < columns->count; i++) {
        double from = columns->along[i] - edge->position, value = columns->amplitude[i];
        if (columns->along[i] < edge->position - 3 * edge->width)
            full[inner++] = value / fmax(columns->headroom[i], rules->least_headroom) / columns->level;
        if (columns->along[i] > edge->position + 3 * edge->width && from < rules->near_columns)
            beyond[outer++] = value / columns->level;
    }
    double inside = fmax(fmax(speckle, slow_variance(full, inner, 1)), edge->hidden * edge->hidden);
    return inside + slow_variance(beyond, outer, edge->outside);
}

/* Variance of an edge's position along the columns. */
static double edge_variance(const Columns *columns, const Edge *edge, const EndRules *rules) {
    double information = 0, beneath = 0, width = edge->width, level = columns->level;
    for (int i = 0; i < columns->count; i++) {
        double t = (edge->position - columns->along[i]) / width, head = columns->headroom[i];
        double slope = level * exp(-0.5 * t * t) / (width * 2.5066282746310002) * head * (1 - edge->outside);
        double variance = column_variance(columns, i, head * normal_cdf(t));
        information += slope * slope / variance;
        beneath += slope * sqrt(columns->texture[i]) / variance;
    }
    double ratio = columns->noise / level, contrast = columns->contrast * columns->contrast;
    double speckle = fmax(contrast - ratio * ratio, 0), grain = rules->grain_factor * width;
    information = fmax(information, 1e-12);
    beneath /= information;
    return (1 + (rules->speckle_columns - 1) * speckle / contrast) / information + beneath * beneath +
           slow_levels(columns, edge, speckle, rules) * grain * grain + rules->shape_sigma * rules->shape_sigma;
}

/* Share of the last six columns before an edge with a saturated pixel. */
static double saturated_share(const Columns *columns, double position) {
    double last = 0, saturated = 0;
    for (int i = 0; i < columns->count; i++)
        if (columns->along[i] > position - 6 && columns->along[i] < position) {
            last += 1;
            saturated += columns->saturated[i];
        }
    return last > 0 ? saturated / last : 0;
}

/* Whether an end is as wide as the stripe's section or wider, in an image where some are wider. */
static int is_blunt(const EdgeFit *fit, const Blur *blur, const EndRules *rules) {
    return blur->bluntness > rules->blunt_gain && least(fit->cost, WIDTHS) >= SHARP_WIDTHS - 1;
}

/* Which width an end has: its own if that is blunt, else near the common one. */
static int chosen_width(const EdgeFit *fit, const Blur *blur, const EndRules *rules) {
    double cost[SHARP_WIDTHS];
    for (int s = 0; s < SHARP_WIDTHS; s++) {
        double unlike = log(WIDTH[s] / WIDTH[blur->common]) / rules->width_spread;
        cost[s] = fit->cost[s] + 0.5 * unlike * unlike;
    }
    return is_blunt(fit, blur, rules) ? least(fit->cost, WIDTHS) : least(cost, SHARP_WIDTHS);
}

static StripeEnd end_of(const Draft *draft, const Profile *profile, int outward, const Blur *blur,
                        const EndRules *rules) {
    int k = chosen_width(&draft->fit, blur, rules), blunt = is_blunt(&draft->fit, blur, rules);
    Edge edge = {draft->fit.position[k], WIDTH[k] * profile->sigma, draft->fit.outside[k], 0};
    double saturated = saturated_share(&draft->columns, edge.position);
    if (saturated > rules->saturated_share) edge.hidden = rules->hidden_speckle;
    double variance = edge_variance(&draft->columns, &edge, rules);
    if (blunt) variance += edge.width * edge.width;
    double x = draft->near + outward * edge.position;
    return (StripeEnd){x,
                       line_y(profile, x),
                       line_y(profile, x + 0.5) - line_y(profile, x - 0.5),
                       sqrt(variance),
                       edge.outside,
                       saturated,
                       edge.width,
                       profile->sigma,
                       blunt,
                       profile->beneath};
}

/* Reads a line's profile and fits an edge at both its ends; 0 without memory. */
static int draft_ends(const Images *images, const StripeLine *line, const Lens *lens, const EndRules *rules,
                      Profile *profile, Draft draft[2]) {
    int read = read_profile(images, line, lens, rules, profile);
    for (int side = 0; read > 0 && side < 2; side++) {
        int outward = side ? 1 : -1;
        ptrdiff_t near = reached(profile, side ? profile->face_last : profile->face_first, outward, rules);
        draft[side].near = (double)(profile->first + near);
        draft[side].fitted = gather_columns(profile, near, outward, rules, &draft[side].columns);
        if (draft[side].fitted) fit_edge(&draft[side].columns, profile->sigma, &draft[side].fit);
    }
    return read >= 0;
}

int stripe_ends(const Images *images, const StripeLine *line, size_t lines, const Lens *lens, const EndRules *rules,
                StripeEnd *end) {
    Profile *profile = calloc(lines ? lines : 1, sizeof *profile);
    Draft *draft = calloc(lines ? 2 * lines : 1, sizeof *draft);
    int done = profile && draft;
    for (size_t i = 0; done && i < lines; i++)
        done = draft_ends(images, &line[i], lens, rules, &profile[i], &draft[2 * i]);
    Blur blur = {0, 0};
    if (done) blur = (Blur){common_width(draft, 2 * lines, rules), bluntness(draft, 2 * lines)};
    for (size_t k = 0; done && k < 2 * lines; k++) {
        const Profile *own = &profile[k / 2];
        double sigma = own->face_last > own->face_first ? own->sigma : NAN;
        double beneath = own->face_last > own->face_first ? own->beneath : NAN;
        end[k] = (StripeEnd){NAN, NAN, NAN, NAN, NAN, NAN, NAN, sigma, NAN, beneath};
        if (draft[k].fitted) end[k] = end_of(&draft[k], own, k % 2 ? 1 : -1, &blur, rules);
    }
    for (size_t i = 0; profile && i < lines; i++) free_profile(&profile[i]);
    free(profile);
    free(draft);
    return done;
}
