/* Stripe endpoints: edges fitted with a pooled blur, their variances, covariances and flags. */
#include "arguments.h"

#include <math.h>
#include <stdlib.h>

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

/* State of one end. */
typedef struct {
    int fitted;
    double near; /* column */
    Columns columns;
    EdgeFit fit;
} Draft;

/* Estimates from all ends of an image. */
typedef struct {
    double correlation; /* of the speckle of neighbouring columns */
    EdgeWidth width;
    double blunt_gain_of;
} Pooled;

static int argmin(const double *cost, int count) {
    int k = 0;
    for (int s = 1; s < count; s++)
        if (cost[s] < cost[k]) k = s;
    return k;
}

/* Gain in log likelihood by widths larger than that of the cross-section. */
static double blunt_gain_of(const EdgeFit *fit, double correlation_length) {
    return (fit->cost[argmin(fit->cost, SHARP_WIDTHS)] - fit->cost[argmin(fit->cost, WIDTHS)]) / correlation_length;
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
static double combine_widths(const Draft *draft, double sigma, int blunt, const Pooled *pooled, const EndParams *params,
                     Edge *edge) {
    EdgeWidth own = blur_width(&draft->columns, &draft->fit, sigma, pooled->correlation);
    EdgeWidth width = combined_width(&own, &pooled->width, params);
    *edge = edge_of_width(&draft->fit, sigma, exp(width.logarithm));
    if (blunt) {
        int k = argmin(draft->fit.cost, WIDTHS);
        *edge = (Edge){draft->fit.position[k], WIDTH[k] * sigma, draft->fit.outside[k], 0};
    }
    double variance = edge_variance(&draft->columns, edge, pooled->correlation, width.information, params);
    variance = variance_over_places(&draft->columns, &draft->fit, edge, variance, pooled->correlation);
    double clipped = clipped_error(&draft->columns, edge, params);
    variance += clipped * clipped;
    return blunt ? variance + edge->width * edge->width : variance;
}

static StripeEnd end_of(const Draft *draft, const Profile *profile, int outward, const Pooled *pooled,
                        const EndParams *params) {
    Edge edge;
    int blunt = pooled->blunt_gain_of > params->blunt_gain && argmin(draft->fit.cost, WIDTHS) >= SHARP_WIDTHS - 1;
    double variance = combine_widths(draft, profile->sigma, blunt, pooled, params, &edge);
    double x = draft->near + outward * edge.position;
    return (StripeEnd){x,
                       stripe_y(profile, x),
                       stripe_y(profile, x + 0.5) - stripe_y(profile, x - 0.5),
                       sqrt(variance),
                       edge.outside,
                       saturated_share(&draft->columns, edge.position),
                       edge.width,
                       profile->sigma,
                       blunt,
                       profile->background};
}

/* Reads a line's profile and the columns about both its ends; 0 without memory. */
static int draft_ends(const Images *images, const StripeLine *line, const Lens *lens, const EndParams *params,
                      Profile *profile, Draft draft[2]) {
    int read = read_profile(images, line, lens, params, profile);
    for (int side = 0; read > 0 && side < 2; side++) {
        int outward = side ? 1 : -1;
        ptrdiff_t near = last_undimmed(profile, side ? profile->face_last : profile->face_first, outward, params);
        draft[side].near = (double)(profile->first + near);
        draft[side].fitted = gather_columns(profile, near, outward, params, &draft[side].columns);
    }
    return read >= 0;
}

/* Fits an edge at every end. All edges of a ring are machined alike, so their bluntness is pooled. */
static int fit_ends(const Profile *profile, Draft *draft, size_t ends, const EndParams *params, Pooled *pooled) {
    Columns **columns = malloc((ends ? ends : 1) * sizeof *columns);
    EdgeWidth *width = malloc((ends ? ends : 1) * sizeof *width);
    size_t fitted = 0, found = 0;
    for (size_t k = 0; columns && k < ends; k++)
        if (draft[k].fitted) columns[fitted++] = &draft[k].columns;
    if (columns && width) pooled->correlation = estimate_noise_model(columns, fitted, params);
    for (size_t k = 0; columns && width && k < ends; k++) {
        if (!draft[k].fitted) continue;
        const Columns *own = &draft[k].columns;
        fit_edge(own, profile[k / 2].sigma, &draft[k].fit);
        width[found++] = blur_width(own, &draft[k].fit, profile[k / 2].sigma, pooled->correlation);
        pooled->blunt_gain_of += blunt_gain_of(&draft[k].fit, correlation_length(own, pooled->correlation));
    }
    if (found) pooled->width = pooled_width(width, found, params);
    int done = columns && width;
    free(columns);
    free(width);
    return done;
}

int stripe_ends(const Images *images, const StripeLine *line, size_t lines, const Lens *lens, const EndParams *params,
                StripeEnd *end) {
    Profile *profile = calloc(lines ? lines : 1, sizeof *profile);
    Draft *draft = calloc(lines ? 2 * lines : 1, sizeof *draft);
    Pooled pooled = {0, {0, 0}, 0};
    int done = profile && draft;
    for (size_t i = 0; done && i < lines; i++)
        done = draft_ends(images, &line[i], lens, params, &profile[i], &draft[2 * i]);
    done = done && fit_ends(profile, draft, 2 * lines, params, &pooled);
    for (size_t k = 0; done && k < 2 * lines; k++) {
        const Profile *own = &profile[k / 2];
        double sigma = own->face_last > own->face_first ? own->sigma : NAN;
        double background = own->face_last > own->face_first ? own->background : NAN;
        end[k] = (StripeEnd){NAN, NAN, NAN, NAN, NAN, NAN, NAN, sigma, NAN, background};
        if (draft[k].fitted) end[k] = end_of(&draft[k], own, k % 2 ? 1 : -1, &pooled, params);
    }
    for (size_t i = 0; profile && i < lines; i++) free_profile(&profile[i]);
    free(profile);
    free(draft);
    return done;
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

static void mark_ends(const Track *track, const StripeEnd end[2], ptrdiff_t laser, const MarkParams *params,
                      Marks *marks) {
    HiddenErrors hidden = hidden_errors(track, end, params);
    double middle = fmax(middle_sigma(track, params->fit_dof, params->min_columns), hidden.background);
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

PyObject *call_ends(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"lit", 'I', {N, M}},
                                          {"?dark", 'I', {N, M}},
                                          {"lines", 'd', {ANY, NUMBERS(StripeLine)}},
                                          {"lens", 'T', {NUMBERS(Lens)}},
                                          {"params", 'T', {NUMBERS(EndParams)}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const Py_buffer *laser_on = &a.view[0], *laser_off = a.view[1].obj ? &a.view[1] : NULL;
    if (laser_off && laser_off->itemsize != laser_on->itemsize) {
        PyErr_SetString(PyExc_TypeError, "dark: must be of the same type as lit");
        return close_arguments(&a, NULL);
    }
    Images images = {laser_on->buf, laser_off ? laser_off->buf : NULL, laser_on->shape[0],
                     laser_on->shape[1], laser_on->itemsize == 2};
    const size_t lines = (size_t)a.view[2].shape[0], bytes = 2 * lines * sizeof(StripeEnd);
    StripeEnd *end = malloc(bytes ? bytes : 1);
    int done = 0;
    Py_BEGIN_ALLOW_THREADS
    done = end && stripe_ends(&images, a.view[2].buf, lines, (const Lens *)a.number[3], (const EndParams *)a.number[4],
                              end);
    Py_END_ALLOW_THREADS
    PyObject *result = done ? PyBytes_FromStringAndSize((const char *)end, (Py_ssize_t)bytes) : PyErr_NoMemory();
    free(end);
    return close_arguments(&a, result);
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
    Marks marks = {a.view[4].shape[0], a.view[4].buf, a.view[5].buf, a.view[6].buf, a.view[7].buf, a.view[8].buf};
    if (!check_lasers(laser, tracks, marks.lasers)) return close_arguments(&a, NULL);
    clear_marks(&marks);
    for (Py_ssize_t i = 0; i < tracks; i++)
        mark_ends(&track[i], &end[2 * i], (ptrdiff_t)laser[i], (const MarkParams *)a.number[3], &marks);
    return close_arguments(&a, Py_BuildValue(""));
}
