/* Smoothing, gradient and anchors in one pass over the rows.

   A smoothed value is 16 grey values, so that a dim edge keeps its shape; a Sobel difference of those is
   128 grey values a pixel. 8-bit images keep every sum within 16 bits: 255 * 16 * 16 = 65280 unsigned,
   4 * 4080 = 16320 for one difference, 22440 for the magnitude. Wider images are summed in 32 bits and
   shifted to the same scale: at most 4095 smoothed, 22523 in magnitude. */
#include "arguments.h"

#include <stdlib.h>
#include <string.h>

#include "segments.h"

typedef struct {
    const void *data; /* uint8_t if bits is 8, uint16_t if it is more */
    size_t height, width;
    int bits;
} Image;

typedef struct {
    List index;       /* int32_t: row * width + column */
    List orientation; /* uint8_t: 0 to 3, the walking direction along the edge */
} Anchors;

/* Pixels of a row that are looked at together. */
enum { BLOCK = 128 };

/* Anchors lie in columns, those of upright edges in rows, whose number is a multiple of this. */
enum { ANCHOR_SPACING = 8, NO_ANCHORS = INT16_MAX };

/* Smoothed rows that are kept: of a row with anchors, and of the one below, their neighbours as well. */
enum { SMOOTH = 4 };

typedef struct {
    void *memory, *sum; /* sum: uint16_t, or uint32_t of wide images */
    int16_t *smooth[SMOOTH];
    int16_t *along, *across;
    uint8_t *is_anchor;
    int16_t *minimum; /* magnitude of an anchor in each column; none has NO_ANCHORS */
} Rows;

/* Elements beside each row that are worked on as if they were part of it: so vectors need not begin within a row, which
   would put half of them across two lines of the cache. */
enum { BESIDE = 32 };

static int allocate_rows(Rows *rows, size_t width, int16_t upper) {
    if (width > SIZE_MAX / 64) return 0;
    const size_t step = (width + 3 * BESIDE - 1) / BESIDE * BESIDE;
    rows->memory = calloc(10 * step + BESIDE, sizeof(int16_t));
    if (rows->memory == NULL) return 0;
    const size_t off = (uintptr_t)rows->memory % (BESIDE * sizeof(int16_t)) / sizeof(int16_t);
    int16_t *row = (int16_t *)rows->memory + (BESIDE - off);
    row += BESIDE;
    rows->sum = row;
    for (int i = 0; i < SMOOTH; i++) rows->smooth[i] = row + (size_t)(2 + i) * step;
    rows->along = row + 6 * step;
    rows->across = row + 7 * step;
    rows->is_anchor = (uint8_t *)(row + 8 * step);
    rows->minimum = row + 9 * step;
    for (size_t x = 0; x < width; x++) rows->minimum[x] = x % ANCHOR_SPACING == 0 ? upper : NO_ANCHORS;
    return 1;
}

/* Binomial 1 4 6 4 1 down the columns, then along the row; `shift` from the sum of pixels to a smoothed value. */
#define SMOOTH_ROW(name, Pixel, Sum, shift)                                                                        \
    VECTOR_LOOP                                                                                                    \
    static void name(const Image *image, size_t row, const Rows *rows) {                                           \
        const size_t width = image->width;                                                                         \
        const Pixel *restrict c = (const Pixel *)image->data + row * width;                                        \
        const Pixel *restrict a = c - 2 * width, *restrict b = c - width;                                          \
        const Pixel *restrict d = c + width, *restrict e = d + width;                                              \
        Sum *restrict sum = (Sum *)rows->sum;                                                                      \
        int16_t *restrict smooth = rows->smooth[row % SMOOTH];                                                     \
        const int bits = (shift);                                                                                  \
        for (size_t x = 0; x < width; x++) sum[x] = (Sum)(a[x] + 4 * (b[x] + d[x]) + 6 * c[x] + e[x]);             \
        const Sum *before = sum - 2, half = (Sum)(1 << (bits - 1));                                                \
        for (size_t x = 0; x < width; x++) {                                                                       \
            Sum total = (Sum)(before[x] + 4 * (before[x + 1] + sum[x + 1]) + 6 * sum[x] + sum[x + 2] + half);      \
            smooth[x] = (int16_t)(total >> bits);                                                                  \
        }                                                                                                          \
    }

SMOOTH_ROW(smooth_row, uint8_t, uint16_t, 4)
SMOOTH_ROW(smooth_wide_row, uint16_t, uint32_t, image->bits - 4)

