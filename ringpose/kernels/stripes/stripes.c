/* The Python side of stripe centres. */
#include <stdlib.h>

#include "arguments.h"
#include "stripe_centers.h"

/* Figures of a filter: sigma, taps on one side, response of either derivative to white noise. */
enum { FIGURES = 4 };

RECORD(StripeParams, STRIPE_PARAMS);

static int filters_fit(const Py_buffer *taps, const Py_buffer *figures) {
    int fit = figures->shape[0] >= 2;
    const double *figure = figures->buf;
    for (Py_ssize_t i = 0; fit && i < figures->shape[0]; i++, figure += FIGURES)
        fit = figure[0] > 0 && figure[0] <= MAX_REACH && figure[1] >= 1 && figure[1] < (double)taps->shape[2] &&
              figure[1] <= MAX_REACH && figure[2] > 0 && figure[3] > 0;
    return require(fit, "filters: figures and taps do not fit together");
}

static Filter *filters_of(const Py_buffer *taps, const Py_buffer *figures) {
    size_t count = (size_t)figures->shape[0], maximum = (size_t)taps->shape[2];
    Filter *filters = malloc(count * sizeof *filters);
    const float *tap = taps->buf;
    const double *figure = figures->buf;
    for (size_t i = 0; filters && i < count; i++, tap += 2 * maximum, figure += FIGURES)
        filters[i] = (Filter){tap, tap + maximum, (size_t)figure[1], figure[0], figure[2], figure[3]};
    return filters;
}

/* Lists as large as the last images needed them: asking the system anew for every image takes a fifth of its time.
   Whoever holds the interpreter's lock may take them. */
typedef struct {
    List runs, found, ridges, pieces, centers;
} Lists;

/* Numbers of a centre: x, y, sigma, peak, piece. */
enum { CENTER = 5 };

#define NO_LISTS                                                                                                   \
    {{NULL, 0, 0, sizeof(Run)}, {NULL, 0, 0, sizeof(Ridge)}, {NULL, 0, 0, sizeof(Ridge)},                          \
     {NULL, 0, 0, sizeof(StripePiece)}, {NULL, 0, 0, CENTER * sizeof(double)}}
static const Lists no_lists = NO_LISTS;
static Lists idle_lists = NO_LISTS;

/* Longer lists than these bytes are not kept. */
enum { MAX_KEPT_BYTES = 1 << 21 };

static Lists take_lists(void) {
    Lists lists = idle_lists;
    idle_lists = no_lists;
    return lists;
}

static void give_lists_back(Lists *lists) {
    List *list[] = {&lists->runs, &lists->found, &lists->ridges, &lists->pieces, &lists->centers};
    int taken = idle_lists.ridges.data != NULL;
    for (size_t i = 0; i < sizeof list / sizeof *list; i++) {
        list[i]->used = 0;
        if (taken || list[i]->capacity * list[i]->item > MAX_KEPT_BYTES) release(list[i]);
    }
    if (!taken) idle_lists = *lists;
}

/* Ridges and the pieces that they make up. */
static int find_pieces(const StripeImage *image, const Filter *filter, const StripeParams *params, const Bands *bands,
                       Lists *lists) {
    Noise noise = {.image = image, .filter = filter, .blocks = (image->width + BLOCK - 1) / BLOCK};
    noise.areas_across = (noise.blocks + NOISE_BLOCKS - 1) / NOISE_BLOCKS;
    size_t areas = (image->height + NOISE_ROWS - 1) / NOISE_ROWS * noise.areas_across;
    noise.figure = malloc(areas * sizeof *noise.figure);
    int done = noise.figure != NULL;
    for (size_t i = 0; done && i < areas; i++) noise.figure[i] = -1;
    done = done && find_runs(&noise, params, bands, &lists->runs) &&
           find_ridges(&noise, params, &lists->runs, &lists->found, &lists->ridges) &&
           link_ridges(image, filter, params, &lists->ridges, &lists->pieces);
    free(noise.figure);
    return done;
}

static PyObject *bytes_of(const void *data, size_t count) {
    return PyBytes_FromStringAndSize(data, (Py_ssize_t)(count * sizeof(double)));
}

/* Positions, sigmas, peaks and pieces of the centres. */
static PyObject *centers_of(const StripeImage *image, const Filter *filters, size_t filter_count,
                            const StripeParams *params, Lists *lists) {
    size_t room = kept_ridges(params, &lists->pieces);
    if (!reserve(&lists->centers, room + 1)) return PyErr_NoMemory();
    double *memory = lists->centers.data;
    Centers centers = {memory, memory + 2 * room, memory + 3 * room, (int64_t *)(memory + 4 * room), 0};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = find_centers(image, filters, filter_count, params, &lists->ridges, &lists->pieces, &centers);
    Py_END_ALLOW_THREADS
    if (!done) return PyErr_NoMemory();
    return Py_BuildValue("(NNNN)", bytes_of(centers.position, 2 * centers.count), bytes_of(centers.sigma, centers.count),
                         bytes_of(centers.peak, centers.count), bytes_of(centers.piece, centers.count));
}

PyObject *call_stripes(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"image", IMAGE, {N, M}},      {"?=dark", IMAGE, {N, M}},
                                          {"?bands", INT32, {ANY, SIDES}}, {"taps", FLOAT32, {K, 2, ANY}},
                                          {"filters", FLOAT64, {K, FIGURES}}, {"params", &StripeParams_record, {0}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const Py_buffer *lit = &a.view[0], *dark = a.view[1].obj ? &a.view[1] : NULL, *sides = &a.view[2];
    const StripeParams *params = (const StripeParams *)a.number[5];
    if (!filters_fit(&a.view[3], &a.view[4])) return close_arguments(&a, NULL);
    StripeImage image = {lit->buf, dark ? dark->buf : NULL, (size_t)lit->shape[0], (size_t)lit->shape[1],
                         lit->itemsize == 2};
    Bands bands = {NULL, 0};
    if (sides->obj) bands = (Bands){sides->buf, (size_t)sides->shape[0]};
    Lists lists = take_lists();
    Filter *filters = filters_of(&a.view[3], &a.view[4]);
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = filters && find_pieces(&image, filters, params, &bands, &lists);
    Py_END_ALLOW_THREADS
    PyObject *result =
        done ? centers_of(&image, filters, (size_t)a.view[4].shape[0], params, &lists) : PyErr_NoMemory();
    give_lists_back(&lists);
    free(filters);
    return close_arguments(&a, result);
}
