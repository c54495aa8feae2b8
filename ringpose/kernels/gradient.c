/* Smoothing, gradient and anchors in one pass over the rows; twin: reference.gradient.

   A smoothed value is 16 grey values, so that a dim edge keeps its shape; a Sobel difference of those is
   128 grey values a pixel. 8-bit images keep every sum within 16 bits: 255 * 16 * 16 = 65280 unsigned,
   4 * 4080 = 16320 for one difference, 24480 for the magnitude. A 16-bit image needs another smooth_row
   only, which shifts its sums to the same scale. */
#include "kernels.h"

#include <stdlib.h>
#include <string.h>

/* Rows with two columns of margin, replicated (sums) or unused (the others). */
enum { MARGIN = 2 };

/* Pixels of a row that are looked at together. */
enum { BLOCK = 128 };

typedef struct {
    void *memory;
    uint16_t *sum;
    int16_t *smooth[3];
    int16_t *along, *across;
    int16_t *gx[2], *gy[2];
    int16_t *orientation;
    uint8_t *is_anchor;
} Rows;

static int allocate_rows(Rows *rows, size_t width) {
    size_t stride = width + 2 * MARGIN;
    if (stride > SIZE_MAX / 32) return 0;
    rows->memory = calloc(12 * stride, sizeof(int16_t));
    if (rows->memory == NULL) return 0;
    int16_t *row = (int16_t *)rows->memory + MARGIN;
    rows->sum = (uint16_t *)row;
    for (int i = 0; i < 3; i++) rows->smooth[i] = row + (size_t)(1 + i) * stride;
    rows->along = row + 4 * stride;
    rows->across = row + 5 * stride;
    for (int i = 0; i < 2; i++) {
        rows->gx[i] = row + (size_t)(6 + i) * stride;
        rows->gy[i] = row + (size_t)(8 + i) * stride;
    }
    rows->orientation = row + 10 * stride;
    rows->is_anchor = (uint8_t *)(row + 11 * stride);
    return 1;
}

/* Binomial 1 4 6 4 1 down the columns, then along the row; the border pixel is repeated outside. */
VECTOR_LOOP
static void smooth_row(const uint8_t *const restrict in[5], size_t width, uint16_t *restrict sum, int16_t *restrict out) {
    const uint8_t *restrict a = in[0], *restrict b = in[1], *restrict c = in[2], *restrict d = in[3], *restrict e = in[4];
    for (size_t x = 0; x < width; x++) sum[x] = (uint16_t)(a[x] + 4 * (b[x] + d[x]) + 6 * c[x] + e[x]);
    for (int i = 1; i <= MARGIN; i++) {
        *(sum - i) = sum[0];
        sum[width - 1 + (size_t)i] = sum[width - 1];
    }
    const uint16_t *restrict s = sum;
    for (size_t x = 0; x < width; x++) {
        const uint16_t *at = s + x;
        uint16_t total = (uint16_t)(*(at - 2) + 4 * (*(at - 1) + at[1]) + 6 * at[0] + at[2] + 8);
        out[x] = (int16_t)(total >> 4);
    }
}

/* Sobel, and the magnitude of both components. */
VECTOR_LOOP
static void gradient_row(const Rows *rows, size_t row, size_t width, int16_t *restrict magnitude) {
    const int16_t *restrict up = rows->smooth[(row + 2) % 3], *restrict here = rows->smooth[row % 3];
    const int16_t *restrict down = rows->smooth[(row + 1) % 3];
    int16_t *restrict along = rows->along, *restrict across = rows->across;
    int16_t *restrict gx = rows->gx[row % 2], *restrict gy = rows->gy[row % 2];
    for (size_t x = 0; x < width; x++) {
        along[x] = (int16_t)(up[x] + 2 * here[x] + down[x]);
        across[x] = (int16_t)(down[x] - up[x]);
    }
    for (size_t x = 1; x + 1 < width; x++) {
        int16_t dx = (int16_t)(along[x + 1] - along[x - 1]);
        int16_t dy = (int16_t)(across[x - 1] + 2 * across[x] + across[x + 1]);
        int16_t ax = (int16_t)(dx < 0 ? -dx : dx), ay = (int16_t)(dy < 0 ? -dy : dy);
        int16_t most = ax > ay ? ax : ay, least = ax > ay ? ay : ax;
        magnitude[x] = (int16_t)(most + ((uint16_t)(3 * least) >> 3));
        gx[x] = dx;
        gy[x] = dy;
    }
}

VECTOR_LOOP
static int16_t strongest(const int16_t *magnitude, size_t from, size_t to) {
    int16_t most = 0;
    for (size_t x = from; x < to; x++) most = magnitude[x] > most ? magnitude[x] : most;
    return most;
}

/* Orientation (0: edge along x, 2: along y, 1: down to the right, 3: down to the left), and 1 where the magnitude is a
   maximum across the edge; of two equal ones the earlier in raster order. */
