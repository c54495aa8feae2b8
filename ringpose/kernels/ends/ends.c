/* Where stripes end: the edges that fit best, of one blur, and how well they are known. */
#include "ends.h"

#include <math.h>
#include <stdlib.h>

#include "end_places.h"
#include "end_sigmas.h"

/* One end in the making. */
typedef struct {
    int fitted;
    double near; /* column */
    Columns columns;
    EdgeFit fit;
} Draft;

/* What all ends of an image say. */
typedef struct {
    double likeness; /* of neighbours' speckle */
    EdgeWidth width;
    double bluntness;
} Usual;

static int least(const double *cost, int count) {
    int k = 0;
    for (int s = 1; s < count; s++)
        if (cost[s] < cost[k]) k = s;
    return k;
}

/* By how much widths beyond that of the stripe's section explain an end better. */
static double bluntness(const EdgeFit *fit, double alike) {
    return (fit->cost[least(fit->cost, SHARP_WIDTHS)] - fit->cost[least(fit->cost, WIDTHS)]) / alike;
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

/* The edge at a width, and what its position varies by. */
static double settle(const Draft *draft, double sigma, int blunt, const Usual *usual, const EndRules *rules,
                     Edge *edge) {
    EdgeWidth own = own_width(&draft->columns, &draft->fit, sigma, usual->likeness);
    EdgeWidth width = settled_width(&own, &usual->width, rules);
    *edge = edge_of_width(&draft->fit, sigma, exp(width.logarithm));
    if (blunt) {
        int k = least(draft->fit.cost, WIDTHS);
        *edge = (Edge){draft->fit.position[k], WIDTH[k] * sigma, draft->fit.outside[k], 0};
    }
    double variance = edge_variance(&draft->columns, edge, usual->likeness, width.information, rules);
    variance = variance_over_places(&draft->columns, &draft->fit, edge, variance, usual->likeness);
    return blunt ? variance + edge->width * edge->width : variance;
}

static StripeEnd end_of(const Draft *draft, const Profile *profile, int outward, const Usual *usual,
                        const EndRules *rules) {
    Edge edge;
    int blunt = usual->bluntness > rules->blunt_gain && least(draft->fit.cost, WIDTHS) >= SHARP_WIDTHS - 1;
    double variance = settle(draft, profile->sigma, blunt, usual, rules, &edge);
    double x = draft->near + outward * edge.position;
    return (StripeEnd){x,
                       line_y(profile, x),
                       line_y(profile, x + 0.5) - line_y(profile, x - 0.5),
                       sqrt(variance),
                       edge.outside,
                       saturated_share(&draft->columns, edge.position),
                       edge.width,
                       profile->sigma,
                       blunt,
                       profile->beneath};
}

/* Reads a line's profile and the columns about both its ends; 0 without memory. */
static int draft_ends(const Images *images, const StripeLine *line, const Lens *lens, const EndRules *rules,
                      Profile *profile, Draft draft[2]) {
    int read = read_profile(images, line, lens, rules, profile);
    for (int side = 0; read > 0 && side < 2; side++) {
        int outward = side ? 1 : -1;
        ptrdiff_t near = reached(profile, side ? profile->face_last : profile->face_first, outward, rules);
        draft[side].near = (double)(profile->first + near);
        draft[side].fitted = gather_columns(profile, near, outward, rules, &draft[side].columns);
    }
    return read >= 0;
}

/* Fits an edge at every end that was drafted. Of a ring's edges one is made like the other: all tell if they are
   blunt. */
static int fit_ends(const Profile *profile, Draft *draft, size_t ends, const EndRules *rules, Usual *usual) {
    Columns **columns = malloc((ends ? ends : 1) * sizeof *columns);
    EdgeWidth *width = malloc((ends ? ends : 1) * sizeof *width);
    size_t fitted = 0, found = 0;
    for (size_t k = 0; columns && k < ends; k++)
        if (draft[k].fitted) columns[fitted++] = &draft[k].columns;
    if (columns && width) usual->likeness = share_levels(columns, fitted, rules);
    for (size_t k = 0; columns && width && k < ends; k++) {
        if (!draft[k].fitted) continue;
        const Columns *own = &draft[k].columns;
        fit_edge(own, profile[k / 2].sigma, &draft[k].fit);
        width[found++] = own_width(own, &draft[k].fit, profile[k / 2].sigma, usual->likeness);
        usual->bluntness += bluntness(&draft[k].fit, columns_alike(own, usual->likeness));
    }
    if (found) usual->width = common_width(width, found, rules);
    int done = columns && width;
    free(columns);
    free(width);
    return done;
}

int stripe_ends(const Images *images, const StripeLine *line, size_t lines, const Lens *lens, const EndRules *rules,
                StripeEnd *end) {
    Profile *profile = calloc(lines ? lines : 1, sizeof *profile);
    Draft *draft = calloc(lines ? 2 * lines : 1, sizeof *draft);
    Usual usual = {0, {0, 0}, 0};
    int done = profile && draft;
    for (size_t i = 0; done && i < lines; i++)
        done = draft_ends(images, &line[i], lens, rules, &profile[i], &draft[2 * i]);
    done = done && fit_ends(profile, draft, 2 * lines, rules, &usual);
    for (size_t k = 0; done && k < 2 * lines; k++) {
        const Profile *own = &profile[k / 2];
        double sigma = own->face_last > own->face_first ? own->sigma : NAN;
        double beneath = own->face_last > own->face_first ? own->beneath : NAN;
        end[k] = (StripeEnd){NAN, NAN, NAN, NAN, NAN, NAN, NAN, sigma, NAN, beneath};
        if (draft[k].fitted) end[k] = end_of(&draft[k], own, k % 2 ? 1 : -1, &usual, rules);
    }
    for (size_t i = 0; profile && i < lines; i++) free_profile(&profile[i]);
    free(profile);
    free(draft);
    return done;
}
