/* The Python side of the stripe kernel; arguments are checked here. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdlib.h>

#include "buffers.h"
#include "stripes.h"

/* Figures of a filter: sigma, taps on one side, response of either derivative to white noise. */
enum { FIGURES = 4 };

/* Columns that may be missing in a piece. */
enum { MOST_GAP = 1000 };

/* The arguments' buffers; `obj` is NULL in those that are not open. */
typedef struct {
    Py_buffer image, dark, bands, taps, figures;
} Views;

static void close_views(Views *views) {
    Py_buffer *view[] = {&views->image, &views->dark, &views->bands, &views->taps, &views->figures};
    for (size_t i = 0; i < 5; i++)
        if (view[i]->obj) PyBuffer_Release(view[i]);
}

/* 8 or 16 bits a pixel. */
static int open_image(PyObject *object, Py_buffer *view, const char *name) {
    if (PyObject_GetBuffer(object, view, PyBUF_STRIDES | PyBUF_FORMAT) < 0) return 0;
    int wide = view->itemsize == 2;
    PyBuffer_Release(view);
    return open_array(object, view, name, wide ? "H" : "B", wide ? 2 : 1, 2, 0);
}

static int open_views(Views *views, PyObject *image, PyObject *dark, PyObject *bands, PyObject *taps,
                      PyObject *figures) {
    return open_image(image, &views->image, "image") && (dark == Py_None || open_image(dark, &views->dark, "dark")) &&
           (bands == Py_None || open_array(bands, &views->bands, "bands", "il", 4, 2, 0)) &&
           open_array(taps, &views->taps, "taps", "f", 4, 3, 0) &&
           open_array(figures, &views->figures, "filters", "d", 8, 2, 0);
}

static int images_fit(const Views *views) {
    const Py_buffer *image = &views->image, *dark = &views->dark;
    if (image->shape[0] < 1 || image->shape[1] < 1 || image->shape[0] > INT32_MAX / image->shape[1]) {
        PyErr_Format(PyExc_ValueError, "image: %zd rows of %zd columns, must be 1 to 2^31 - 1 pixels", image->shape[0],
                     image->shape[1]);
        return 0;
    }
    if (!dark->obj || (dark->itemsize == image->itemsize && dark->shape[0] == image->shape[0] &&
                       dark->shape[1] == image->shape[1]))
        return 1;
    PyErr_SetString(PyExc_ValueError, "dark: must have the type and the shape of the image");
    return 0;
}

static int bands_fit(const Views *views) {
    if (!views->bands.obj || views->bands.shape[1] == SIDES) return 1;
    PyErr_SetString(PyExc_ValueError, "bands: must have four sides each");
    return 0;
}

static int filters_fit(const Views *views) {
    const Py_buffer *taps = &views->taps, *figures = &views->figures;
    Py_ssize_t count = figures->shape[0];
    int fit = count >= 2 && figures->shape[1] == FIGURES && taps->shape[0] == count && taps->shape[1] == 2;
    const double *figure = figures->buf;
    for (Py_ssize_t i = 0; fit && i < count; i++, figure += FIGURES)
        fit = figure[0] > 0 && figure[0] <= MOST_REACH && figure[1] >= 1 && figure[1] < (double)taps->shape[2] &&
              figure[1] <= MOST_REACH && figure[2] > 0 && figure[3] > 0;
    if (!fit) PyErr_SetString(PyExc_ValueError, "filters: figures and taps do not fit together");
    return fit;
}

static int rules_fit(const StripeRules *rules, long gap, long shortest) {
    if (rules->begin_sigmas >= 0 && rules->continue_sigmas >= 0 && rules->least_response > 0 &&
        rules->coarse_per_response >= 0 && gap >= 0 && gap <= MOST_GAP && shortest >= 1)
        return 1;
    PyErr_SetString(PyExc_ValueError, "rules: a number is out of range");
    return 0;
}

static Filter *filters_of(const Views *views) {
    size_t count = (size_t)views->figures.shape[0], taps = (size_t)views->taps.shape[2];
    Filter *filters = malloc(count * sizeof *filters);
    const float *tap = views->taps.buf;
    const double *figure = views->figures.buf;
    for (size_t i = 0; filters && i < count; i++, tap += 2 * taps, figure += FIGURES)
        filters[i] = (Filter){tap, tap + taps, (size_t)figure[1], figure[0], figure[2], figure[3]};
    return filters;
}

/* Lists as large as the last images needed them: asking the system anew for every image takes a fifth of its time.
   Whoever holds the interpreter's lock may take them. */
typedef struct {
    List runs, found, ridges, pieces;
} Lists;

#define NO_LISTS                                                                                                   \
    {{NULL, 0, 0, sizeof(Run)}, {NULL, 0, 0, sizeof(Ridge)}, {NULL, 0, 0, sizeof(Ridge)},                          \
     {NULL, 0, 0, sizeof(StripePiece)}}
static const Lists no_lists = NO_LISTS;
static Lists idle_lists = NO_LISTS;

/* Longer lists than these bytes are not kept. */
enum { LONGEST_KEPT = 1 << 21 };

static Lists take_lists(void) {
    Lists lists = idle_lists;
    idle_lists = no_lists;
    return lists;
}