static void smooth_image_row(const Image *image, size_t row, const Rows *rows) {
    (image->bits > 8 ? smooth_wide_row : smooth_row)(image, row, rows);
}

/* Absolute value as a maximum, which vectors have one instruction for. */
static int16_t size_of(int16_t value) {
    const int16_t opposite = (int16_t)-value;
    return value > opposite ? value : opposite;
}

/* Sobel, and the magnitude of both components. */
VECTOR_LOOP
static void gradient_row(const Rows *rows, size_t row, size_t width, int16_t *restrict magnitude) {
    const int16_t *restrict up = rows->smooth[(row - 1) % SMOOTH], *restrict here = rows->smooth[row % SMOOTH];
    const int16_t *restrict down = rows->smooth[(row + 1) % SMOOTH];
    int16_t *restrict along = rows->along, *restrict across = rows->across;
    for (size_t x = 0; x < width; x++) {
        along[x] = (int16_t)(up[x] + 2 * here[x] + down[x]);
        across[x] = (int16_t)(down[x] - up[x]);
    }
    const int16_t *along_before = along - 1, *across_before = across - 1;
    for (size_t x = 0; x < width; x++) {
        int16_t dx = (int16_t)(along[x + 1] - along_before[x]);
        int16_t dy = (int16_t)(across_before[x] + 2 * across[x] + across[x + 1]);
        int16_t ax = size_of(dx), ay = size_of(dy);
        int16_t maximum = ax > ay ? ax : ay, minimum = ax > ay ? ay : ax;
        magnitude[x] = (int16_t)(maximum + ((uint16_t)(3 * minimum) >> 3));
    }
}

VECTOR_LOOP
static int16_t strongest(const int16_t *magnitude, size_t from, size_t to) {
    int16_t maximum = 0;
    for (size_t x = from; x < to; x++) maximum = magnitude[x] > maximum ? magnitude[x] : maximum;
    return maximum;
}

/* 1 where the magnitude is a maximum down the column or, in rows in which upright edges have anchors, along the row; of
   two equal ones the earlier in raster order. */
VECTOR_LOOP
static void mark_maxima(const Rows *rows, const int16_t *restrict here, size_t width, size_t from, size_t to,
                        int16_t upper, int crosses) {
    const int16_t *restrict up = here - width, *restrict down = here + width, *restrict minimum = rows->minimum;
    uint8_t *restrict is_anchor = rows->is_anchor;
    for (size_t x = from; x < to; x++)
        is_anchor[x] = (here[x] >= minimum[x]) & (here[x] > up[x]) & (here[x] >= down[x]);
    for (size_t x = from; crosses && x < to; x++)
        is_anchor[x] |= (here[x] >= upper) & (here[x] > *(here + x - 1)) & (here[x] >= here[x + 1]);
}

/* 0: edge along x, 2: along y, 1: down to the right, 3: down to the left. Branches would be mispredicted. */
static uint8_t orientation(int gx, int gy) {
    const int ax = abs(gx), ay = abs(gy), upright = ax > ay;
    const int maximum = upright ? ax : ay, minimum = upright ? ay : ax;
    const int oblique = -(2 * minimum >= maximum), left = 1 + 2 * ((gx ^ gy) >= 0);
    return (uint8_t)((left & oblique) | ((2 * upright) & ~oblique));
}

/* Keeps as anchors the maxima that lie across their edge; `from` is the first maximum. */
static void keep_anchors(const Rows *rows, const int16_t *here, size_t row, size_t width, size_t from,
                         Anchors *anchors) {
    const int16_t *up = rows->smooth[(row - 1) % SMOOTH], *level = rows->smooth[row % SMOOTH];
    const int16_t *down = rows->smooth[(row + 1) % SMOOTH];
    const int crosses = row % ANCHOR_SPACING == 0;
    int32_t *index = anchors->index.data;
    uint8_t *turn = anchors->orientation.data;
    size_t n = from;
    for (size_t i = from; i < anchors->index.used; i++) {
        const size_t x = (size_t)index[i] - row * width, a = x - 1, b = x + 1;
        int gx = (up[b] + 2 * level[b] + down[b]) - (up[a] + 2 * level[a] + down[a]);
        int gy = (down[a] - up[a]) + 2 * (down[x] - up[x]) + (down[b] - up[b]);
        int upright = (here[x] > here[a]) & (here[x] >= here[b]) & crosses;
        int flat = (here[x] >= rows->minimum[x]) & (here[x] > *(here + x - width)) & (here[x] >= here[x + width]);
        index[n] = index[i];
        turn[n] = orientation(gx, gy);
        n += (size_t)(abs(gx) > abs(gy) ? upright : flat);
    }
    anchors->index.used = anchors->orientation.used = n;
}

