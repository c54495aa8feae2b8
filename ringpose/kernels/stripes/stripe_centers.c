/* From linked ridges to centres with standard deviations. */
#include "stripe_columns.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Filter over stripe: a little wider than matched costs 5 % in white noise, and speckle asks for more. */
#define FILTER_PER_WIDTH 1.3

/* The same for a flat top, over its half width: the flanks weigh most. */
#define FILTER_PER_HALF_WIDTH 0.82

/* Peak of a flat top over its response, for a filter of that width and sigma 1. */
#define FLAT_PEAK_PER_RESPONSE 2.162

/* Narrowest stripe sigma believed, and the widest, in sigmas of the ridge filter. */
#define NARROWEST_PX 0.7
#define WIDEST 2.0

/* Sigma of the flanks of a flat top. */
#define FLANK_PX 1.5

/* An excess above these comes from clutter or bends, or from speckle; shot noise of bright stripes makes up to 9. */
#define CLUTTERED 8.0
#define SPECKLED 10.0

/* A filter so many narrower is tried on pieces of so many columns then, weights for speckle on pieces of so many; they
   are taken if they leave less than that share of the variance. */
enum { NARROWER = 3, LEAST_CLUTTERED = 24, LEAST_SPECKLED = 14 };
#define BETTER 0.95

/* Ridges so far from one of a stripe, in its widths, and no farther are others: nearer ones are its grains. Their light
   bends what lies beneath the stripe, unless it is less than that share; where one of so many columns has such a
   neighbour, speckle is not weighed. */
#define OTHERS_FROM 3.0
#define OTHERS_TO 8.0
#define FAINT_SHARE 0.05f
enum { CROWDED_ONE_IN = 10 };

/* Nor where one of so many columns is full on both sides of its middle, at that share of a width: of a skewed section
   that is cut off the flanks alone say less of the middle than the filter does. */
#define FULL_WIDTHS 0.75
enum { FULL_ONE_IN = 3 };

/* Nor may it lose more than one column in so many. */
enum { LOST_ONE_IN = 10 };

typedef struct {
    const StripeImage *image;
    const Filter *filters; /* the first is that of the ridges */
    size_t filter_count;
    const StripeRules *rules;
    const Ridge *ridges;
    size_t ridge_count;
    Patch *patch;
    Columns columns[2];
} Job;

/* Square of the sigma of the response from how sharply it falls off at its crest, over the phases of the pixel. */
static double response_spread(double sharpness) {
    double b = 3 + 0.125 * sharpness, root = b * b - 7.5 * sharpness;
    return 3.75 / (b - sqrt(root > 0 ? root : 0));
}

/* Number of the filter with the nearest sigma. */
static size_t nearest_filter(const Job *job, double sigma) {
    size_t best = 1;
    for (size_t i = 2; i < job->filter_count; i++)
        if (fabs(job->filters[i].sigma - sigma) < fabs(job->filters[best].sigma - sigma)) best = i;
    return best;
}

static Measure measure_with(const Job *job, size_t filter, double width) {
    Measure how = {.image = job->image, .patch = job->patch, .filter = job->filters + filter, .width = width};
    double sigma = how.filter->sigma, spread = sigma * sigma + width * width;
    how.inverse_spread = width > 0 ? 1 / spread : 0;
    how.peak_per_response = width > 0 ? spread * sqrt(spread) / width : FLAT_PEAK_PER_RESPONSE * sigma * sigma;
    how.whole = whole_from(how.filter, width);
    how.sigma_per_noise = how.filter->slope_norm / job->filters[0].bend_norm;
    return how;
}

/* The filter that suits the width of a piece: that of its ridges together, or of its flat tops if it has many. */
static size_t suited_filter(const Job *job, const int32_t *order, size_t count, double *width) {
    double response = 0, bend = 0, half_width = 0, own = job->filters[0].sigma;
    size_t flat = 0;
    for (size_t i = 0; i < count; i++) {
        const Ridge *ridge = job->ridges + order[i];
        response += ridge->response;
        bend += ridge->bend > 0 ? ridge->bend : 0;
        half_width -= ridge->bend < 0 ? ridge->bend : 0;
        flat += ridge->bend < 0;
    }
    if (3 * flat > count) {
        *width = 0;
        double half = half_width / (double)flat + sqrt(own * own + FLANK_PX * FLANK_PX);
        return nearest_filter(job, FILTER_PER_HALF_WIDTH * half);
    }
    *width = sqrt(fmax(response_spread(bend / response) - own * own, NARROWEST_PX * NARROWEST_PX));
    *width = fmin(*width, WIDEST * own);
    return nearest_filter(job, FILTER_PER_WIDTH * *width);
}

