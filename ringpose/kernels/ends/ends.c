/* Stripe endpoints: edges fitted with a pooled blur, their variances, covariances and flags. */
#include "arguments.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "ends.h"
#include "median.h"
#include "tracks.h"

typedef struct {
    double width, border, saturated_share, kink_level, unclear;
    double clipped_phase, facet_sigmas, fit_dof, min_columns;
    double saturated, kink, clipped, blunt, unclear_flag; /* flags */
} MarkParams;

/* Output arrays; two ends for each laser, left and right. */
typedef struct {
    ptrdiff_t lasers;
    double *position, *covariance; /* distorted pixels */
    int64_t *flags;
    double *track_end, *straight_sigma; /* ends of the tracks, undistorted pixels */
} Marks;

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

static int argmin(const double *cost, int count) {
    int k = 0;
    for (int s = 1; s < count; s++)
        if (cost[s] < cost[k]) k = s;
    return k;
}

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

/* Error of a saturated end's position due to the shape of its blur. Where the stripe is saturated, only the foot of the
   edge shows its position: 0.55 log(1 + excess) approximates by how many widths it lies before the edge, at that ratio
   of the stripe's level to what is visible of it. */
static double clipped_error(const Columns *columns, const Edge *edge, const EndParams *params) {
    double headroom[MAX_COLUMNS];
    size_t inside = 0;
    if (saturated_share(columns, edge->position) < SATURATED) return 0;
    for (int i = 0; i < columns->count; i++)
        if (columns->along[i] < edge->position) headroom[inside++] = columns->headroom[FULL][i];
    double visible = fmax(inside ? median(headroom, inside) : 1, params->min_headroom);
    double excess = fmax(1 / fmin(visible, 1), columns->level / params->saturation);
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

/* Whether bytes are drafts of ends, of `end_columns`, as far as reading them stays inside their arrays. */
static int check_drafts(const Draft *draft, size_t bytes) {
    size_t ends = bytes / sizeof *draft;
    int valid = bytes % sizeof *draft == 0;
    for (size_t k = 0; valid && k < ends; k++) {
        const Columns *columns = &draft[k].columns;
        if (!draft[k].found) continue;
        valid = columns->count >= 2 && columns->count <= MAX_COLUMNS && columns->inner >= 2 &&
                columns->inner <= columns->count;
    }
    if (!valid) PyErr_SetString(PyExc_ValueError, "columns: must be the bytes that end_columns returns");
    return valid;
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

/* Weight of all stripes of a shot in the scatter of one, and the largest decrease of its logarithm by the others. */
#define SHARED_WEIGHT 0.75
#define MAX_DECREASE 0.3

/* Mean logarithm of the error of the mean of a stripe's centres, times the root of their number. */
static double mean_log_error(const Track *track, Py_ssize_t tracks) {
    double sum = 0, columns = 0;
    for (Py_ssize_t i = 0; i < tracks; i++) {
        sum += track[i].count * log(track[i].scatter * sqrt(track[i].correlation));
        columns += track[i].count;
    }
    return sum / columns;
}

/* The track with its scatter pooled with that of the others: surface, lens and speckle are the same for all stripes of a
   shot, and the scatter of 40 correlated columns is uncertain by a third. That of a single stripe may be larger, on
   textured background. */
static Track with_pooled_scatter(Track track, double mean_log) {
    double own = log(track.scatter * sqrt(track.correlation));
    if (!isfinite(own) || !isfinite(mean_log)) return track;
    track.scatter *= exp(fmax(SHARED_WEIGHT * (mean_log - own), -MAX_DECREASE));
    return track;
}

/* Standard deviations of errors that all centres of a track have in common, so that their scatter does not show them:
   the background, which shifts a centre by the relative change of the amplitude times the section's sigma; and
   clipping. */
typedef struct {
    double background, shared;
} HiddenErrors;

static HiddenErrors hidden_errors(const Track *track, const StripeEnd end[2], const MarkParams *params) {
    double section = end[0].section_sigma, facets = track->count / (params->facet_sigmas * section);
    int clipped = end[0].saturated > params->saturated_share || end[1].saturated > params->saturated_share;
    double rows = fmax(fabs(track->slope) * (track->x_end - track->x_start), 1);
    if (isnan(section)) return (HiddenErrors){0, 0};
    return (HiddenErrors){section * sqrt(end[0].background / fmax(facets, 1)),
                          clipped ? params->clipped_phase / section / rows : 0};
}

/* Sigma of the middle of the edge; that of a blunt edge includes its width. */
static double middle_of_edge(const StripeEnd *end) {
    return end->blunt == 1 ? sqrt(fmax(end->sigma * end->sigma - end->width * end->width, 0)) : end->sigma;
}

static double flags_of(const StripeEnd *end, const MarkParams *params) {
    int blunt = end->blunt == 1;
    return (end->saturated > params->saturated_share ? params->saturated : 0) +
           (end->outside > params->kink_level ? params->kink : 0) + (blunt ? params->blunt : 0) +
           (middle_of_edge(end) > params->unclear ? params->unclear_flag : 0);
}

/* NaN everywhere, no flags. */
static void clear_marks(Marks *marks) {
    for (ptrdiff_t k = 0; k < 2 * marks->lasers; k++) {
        for (int i = 0; i < 2; i++) marks->position[2 * k + i] = marks->track_end[2 * k + i] = NAN;
        for (int i = 0; i < 4; i++) marks->covariance[4 * k + i] = NAN;
        marks->straight_sigma[k] = NAN;
        marks->flags[k] = 0;
    }
}

/* Covariance: sigma of the edge along the line, sigma of the line across it. */
static void place(const StripeEnd *end, double across, double position[2], double covariance[4]) {
    double along = end->sigma * end->sigma;
    position[0] = end->x;
    position[1] = end->y;
    covariance[0] = along;
    covariance[1] = covariance[2] = along * end->slope;
    covariance[3] = along * end->slope * end->slope + across * across;
}

/* `fit_dof`: independent columns that the fit of the line removes from the estimate of the scatter. */
static void mark_ends(const Track *track, const StripeEnd end[2], ptrdiff_t laser, double fit_dof,
                      const MarkParams *params, Marks *marks) {
    HiddenErrors hidden = hidden_errors(track, end, params);
    double middle = fmax(middle_sigma(track, fit_dof, params->min_columns), hidden.background);
    for (int side = 0; side < 2; side++) {
        ptrdiff_t k = 2 * laser + side;
        double x = side ? track->x_end : track->x_start;
        int inside = end[side].x >= params->border && end[side].x <= params->width - 1 - params->border;
        double across = hypot(line_sigma(track, end[side].x, middle), hidden.shared);
        if (inside) place(&end[side], across, marks->position + 2 * k, marks->covariance + 4 * k);
        marks->flags[k] = (int64_t)(inside ? flags_of(&end[side], params) : params->clipped);
        marks->track_end[2 * k] = x;
        marks->track_end[2 * k + 1] = line_y(track, x);
        marks->straight_sigma[k] = hypot(line_sigma(track, x, middle), hidden.shared);
    }
}

PyObject *call_end_columns(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"lit", 'I', {N, M}},
                                          {"?dark", 'I', {N, M}},
                                          {"lines", 'd', {ANY, NUMBERS(StripeLine)}},
                                          {"lens", 'T', {NUMBERS(Lens)}},
                                          {"params", 'T', {NUMBERS(EndParams)}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const Py_buffer *lit = &a.view[0], *dark = a.view[1].obj ? &a.view[1] : NULL;
    if (dark && dark->itemsize != lit->itemsize) {
        PyErr_SetString(PyExc_TypeError, "dark: must be of the same type as lit");
        return close_arguments(&a, NULL);
    }
    Images images = {lit->buf, dark ? dark->buf : NULL, lit->shape[0], lit->shape[1], lit->itemsize == 2};
    List drafts = {NULL, 0, 0, sizeof(Draft)};
    const StripeLine *line = a.view[2].buf;
    int done = reserve(&drafts, 2 * (size_t)a.view[2].shape[0]);
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t i = 0; done && i < a.view[2].shape[0]; i++, drafts.used += 2)
        done = draft_ends(&images, &line[i], (const Lens *)a.number[3], (const EndParams *)a.number[4],
                          (Draft *)drafts.data + 2 * i);
    Py_END_ALLOW_THREADS
    return close_arguments(&a, list_bytes(done, &drafts));
}

PyObject *call_ends(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"columns", 'B', {ANY}}, {"params", 'T', {NUMBERS(EndParams)}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const size_t bytes = (size_t)a.view[0].shape[0], ends = bytes / sizeof(Draft);
    List found = {NULL, 0, 0, sizeof(StripeEnd)};
    Draft *draft = malloc(bytes + 1); /* the buffer is not writable, nor aligned */
    int done = draft && reserve(&found, ends + 1);
    if (done) memcpy(draft, a.view[0].buf, bytes);
    if (done && !check_drafts(draft, bytes)) {
        free(draft);
        free(found.data);
        return close_arguments(&a, NULL);
    }
    Py_BEGIN_ALLOW_THREADS
    done = done && stripe_ends(draft, ends, (const EndParams *)a.number[1], found.data);
    Py_END_ALLOW_THREADS
    free(draft);
    found.used = ends;
    return close_arguments(&a, list_bytes(done, &found));
}

static int check_lasers(const int64_t *laser, Py_ssize_t tracks, Py_ssize_t lasers) {
    for (Py_ssize_t i = 0; i < tracks; i++) {
        if (laser[i] >= 0 && laser[i] < lasers) continue;
        PyErr_Format(PyExc_ValueError, "lasers: number %zd is not of the rig", i);
        return 0;
    }
    return 1;
}

PyObject *call_marks(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"tracks", 'd', {N, NUMBERS(Track)}},
                                          {"ends", 'd', {N, 2, NUMBERS(StripeEnd)}},
                                          {"lasers", 'q', {N}},
                                          {"params", 'T', {NUMBERS(MarkParams)}},
                                          {">position", 'd', {M, 2, 2}},
                                          {">covariance", 'd', {M, 2, 2, 2}},
                                          {">flags", 'q', {M, 2}},
                                          {">straight", 'd', {M, 2, 2}},
                                          {">sigma", 'd', {M, 2}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const Py_ssize_t tracks = a.view[0].shape[0];
    const int64_t *laser = a.view[2].buf;
    const Track *track = a.view[0].buf;
    const StripeEnd *end = a.view[1].buf;
    const MarkParams *params = (const MarkParams *)a.number[3];
    Marks marks = {a.view[4].shape[0], a.view[4].buf, a.view[5].buf, a.view[6].buf, a.view[7].buf, a.view[8].buf};
    if (!check_lasers(laser, tracks, marks.lasers)) return close_arguments(&a, NULL);
    clear_marks(&marks);
    const double mean_log = mean_log_error(track, tracks);
    const double fit_dof = params->fit_dof / sqrt((double)tracks);
    for (Py_ssize_t i = 0; i < tracks; i++) {
        const Track pooled = with_pooled_scatter(track[i], mean_log);
        mark_ends(&pooled, &end[2 * i], (ptrdiff_t)laser[i], fit_dof, params, &marks);
    }
    return close_arguments(&a, Py_BuildValue(""));
}