VECTOR_LOOP
static void mark_maxima(const Rows *rows, size_t row, const int16_t *restrict here, size_t width, size_t from, size_t to,
                        int16_t upper) {
    const int16_t *restrict up = here - width, *restrict down = here + width;
    const int16_t *restrict gx = rows->gx[row % 2], *restrict gy = rows->gy[row % 2];
    int16_t *restrict orientation = rows->orientation;
    uint8_t *restrict is_anchor = rows->is_anchor;
    for (size_t x = from; x < to; x++) {
        int16_t ax = (int16_t)(gx[x] < 0 ? -gx[x] : gx[x]), ay = (int16_t)(gy[x] < 0 ? -gy[x] : gy[x]);
        int16_t most = ax > ay ? ax : ay, least = ax > ay ? ay : ax;
        int16_t diagonal = (int16_t)((gx[x] ^ gy[x]) < 0 ? 1 : 3);
        int16_t straight = (int16_t)(ax > ay ? 2 : 0);
        int16_t turn = (int16_t)(2 * least) < most ? straight : diagonal;
        int16_t nw = *(up + x - 1), n = up[x], ne = up[x + 1], w = *(here + x - 1);
        int16_t e = here[x + 1], sw = *(down + x - 1), s = down[x], se = down[x + 1];
        int16_t before = turn == 0 ? n : turn == 1 ? ne : turn == 2 ? w : nw;
        int16_t after = turn == 0 ? s : turn == 1 ? sw : turn == 2 ? e : se;
        orientation[x] = turn;
        is_anchor[x] = (here[x] >= upper) & (here[x] > before) & (here[x] >= after);
    }
}

/* Appends the anchors among `from` to `to` of a row; groups of eight without one, most of them, are skipped. */
static void keep_anchors(const Rows *rows, size_t first_index, size_t from, size_t to, Anchors *anchors) {
    int32_t *index = anchors->index.data;
    uint8_t *turn = anchors->orientation.data;
    size_t n = anchors->index.used;
    for (size_t x = from; x < to;) {
        size_t end = to - x < 8 ? to : x + 8;
        uint64_t eight = 1;
        if (end == x + 8) memcpy(&eight, rows->is_anchor + x, 8);
        if (eight == 0) x = end;
        for (; x < end; x++) {
            index[n] = (int32_t)(first_index + x);
            turn[n] = (uint8_t)rows->orientation[x];
            n += rows->is_anchor[x];
        }
    }
    anchors->index.used = anchors->orientation.used = n;
}

/* The anchors of a row whose neighbours above and below are known; blocks without a strong pixel are skipped. */
static int find_anchors(const Rows *rows, const int16_t *magnitude, size_t row, size_t width, int16_t upper,
                        Anchors *anchors) {
    const int16_t *here = magnitude + row * width;
    if (!reserve(&anchors->index, width) || !reserve(&anchors->orientation, width)) return 0;
    for (size_t from = 1; from + 1 < width; from += BLOCK) {
        size_t to = width - 1 - from < BLOCK ? width - 1 : from + BLOCK;
        if (strongest(here, from, to) < upper) continue;
        mark_maxima(rows, row, here, width, from, to, upper);
        keep_anchors(rows, row * width, from, to, anchors);
    }
    return 1;
}

static void smooth_at(const uint8_t *image, size_t height, size_t width, size_t row, const Rows *rows) {
    const uint8_t *in[5];
    for (size_t i = 0; i < 5; i++) {
        size_t y = row + i < MARGIN ? 0 : row + i - MARGIN;
        in[i] = image + (y < height ? y : height - 1) * width;
    }
    smooth_row(in, width, rows->sum, rows->smooth[row % 3]);
}

int find_gradient(const uint8_t *image, size_t height, size_t width, int upper, int16_t *magnitude, Anchors *anchors) {
    memset(magnitude, 0, width * sizeof *magnitude);
    memset(magnitude + (height - 1) * width, 0, width * sizeof *magnitude);
    if (height < 3 || width < 3) {
        memset(magnitude, 0, height * width * sizeof *magnitude);
        return 1;
    }
    Rows rows;
    if (!allocate_rows(&rows, width)) return 0;
    int done = 1;
    smooth_at(image, height, width, 0, &rows);
    smooth_at(image, height, width, 1, &rows);
    for (size_t y = 1; y < height && done; y++) {
        if (y + 1 < height) {
            int16_t *here = magnitude + y * width;
            smooth_at(image, height, width, y + 1, &rows);
            gradient_row(&rows, y, width, here);
            here[0] = here[width - 1] = 0;
        }
        if (y > 1) done = find_anchors(&rows, magnitude, y - 1, width, (int16_t)upper, anchors);
    }
    free(rows.memory);
    return done;
}
