/* Stripe endpoints: edges fitted with a pooled blur, and their variances. */
#include "arguments.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "end_sigmas.h"
#include "median.h"

RECORD(EndParams, END_PARAMS);

#define END_COLUMNS(COLUMN, COLUMNS_OF)                                                                             \
    COLUMN(x) COLUMN(y) COLUMN(slope) /* of the line there, distorted pixels */                                     \
    COLUMN(sigma)         /* along x */                                                                             \
    COLUMN(outside)       /* level outside as a share of that inside */                                             \
    COLUMN(saturated)     /* share of saturated columns at the end */                                               \
    COLUMN(width)         /* of the edge */                                                                         \
    COLUMN(section_sigma) /* of the cross-section */                                                                \
    COLUMN(blunt)         /* 1 if the edge is blunt */                                                              \
    COLUMN(background)    /* relative variance of the amplitudes due to it */
ROW_STRUCT(StripeEnd, END_COLUMNS);
TABLE(StripeEnd, END_COLUMNS);
TABLE(StripeLine, LINE_COLUMNS);

/* One end, as read from its image. */
typedef struct {
    int found, outward;
    double near;              /* column */
    double sigma, background; /* of the stripe, as in Profile; NaN without a face */
    Columns columns;
} Draft;

/* Estimates from all ends of a shot, which have the lens, and the kind of surface, in common. */
typedef struct {
    double correlation; /* of the speckle of neighbouring columns */
    EdgeWidth width;
    double blunt_gain[2]; /* left, right ends */
} Pooled;