static void give_lists_back(Lists *lists) {
    List *list[] = {&lists->runs, &lists->found, &lists->ridges, &lists->pieces};
    int taken = idle_lists.ridges.data != NULL;
    for (size_t i = 0; i < 4; i++) {
        list[i]->used = 0;
        if (taken || list[i]->capacity * list[i]->item > LONGEST_KEPT) release(list[i]);
    }
    if (!taken) idle_lists = *lists;
}

/* Ridges and the pieces that they make up. */
static int find_pieces(const StripeImage *image, const Filter *filter, const StripeRules *rules, const Bands *bands,
                       Lists *lists) {
    Noise noise = {.image = image, .filter = filter, .blocks = (image->width + BLOCK - 1) / BLOCK};
    noise.areas_across = (noise.blocks + NOISE_BLOCKS - 1) / NOISE_BLOCKS;
    size_t areas = (image->height + NOISE_ROWS - 1) / NOISE_ROWS * noise.areas_across;
    noise.figure = malloc(areas * sizeof *noise.figure);
    int done = noise.figure != NULL;
    for (size_t i = 0; done && i < areas; i++) noise.figure[i] = -1;
    done = done && find_runs(&noise, rules, bands, &lists->runs) &&
           find_ridges(&noise, rules, &lists->runs, &lists->found, &lists->ridges) &&
           link_ridges(image, filter, rules, &lists->ridges, &lists->pieces);
    free(noise.figure);
    return done;
}

/* Arrays of `count` positions, sigmas, peaks and pieces. */
static PyObject *new_arrays(size_t count) {
    PyObject *result = PyTuple_New(4);
    for (Py_ssize_t i = 0; result && i < 4; i++) {
        PyObject *array = PyByteArray_FromStringAndSize(NULL, (Py_ssize_t)((i == 0 ? 16 : 8) * count));
        if (array == NULL || PyTuple_SetItem(result, i, array) < 0) {
            Py_DECREF(result);
            return NULL;
        }
    }
    return result;
}

static void *array_data(PyObject *arrays, Py_ssize_t i) { return PyByteArray_AsString(PyTuple_GetItem(arrays, i)); }

static int shorten(PyObject *arrays, size_t count) {
    for (Py_ssize_t i = 0; i < 4; i++)
        if (PyByteArray_Resize(PyTuple_GetItem(arrays, i), (Py_ssize_t)((i == 0 ? 16 : 8) * count)) < 0) return 0;
    return 1;
}

static PyObject *centers_of(const StripeImage *image, const Filter *filters, size_t filter_count,
                            const StripeRules *rules, const Lists *lists) {
    size_t most = kept_ridges(rules, &lists->pieces);
    PyObject *arrays = new_arrays(most);
    if (arrays == NULL) return NULL;
    Centers centers = {array_data(arrays, 0), array_data(arrays, 1), array_data(arrays, 2), array_data(arrays, 3), 0};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = find_centers(image, filters, filter_count, rules, &lists->ridges, &lists->pieces, &centers);
    Py_END_ALLOW_THREADS
    if (!done) PyErr_NoMemory();
    if (done && (centers.count == most || shorten(arrays, centers.count))) return arrays;
    Py_DECREF(arrays);
    return NULL;
}

static PyObject *stripes_of(const Views *views, const StripeRules *rules) {
    StripeImage image = {views->image.buf, views->dark.obj ? views->dark.buf : NULL, (size_t)views->image.shape[0],
                         (size_t)views->image.shape[1], views->image.itemsize == 2};
    Bands bands = {NULL, 0};
    if (views->bands.obj) bands = (Bands){views->bands.buf, (size_t)views->bands.shape[0]};
    Lists lists = take_lists();
    Filter *filters = filters_of(views);
    int done = filters != NULL;
    Py_BEGIN_ALLOW_THREADS
    done = done && find_pieces(&image, filters, rules, &bands, &lists);
    Py_END_ALLOW_THREADS
    PyObject *result = done ? centers_of(&image, filters, (size_t)views->figures.shape[0], rules, &lists)
                            : PyErr_NoMemory();
    give_lists_back(&lists);
    free(filters);
    return result;
}

static PyObject *stripes(PyObject *module, PyObject *arguments) {
    (void)module;
    PyObject *image, *dark, *bands, *taps, *figures, *result = NULL;
    StripeRules rules;
    long gap, shortest;
    if (!PyArg_ParseTuple(arguments, "OOOOO(fffffll)", &image, &dark, &bands, &taps, &figures, &rules.begin_sigmas,
                          &rules.continue_sigmas, &rules.least_response, &rules.coarse_per_response, &rules.full, &gap,
                          &shortest))
        return NULL;
    if (!rules_fit(&rules, gap, shortest)) return NULL;
    rules.gap = (size_t)gap;
    rules.shortest = (size_t)shortest;
    Views views = {0};
    if (open_views(&views, image, dark, bands, taps, figures) && images_fit(&views) && bands_fit(&views) &&
        filters_fit(&views))
        result = stripes_of(&views, &rules);
    close_views(&views);
    return result;
}

static PyMethodDef methods[] = {
    {"stripes", stripes, METH_VARARGS,
     "stripes(image, dark, bands, taps, filters, rules) -> (position, sigma, peak, piece)"},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_stripes", NULL, 0, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__stripes(void) { return PyModule_Create(&definition); }