/* Measures ridges with a filter. */
static Scatter measure_piece_with(const Job *job, size_t filter, double width, const int32_t *order, size_t count,
                                  Columns *columns) {
    Measure how = measure_with(job, filter, width);
    take_ridges(job->ridges, order, count, columns);
    measure_columns(&how, columns);
    return scatter(columns);
}

/* Adds centres; the sigmas are variances for now. */
static void append_columns(const Columns *columns, int64_t number, Centers *centers) {
    size_t at = centers->count;
    for (size_t i = 0; i < columns->count; i++) {
        centers->position[2 * (at + i)] = columns->x[i];
        centers->position[2 * (at + i) + 1] = columns->y[i];
        centers->sigma[at + i] = columns->variance[i];
        centers->peak[at + i] = columns->peak[i];
        centers->piece[at + i] = number;
    }
    centers->count += columns->count;
}

/* Whether another ridge of the column lies near one, above it (-1) or below it (1). */
static int has_other(const Job *job, size_t number, ptrdiff_t side, double width) {
    const Ridge *own = job->ridges + number;
    for (size_t i = number + (size_t)side; i < job->ridge_count && job->ridges[i].x == own->x; i += (size_t)side) {
        double apart = fabsf(job->ridges[i].y - own->y);
        if (apart > OTHERS_TO * width) return 0;
        if (apart > OTHERS_FROM * width && job->ridges[i].response > FAINT_SHARE * own->response) return 1;
    }
    return 0;
}

/* Whether a ridge is full on both sides of its middle. */
static int is_full(const Job *job, const Ridge *ridge, double width) {
    const StripeImage *image = job->image;
    ptrdiff_t rows = (ptrdiff_t)(FULL_WIDTHS * width + 0.5);
    size_t above = clamped(ridge->row - rows, image->height), below = clamped(ridge->row + rows, image->height);
    size_t x = (size_t)ridge->x;
    return lit_at(image, above * image->width + x) >= job->rules->full &&
           lit_at(image, below * image->width + x) >= job->rules->full;
}

/* Whether a piece's flanks are those of a stripe alone that is not saturated. */
static int shows_flanks(const Job *job, const int32_t *order, size_t count, double width) {
    size_t others = 0, full = 0;
    for (size_t i = 0; i < count; i++) {
        size_t number = (size_t)order[i];
        others += has_other(job, number, -1, width) || has_other(job, number, 1, width);
        full += (size_t)is_full(job, job->ridges + number, width);
    }
    return CROWDED_ONE_IN * others <= count && FULL_ONE_IN * full <= count;
}

/* Whether hardly any column is lost. */
static int keeps(const Columns *columns, const Columns *other) {
    size_t lost = columns->count > other->count ? columns->count - other->count : 0;
    return LOST_ONE_IN * lost <= columns->count;
}

/* Measures a piece with the filter that suits its width. If its surroundings spoil that, a narrower one is tried; if
   speckle does, centres by weights that suit that. What scatters them less is taken. */
static const Columns *measure_piece(Job *job, const int32_t *order, size_t count, Scatter *of, Scatter *first) {
    double width;
    size_t filter = suited_filter(job, order, count, &width);
    Columns *columns = job->columns, *other = columns + 1;
    *of = *first = measure_piece_with(job, filter, width, order, count, columns);
    if (width == 0 || count < LEAST_SPECKLED || excess(*of, 1) < CLUTTERED) return columns;
    if (of->background && count >= LEAST_CLUTTERED) {
        size_t narrower = filter > NARROWER ? filter - NARROWER : 1;
        Scatter tried = measure_piece_with(job, narrower, width, order, count, other);
        if (keeps(columns, other) && scatter_variance(other, tried) < BETTER * scatter_variance(columns, *of)) {
            *of = tried;
            return other;
        }
    }
    if (excess(*of, 1) < SPECKLED || !shows_flanks(job, order, count, width)) return columns;
    Measure how = measure_with(job, filter, width);
    Scatter tried = weigh_columns(&how, *of, columns, other);
    if (!keeps(columns, other) || excess(tried, 1) >= BETTER * excess(*of, 1)) return columns;
    *of = scatter(other);
    return other;
}