/* Gain in log likelihood by widths larger than that of the cross-section. */
static double blunt_gain(const double cost[WIDTHS]) {
    return cost[argmin(cost, SHARP_WIDTHS)] - cost[argmin(cost, WIDTHS)];
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

/* Share of saturated columns from which an end counts as saturated. */
#define SATURATED 0.2

/* Error of a saturated end's position due to the shape of its blur, Eq. (3.12). Where the stripe is saturated, only the
   foot of the edge shows its position: 0.55 log(1 + excess) approximates by how many widths it lies before the edge, at
   that ratio of the stripe's level to what is visible of it. */
static double clipped_error(const Columns *columns, const Edge *edge, const EndParams *params) {
    double headroom[MAX_COLUMNS];
    size_t inside = 0;
    if (saturated_share(columns, edge->position) < SATURATED) return 0;
    for (int i = 0; i < columns->count; i++)
        if (columns->along[i] < edge->position) headroom[inside++] = columns->headroom[FULL][i];
    double visible = fmax(inside ? median(headroom, inside) : 1, params->min_headroom);
    double excess = fmax(1 / fmin(visible, 1), columns->level / params->saturation_dn);
    return params->clipped_shape * 0.55 * log(1 + excess) * edge->width;
}

/* The edge at the combined width; returns the variance of its position. */
static double combine_widths(const Columns *columns, const EdgeFit *fit, double sigma, int blunt, const Pooled *pooled,
                             const EndParams *params, Edge *edge) {
    EdgeWidth own = blur_width(columns, fit, sigma, pooled->correlation);
    EdgeWidth width = combined_width(&own, &pooled->width, params);
    *edge = edge_of_width(fit, sigma, exp(width.logarithm));
    if (blunt) {
        int k = argmin(fit->cost, WIDTHS);
        *edge = (Edge){fit->position[k], WIDTH[k] * sigma, fit->outside[k], 0};
    }
    double variance = edge_variance(columns, edge, pooled->correlation, width.information, params);
    if (!blunt && !columns->clipped) edge->position -= second_order_bias(columns, edge, variance);
    variance = variance_over_places(columns, fit, edge, variance, pooled->correlation);
    double clipped = clipped_error(columns, edge, params);
    variance += clipped * clipped;
    return blunt ? variance + edge->width * edge->width : variance;
}

/* The y of the stripe's line at any x; columns ascend or descend in x. */
static double line_at(const Draft *draft, double x) {
    const Columns *columns = &draft->columns;
    double at = draft->outward * (x - draft->near) - columns->along[0];
    int low = at <= 0 ? 0 : at >= columns->count - 2 ? columns->count - 2 : (int)at;
    return columns->y[low] + (columns->y[low + 1] - columns->y[low]) * (at - low);
}

static StripeEnd end_of(const Draft *draft, const EdgeFit *fit, const Pooled *pooled, const EndParams *params) {
    Edge edge;
    const Columns *columns = &draft->columns;
    int blunt = pooled->blunt_gain[draft->outward > 0] > params->blunt_gain && argmin(fit->cost, WIDTHS) >= SHARP_WIDTHS - 1;
    double variance = combine_widths(columns, fit, draft->sigma, blunt, pooled, params, &edge);
    double x = draft->near + draft->outward * edge.position;
    return (StripeEnd){x,
                       line_at(draft, x),
                       line_at(draft, x + 0.5) - line_at(draft, x - 0.5),
                       sqrt(variance),
                       edge.outside,
                       saturated_share(columns, edge.position),
                       edge.width,
                       draft->sigma,
                       blunt,
                       draft->background};
}

/* Reads a line's profile and the columns about both its ends; 0 without memory. */
static int draft_ends(const Images *images, const StripeLine *line, const Lens *lens, const EndParams *params,
                      Draft draft[2]) {
    Profile profile = {0};
    int read = read_profile(images, line, lens, params, &profile);
    for (int side = 0; side < 2; side++) {
        draft[side] = (Draft){0, side ? 1 : -1, 0, NAN, NAN, {0}};
        if (read <= 0) continue;
        ptrdiff_t near = last_undimmed(&profile, side ? profile.face_last : profile.face_first, draft[side].outward,
                                       params);
        draft[side].near = (double)(profile.first + near);
        draft[side].sigma = profile.sigma;
        draft[side].background = profile.background;
        draft[side].found = gather_columns(&profile, near, draft[side].outward, params, &draft[side].columns);
    }
    free_profile(&profile);
    return read >= 0;
}

/* Fits an edge at every end. Each edge of a ring is machined alike all around: its ends are blunt together or not. */
static int stripe_ends(Draft *draft, size_t ends, const EndParams *params, StripeEnd *end) {
    Columns **columns = malloc((ends + 1) * sizeof *columns);
    EdgeWidth *width = malloc((ends + 1) * sizeof *width);
    EdgeFit *fit = malloc((ends + 1) * sizeof *fit);
    Pooled pooled = {0, {0, 0}, {0, 0}};
    double cost[2][WIDTHS] = {{0}, {0}};
    const int done = columns && width && fit;
    size_t found = 0, fitted = 0;
    for (size_t k = 0; done && k < ends; k++)
        if (draft[k].found) columns[found++] = &draft[k].columns;
    if (found) pooled.correlation = estimate_noise_model(columns, found, params);
    for (size_t k = 0; done && k < ends; k++) {
        if (!draft[k].found) continue;
        const Columns *own = &draft[k].columns;
        fit_edge(own, draft[k].sigma, &fit[k]);
        width[fitted++] = blur_width(own, &fit[k], draft[k].sigma, pooled.correlation);
        double length = correlation_length(own, pooled.correlation);
        for (int s = 0; s < WIDTHS; s++) cost[draft[k].outward > 0][s] += fit[k].cost[s] / length;
    }
    for (int side = 0; side < 2; side++) pooled.blunt_gain[side] = blunt_gain(cost[side]);
    if (found) pooled.width = pooled_width(width, found, params);
    for (size_t k = 0; done && k < ends; k++) {
        end[k] = (StripeEnd){NAN, NAN, NAN, NAN, NAN, NAN, NAN, draft[k].sigma, NAN, draft[k].background};
        if (draft[k].found) end[k] = end_of(&draft[k], &fit[k], &pooled, params);
    }
    free(columns);
    free(width);
    free(fit);
    return done;
}

/* Appends the ends of the lines of one image, (lit, dark, lines), to the drafts; 0 and a Python exception if that
   fails. */
static int draft_image(PyObject *image, const Lens *lens, const EndParams *params, List *drafts) {
    static const Parameter parameter[] = {
        {"lit", IMAGE, {N, M}}, {"?=dark", IMAGE, {N, M}}, {"lines", FLOAT64, {ANY, NUMBERS(StripeLine)}}};
    Arguments a;
    if (!OPEN(image, parameter, &a)) return 0;
    const Py_buffer *lit = &a.view[0], *dark = a.view[1].obj ? &a.view[1] : NULL;
    const Images images = {lit->buf, dark ? dark->buf : NULL, lit->shape[0], lit->shape[1], lit->itemsize == 2};
    const StripeLine *line = a.view[2].buf;
    const Py_ssize_t lines = a.view[2].shape[0];
    int done = reserve(drafts, 2 * (size_t)lines);
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t i = 0; done && i < lines; i++, drafts->used += 2)
        done = draft_ends(&images, &line[i], lens, params, (Draft *)drafts->data + drafts->used);
    Py_END_ALLOW_THREADS
    if (!done) PyErr_NoMemory();
    close_arguments(&a, NULL);
    return done;
}

PyObject *call_ends(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {
        {"images", TUPLE, {0}}, {"lens", &Lens_record, {0}}, {"params", &EndParams_record, {0}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    PyObject *images = PyTuple_GetItem(tuple, 0);
    const EndParams *params = (const EndParams *)a.number[2];
    List drafts = {NULL, 0, 0, sizeof(Draft)}, found = {NULL, 0, 0, sizeof(StripeEnd)};
    int valid = 1;
    for (Py_ssize_t i = 0; valid && i < PyTuple_Size(images); i++)
        valid = draft_image(PyTuple_GetItem(images, i), (const Lens *)a.number[1], params, &drafts);
    int done = valid && reserve(&found, drafts.used + 1);
    Py_BEGIN_ALLOW_THREADS
    done = done && stripe_ends(drafts.data, drafts.used, params, found.data);
    Py_END_ALLOW_THREADS
    found.used = drafts.used;
    release(&drafts);
    if (valid) return close_arguments(&a, list_bytes(done, &found));
    release(&found);
    return close_arguments(&a, NULL);
}