/* Appends the maxima among `from` to `to` of a row; groups of eight without one, most of them, are skipped, and in the
   others each pixel is written, to be kept or overwritten: branches would be mispredicted. */
static void append_maxima(const Rows *rows, size_t row, size_t width, size_t from, size_t to, Anchors *anchors) {
    int32_t *index = anchors->index.data;
    const int32_t start = (int32_t)(row * width);
    size_t n = anchors->index.used;
    for (size_t x = from; x < to;) {
        size_t end = to - x < 8 ? to : x + 8;
        uint64_t eight = 1;
        if (end == x + 8) memcpy(&eight, rows->is_anchor + x, 8);
        if (eight == 0) x = end;
        for (; x < end; x++) {
            index[n] = start + (int32_t)x;
            n += rows->is_anchor[x];
        }
    }
    anchors->index.used = n;
}

/* The anchors of a row whose neighbours have gradients; blocks without a strong pixel are skipped. */
static int find_anchors(const Rows *rows, const int16_t *magnitude, size_t row, size_t width, int16_t upper,
                        Anchors *anchors) {
    const int16_t *here = magnitude + row * width;
    const size_t last = width - MARGIN - 1, first = anchors->index.used;
    if (!reserve(&anchors->index, width) || !reserve(&anchors->orientation, width)) return 0;
    for (size_t from = MARGIN + 1; from < last; from += BLOCK) {
        size_t to = last - from < BLOCK ? last : from + BLOCK;
        if (strongest(here, from, to) < upper) continue;
        mark_maxima(rows, here, width, from, to, upper, row % ANCHOR_SPACING == 0);
        append_maxima(rows, row, width, from, to, anchors);
    }
    if (anchors->index.used > first) keep_anchors(rows, here, row, width, first, anchors);
    return 1;
}

static int find_gradient(const Image *image, int upper, int16_t *magnitude, Anchors *anchors) {
    const size_t height = image->height, width = image->width, margin = MARGIN, rim = margin * width;
    if (height <= 2 * margin || width <= 2 * margin) {
        memset(magnitude, 0, height * width * sizeof *magnitude);
        return 1;
    }
    Rows rows;
    if (!allocate_rows(&rows, width, (int16_t)upper)) return 0;
    memset(magnitude, 0, rim * sizeof *magnitude);
    memset(magnitude + height * width - rim, 0, rim * sizeof *magnitude);
    smooth_image_row(image, margin - 1, &rows);
    smooth_image_row(image, margin, &rows);
    int done = 1;
    for (size_t y = margin; y < height - margin && done; y++) {
        int16_t *here = magnitude + y * width;
        smooth_image_row(image, y + 1, &rows);
        gradient_row(&rows, y, width, here);
        memset(here, 0, margin * sizeof *here);
        memset(here + width - margin, 0, margin * sizeof *here);
        if (y >= margin + 2) done = find_anchors(&rows, magnitude, y - 1, width, (int16_t)upper, anchors);
    }
    free(rows.memory);
    return done;
}

PyObject *call_gradient(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {
        {"image", IMAGE, {N, M}}, {"bits", WHOLE, {8, 16}}, {"upper", WHOLE, {1, INT16_MAX}}, {">magnitude", INT16, {N, M}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const Py_buffer *image = &a.view[0];
    const int bits = (int)a.number[1][0].whole;
    if (image->itemsize != (bits > 8 ? 2 : 1)) {
        PyErr_Format(PyExc_TypeError, "image: elements of %zd bytes do not hold %d bits", image->itemsize, bits);
        return close_arguments(&a, NULL);
    }
    const Image data = {image->buf, (size_t)image->shape[0], (size_t)image->shape[1], bits};
    Anchors anchors = {{NULL, 0, 0, sizeof(int32_t)}, {NULL, 0, 0, sizeof(uint8_t)}};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = find_gradient(&data, (int)a.number[2][0].whole, a.view[3].buf, &anchors);
    Py_END_ALLOW_THREADS
    PyObject *result = Py_BuildValue("(NN)", list_bytes(done, &anchors.index), list_bytes(done, &anchors.orientation));
    return close_arguments(&a, result);
}