/* ---- pieces ---- */

static int is_kept(const StripePiece *piece, const StripeRules *rules) {
    return (size_t)piece->columns >= rules->shortest && (size_t)piece->strong_columns >= rules->shortest;
}

size_t kept_ridges(const StripeRules *rules, const List *pieces) {
    const StripePiece *piece = pieces->data;
    size_t total = 0;
    for (size_t i = 0; i < pieces->used; i++) total += is_kept(piece + i, rules) ? (size_t)piece[i].columns : 0;
    return total;
}

/* Numbers of the ridges, piece after piece, and where each piece that is kept ends; of the others -1. */
static int32_t *ridges_by_piece(const StripeRules *rules, const List *ridges, const List *pieces, int32_t *end) {
    const StripePiece *piece = pieces->data;
    const Ridge *ridge = ridges->data;
    int32_t total = 0;
    for (size_t i = 0; i < pieces->used; i++) {
        end[i] = is_kept(piece + i, rules) ? total : -1;
        total += end[i] < 0 ? 0 : piece[i].columns;
    }
    int32_t *order = malloc(((size_t)total + 1) * sizeof *order);
    for (size_t i = 0; order && i < ridges->used; i++)
        if (end[ridge[i].piece] >= 0) order[end[ridge[i].piece]++] = (int32_t)i;
    return order;
}

static size_t longest_piece(const List *pieces) {
    const StripePiece *piece = pieces->data;
    int32_t longest = 0;
    for (size_t i = 0; i < pieces->used; i++) longest = piece[i].columns > longest ? piece[i].columns : longest;
    return (size_t)longest;
}

static int64_t measure_pieces(Job *job, const List *pieces, const int32_t *order, const int32_t *end,
                              PieceScatter *measured, Centers *centers) {
    const StripePiece *piece = pieces->data;
    int64_t number = 0;
    for (size_t i = 0; i < pieces->used; i++) {
        if (end[i] < 0) continue;
        size_t count = (size_t)piece[i].columns;
        PieceScatter *own = measured + number;
        const Columns *columns = measure_piece(job, order + ((size_t)end[i] - count), count, &own->of, &own->first);
        if (columns->count < job->rules->shortest) continue;
        own->columns = columns->count;
        append_columns(columns, number++, centers);
    }
    return number;
}

static void take_roots(const double *restrict variance, size_t count, double *restrict sigma) {
    for (size_t i = 0; i < count; i++) sigma[i] = sqrt(variance[i]);
}

/* Sigmas from variances, when all pieces are known; `sorted` is scratch. */
static void find_sigmas(Columns *columns, const PieceScatter *measured, size_t count, PieceScatter *sorted,
                        Centers *centers) {
    memcpy(sorted, measured, count * sizeof *sorted);
    double usual = usual_excess(sorted, count);
    double *sigma = centers->sigma, *y = centers->position + 1;
    for (size_t i = 0; i < count; i++) {
        columns->count = measured[i].columns;
        memcpy(columns->variance, sigma, columns->count * sizeof *sigma);
        for (size_t j = 0; j < columns->count; j++, y += 2) columns->y[j] = *y;
        raise_variances(columns, measured[i].of, usual * excess(measured[i].of, 1) / excess(measured[i].first, 1));
        take_roots(columns->variance, columns->count, sigma);
        sigma += columns->count;
    }
}

int find_centers(const StripeImage *image, const Filter *filters, size_t filter_count, const StripeRules *rules,
                 const List *ridges, const List *pieces, Centers *centers) {
    Patch patch;
    Job job = {image, filters, filter_count, rules, ridges->data, ridges->used, &patch, {{0}, {0}}};
    size_t room = pieces->used + 1;
    int32_t *end = malloc(room * sizeof *end);
    int32_t *order = end ? ridges_by_piece(rules, ridges, pieces, end) : NULL;
    PieceScatter *measured = malloc(2 * room * sizeof *measured);
    void *memory[2];
    for (int i = 0; i < 2; i++) memory[i] = allocate_columns(job.columns + i, longest_piece(pieces));
    int done = order != NULL && measured != NULL && memory[0] != NULL && memory[1] != NULL;
    if (done) {
        size_t count = (size_t)measure_pieces(&job, pieces, order, end, measured, centers);
        find_sigmas(job.columns, measured, count, measured + room, centers);
    }
    free(end);
    free(order);
    free(measured);
    free(memory[0]);
    free(memory[1]);
    return done;
}
