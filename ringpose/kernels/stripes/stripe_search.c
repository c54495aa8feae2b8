/* Ridge detection: the noise of the second derivative, the coarse search for cells that may contain a ridge, and the
   ridges of the smoothed image in these cells.

   Noise, clutter included, is a low quantile of samples over an area so tall that stripes fill less than half of it.
   The coarse search uses integer sums over cells of 4 x 16 pixels, because most of a frame is dark: a window is two
   cells, one above the other, and its value is their sum less that of the cells above and below, one cell away. */
#include "stripe_search.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Sampled rows of a block, spread over the area, and rows that are processed together; a sample is the mean of some
   columns. */
enum { STRIPS = 8, GROUP = 4, PIXELS = GROUP * BLOCK };
enum { COLUMNS = 4, SAMPLES = STRIPS * BLOCK / COLUMNS, RANK = 6 };

/* Expected value of the sample of that rank for white noise with a response of 1. */
#define RANK_VALUE 0.542f

/* Standard deviation of rounding to whole grey values. */
#define ROUNDING_NOISE 0.289

/* Sum of the two pixels that have the same tap, above and below a row; exact in float. The loop over a block is
   vectorised only if it is not unrolled. */
#define FOLD(name, Pixel, value)                                                                                   \
    VECTOR_LOOP                                                                                                    \
    static void name(const Pixel *restrict lit, const Pixel *restrict dark, size_t reach, size_t width,            \
                     float *restrict out) {                                                                        \
        (void)dark;                                                                                                \
        for (size_t k = 0, up = reach * width, down = up; k <= reach; k++, up -= width, down += width)             \
            _Pragma("GCC unroll 1") for (size_t i = 0; i < BLOCK; i++)                                             \
                out[k * PIXELS + i] = (float)(value);                                                              \
    }

FOLD(fold_8, uint8_t, lit[up + i] + lit[down + i])
FOLD(fold_16, uint16_t, lit[up + i] + lit[down + i])
FOLD(fold_differences_8, uint8_t, (lit[up + i] - dark[up + i]) + (lit[down + i] - dark[down + i]))
FOLD(fold_differences_16, uint16_t, (lit[up + i] - dark[up + i]) + (lit[down + i] - dark[down + i]))

static void fold_border(const StripeImage *image, ptrdiff_t middle, size_t column, size_t reach, float *out) {
    for (size_t k = 0; k <= reach; k++) {
        size_t up = clamped(middle - (ptrdiff_t)k, image->height), down = clamped(middle + (ptrdiff_t)k, image->height);
        for (size_t i = 0; i < BLOCK; i++) {
            size_t x = clamped((ptrdiff_t)(column + i), image->width);
            out[k * PIXELS + i] = pixel_at(image, up * image->width + x) + pixel_at(image, down * image->width + x);
        }
    }
}

static void fold(const StripeImage *image, ptrdiff_t middle, size_t column, size_t reach, float *out) {
    ptrdiff_t top = middle - (ptrdiff_t)reach;
    size_t width = image->width, at = (size_t)(top < 0 ? 0 : top) * width + column;
    const uint8_t *lit_8 = image->lit, *dark_8 = image->dark;
    const uint16_t *lit_16 = image->lit, *dark_16 = image->dark;
    if (!is_inside(image, top, column, 2 * reach + 1))
        fold_border(image, middle, column, reach, out);
    else if (image->wide && image->dark)
        fold_differences_16(lit_16 + at, dark_16 + at, reach, width, out);
    else if (image->wide)
        fold_16(lit_16 + at, NULL, reach, width, out);
    else if (image->dark)
        fold_differences_8(lit_8 + at, dark_8 + at, reach, width, out);
    else
        fold_8(lit_8 + at, NULL, reach, width, out);
    for (size_t i = 0; i < BLOCK; i++) out[i] *= 0.5f; /* the middle counts once */
}

/* Second derivative. */
VECTOR_LOOP
static void bend_folded(const Filter *filter, const float *restrict folded, float *restrict curvature) {
    const float *restrict tap = filter->curvature;
    for (size_t i = 0; i < PIXELS; i++) curvature[i] = tap[0] * folded[i];
    for (size_t k = 1; k <= filter->reach; k++)
        for (size_t i = 0; i < PIXELS; i++) curvature[i] += tap[k] * folded[k * PIXELS + i];
}

/* Mean absolute responses of GROUP rows of a block, four columns each. */
static void sample(const Noise *noise, size_t row, size_t block, size_t first, float *value) {
    const StripeImage *image = noise->image;
    size_t rows = image->height - row < NOISE_ROWS ? image->height - row : NOISE_ROWS;
    size_t blocks = noise->blocks - block < NOISE_BLOCKS ? noise->blocks - block : NOISE_BLOCKS;
    float folded[(MAX_REACH + 1) * PIXELS] __attribute__((aligned(64))), all[PIXELS], *curvature = all;
    for (size_t i = 0; i < GROUP; i++) {
        ptrdiff_t middle = (ptrdiff_t)(row + (2 * (first + i) + 1) * rows / (2 * STRIPS));
        fold(image, middle, (block + (first + i) % blocks) * BLOCK, noise->filter->reach, folded + i * BLOCK);
    }
    bend_folded(noise->filter, folded, curvature);
    for (size_t i = 0; i < PIXELS / COLUMNS; i++, curvature += COLUMNS)
        value[i] = ((fabsf(curvature[0]) + fabsf(curvature[1])) +
                    (fabsf(curvature[2]) + fabsf(curvature[3]))) / COLUMNS;
}

/* The sample of rank RANK. Counting smaller samples needs no branches. */
VECTOR_LOOP
static float ranked(const float *restrict value) {
    int32_t smaller[SAMPLES] = {0};
    float found = 0;
    for (size_t j = 0; j < SAMPLES; j++)
        for (size_t i = 0; i < SAMPLES; i++) smaller[i] += value[j] < value[i];
    for (size_t i = 0; i < SAMPLES; i++) found = smaller[i] <= RANK && value[i] > found ? value[i] : found;
    return found;
}

static float area_noise(const Noise *noise, size_t area) {
    size_t row = area / noise->areas_across * NOISE_ROWS, block = area % noise->areas_across * NOISE_BLOCKS;
    float value[SAMPLES];
    for (size_t i = 0; i < STRIPS; i += GROUP) sample(noise, row, block, i, value + i * BLOCK / COLUMNS);
    float rounding = (float)(ROUNDING_NOISE * noise->filter->bend_norm), figure = ranked(value) / RANK_VALUE;
    return figure > rounding ? figure : rounding;
}

float noise_at(const Noise *noise, size_t row, size_t block) {
    size_t area = row / NOISE_ROWS * noise->areas_across + block / NOISE_BLOCKS;
    if (noise->figure[area] < 0) noise->figure[area] = area_noise(noise, area);
    return noise->figure[area];
}

/* Distance of the cells that a window is compared with from its first cell. */
enum { ABOVE = 2, BELOW = 3, RING = ABOVE + BELOW + 1 };

/* Rows of windows that wait until all rows of their noise area have been read, with one above and one below. */
enum { AREA = NOISE_ROWS / CELL, WINDOWS = AREA + 3 };

/* A window is skipped if an overlapping one is brighter by this factor. */
enum { WINDOW_SHARE = 4 };

/* Share of the threshold above which a window beside one with a ridge is kept, too: it may contain the end of the
   stripe. */
#define NEIGHBOUR_SHARE 0.4f

typedef struct {
    const Noise *noise;
    const StripeParams *params;
    size_t blocks, cells;
    int32_t *sums;     /* of a ring of rows of cells */
    int32_t *windows;  /* of a ring of rows of windows */
    int32_t *open_run; /* last of each block, or -1 */
    uint64_t *row_sum; /* scratch: a row of cells in halves or quarters of blocks */
    uint8_t *active;   /* scratch: a row of windows */
    uint8_t *selected;   /* windows that bands ask for, from those that begin in cell -1; or NULL */
    uint8_t *selected_rows;    /* rows of windows that hold some of those */
    ptrdiff_t first, end; /* of these rows */
    size_t *extent;    /* of each row of cells that are needed, first and one after last; from cell -3 */
    List *runs;
} Search;

static int32_t *cell_row(const Search *search, ptrdiff_t cell) {
    return search->sums + (size_t)(cell + RING) % RING * search->blocks;
}

static int32_t *window_row(const Search *search, ptrdiff_t cell) {
    return search->windows + (size_t)(cell + WINDOWS) % WINDOWS * search->blocks;
}

/* ---- sums ---- */

/* Eight bytes at a time: even and odd pixels in lanes of twice their width, in memory order. */
VECTOR_LOOP
static void add_rows(const uint8_t *const in[CELL], size_t from, size_t to, int bits, uint64_t *restrict sum) {
    const uint64_t lanes = bits == 8 ? UINT64_C(0x00ff00ff00ff00ff) : UINT64_C(0x0000ffff0000ffff);
    for (size_t row = 0; row < CELL; row++)
        for (size_t i = from; i < to; i++) {
            uint64_t w;
            memcpy(&w, in[row] + 8 * i, 8);
            sum[i] = (row ? sum[i] : 0) + (w & lanes) + (w >> bits & lanes);
        }
}

static void add_blocks_8(const uint64_t *part, size_t from, size_t to, int32_t sign, int32_t *sum) {
    for (size_t block = from; block < to; block++) {
        uint64_t lanes = part[2 * block] + part[2 * block + 1]; /* at most 16 * 255 each */
        sum[block] += sign * (int32_t)(lanes * UINT64_C(0x0001000100010001) >> 48);
    }
}

static void add_blocks_16(const uint64_t *part, size_t from, size_t to, int32_t sign, int32_t *sum) {
    for (size_t block = from; block < to; block++) {
        const uint64_t *four = part + 4 * block;
        uint64_t lanes = (four[0] + four[1]) + (four[2] + four[3]);
        sum[block] += sign * (int32_t)(uint32_t)(lanes + (lanes >> 32));
    }
}

/* The last block, if it reaches beyond the border: the outermost column is repeated. */
static int32_t border_sum(const StripeImage *image, const void *pixels, const size_t rows[CELL], size_t block) {
    int32_t sum = 0;
    for (size_t i = 0; i < CELL; i++)
        for (size_t x = block * BLOCK; x < (block + 1) * BLOCK; x++) {
            size_t at = rows[i] * image->width + (x < image->width ? x : image->width - 1);
            sum += image->wide ? ((const uint16_t *)pixels)[at] : ((const uint8_t *)pixels)[at];
        }
    return sum;
}

static void add_pixels(const Search *search, const void *pixels, const size_t rows[CELL], size_t from, size_t to,
                       int32_t sign, int32_t *sum) {
    const StripeImage *image = search->noise->image;
    size_t whole = image->width / BLOCK, end = to < whole ? to : whole;
    size_t bytes = image->wide ? 2 : 1, parts = image->wide ? 4 : 2;
    const uint8_t *in[CELL];
    for (size_t i = 0; i < CELL; i++) in[i] = (const uint8_t *)pixels + rows[i] * image->width * bytes;
    if (from < end) {
        add_rows(in, parts * from, parts * end, image->wide ? 16 : 8, search->row_sum);
        (image->wide ? add_blocks_16 : add_blocks_8)(search->row_sum, from, end, sign, sum);
    }
    if (to > whole) sum[whole] += sign * border_sum(image, pixels, rows, whole);
}

/* Sums of a row of cells, which may lie beyond the border. */
static void add_cells(const Search *search, ptrdiff_t cell, size_t from, size_t to) {
    const StripeImage *image = search->noise->image;
    int32_t *sum = cell_row(search, cell);
    size_t rows[CELL];
    for (size_t i = 0; i < CELL; i++) rows[i] = clamped(cell * CELL + (ptrdiff_t)i, image->height);
    memset(sum + from, 0, (to - from) * sizeof *sum);
    add_pixels(search, image->lit, rows, from, to, 1, sum);
    if (image->dark) add_pixels(search, image->dark, rows, from, to, -1, sum);
}

/* ---- windows ---- */

/* Sum of two cells less the darker of the pairs next to them and beyond: steep stripes extend into the former, clutter
   into the latter. */
VECTOR_LOOP
static void add_windows(const int32_t *const cells[RING], size_t blocks, int32_t *restrict window) {
    const int32_t *restrict far_above = cells[0], *restrict above = cells[1], *restrict first = cells[2];
    const int32_t *restrict second = cells[3], *restrict below = cells[4], *restrict far_below = cells[5];
    for (size_t b = 0; b < blocks; b++) {
        int32_t near = above[b] + below[b], far = far_above[b] + far_below[b];
        window[b] = (first[b] + second[b]) - (near < far ? near : far);
    }
}

/* A row of windows; those outside all bands are 0. */
static void find_windows(const Search *search, ptrdiff_t cell) {
    int32_t *window = window_row(search, cell);
    if (search->selected && !search->selected_rows[cell + 1]) {
        memset(window, 0, search->blocks * sizeof *window);
        return;
    }
    const int32_t *cells[RING];
    for (ptrdiff_t i = 0; i < RING; i++) cells[i] = cell_row(search, cell - ABOVE + i);
    add_windows(cells, search->blocks, window);
    if (!search->selected) return;
    const uint8_t *selected = search->selected + (size_t)(cell + 1) * search->blocks;
    for (size_t b = 0; b < search->blocks; b++) window[b] = selected[b] ? window[b] : 0;
}

VECTOR_LOOP
static void mark_windows(const int32_t *restrict before, const int32_t *restrict here, const int32_t *restrict after,
                         int32_t minimum, size_t blocks, uint8_t *restrict active) {
    for (size_t b = 0; b < blocks; b++) {
        int32_t maximum = before[b] > after[b] ? before[b] : after[b];
        active[b] = (here[b] >= minimum) & (WINDOW_SHARE * here[b] >= maximum);
    }
}

static int add_run(Search *search, size_t block, int32_t first, int32_t last) {
    int32_t open = search->open_run[block];
    Run *run = search->runs->data;
    if (open >= 0 && run[open].last + 1 >= first) {
        if (run[open].last < last) run[open].last = last;
        return 1;
    }
    if (!reserve(search->runs, 1)) return 0;
    search->open_run[block] = (int32_t)search->runs->used;
    ((Run *)search->runs->data)[search->runs->used++] = (Run){(int32_t)block, first, last};
    return 1;
}

/* A window that may hold a ridge, and its neighbours where a stripe may end. */
static int keep_window(Search *search, ptrdiff_t cell, size_t block, const int32_t *window) {
    size_t row = clamped((cell + 1) * CELL, search->noise->image->height);
    float minimum = (float)search->params->coarse_per_response *
                  min_response(search->params, noise_at(search->noise, row, block));
    if ((float)window[block] < minimum) return 1;
    size_t from = block > 0 ? block - 1 : 0, to = block + 1 < search->blocks ? block + 1 : block;
    int32_t first = cell < 0 ? 0 : (int32_t)cell, last = (int32_t)clamped(cell + 1, search->cells);
    for (size_t b = from; b <= to; b++)
        if ((float)window[b] >= NEIGHBOUR_SHARE * minimum && !add_run(search, b, first, last)) return 0;
    return 1;
}

static int keep_windows(Search *search, ptrdiff_t cell, int32_t minimum) {
    const int32_t *here = window_row(search, cell);
    if (search->selected && !search->selected_rows[cell + 1]) return 1;
    mark_windows(window_row(search, cell - 1), here, window_row(search, cell + 1), minimum, search->blocks,
                 search->active);
    for (size_t from = 0; from < search->blocks; from += 8) {
        uint64_t eight = 1;
        size_t to = search->blocks - from < 8 ? search->blocks : from + 8;
        if (to == from + 8) memcpy(&eight, search->active + from, 8);
        if (eight == 0) continue;
        for (size_t b = from; b < to; b++)
            if (search->active[b] && !keep_window(search, cell, b, here)) return 0;
    }
    return 1;
}

/* ---- bands ---- */

/* Marks cells and windows of blocks, for rows of pixels. */
static void mark_band(Search *search, size_t from, size_t to, size_t top, size_t bottom) {
    size_t first = top / CELL, end = (bottom + CELL - 1) / CELL + 1;
    for (size_t row = first; row < end; row++) {
        memset(search->selected + row * search->blocks + from, 1, to - from);
        search->selected_rows[row] = 1;
    }
    for (size_t row = first; row < end + ABOVE + BELOW; row++) {
        size_t *extent = search->extent + 2 * row;
        if (extent[1] == 0 || extent[0] > from) extent[0] = from;
        if (extent[1] < to) extent[1] = to;
    }
}

static int mark_bands(Search *search, const Bands *bands) {
    const StripeImage *image = search->noise->image;
    size_t blocks = search->blocks, rows = search->cells + 1, all = rows + ABOVE + BELOW;
    search->extent = calloc(2 * all, sizeof *search->extent);
    search->selected = calloc(rows * blocks + rows, 1);
    if (search->selected == NULL || search->extent == NULL) return 0;
    search->selected_rows = search->selected + rows * blocks;
    for (size_t band = 0; band < bands->count; band++) {
        const int32_t *side = bands->sides + SIDES * band;
        size_t left = clamped(side[0], image->width + 1), right = clamped(side[1], image->width + 1);
        size_t top = clamped(side[2], image->height + 1), bottom = clamped(side[3], image->height + 1);
        if (left < right && top < bottom) mark_band(search, left / BLOCK, (right - 1) / BLOCK + 1, top, bottom);
    }
    while (search->first < search->end && !search->selected_rows[search->first + 1]) search->first++;
    while (search->first < search->end && !search->selected_rows[search->end]) search->end--;
    return 1;
}

/* ---- all ---- */

/* Keeps windows from row to row. */
static int keep_rows(Search *search, ptrdiff_t from, ptrdiff_t to) {
    double minimum = (double)(float)search->params->coarse_per_response * (float)search->params->min_response;
    int32_t minimum_sum = minimum < 1 ? 1 : minimum < 1e9 ? (int32_t)minimum : 1000000000;
    for (ptrdiff_t cell = from; cell < to; cell++)
        if (!keep_windows(search, cell, minimum_sum)) return 0;
    return 1;
}

/* One pass over the rows of cells. Windows are evaluated when their last cell is known, and kept when their whole noise
   area has been read, whose samples are then in the cache. */
static int pass(Search *search) {
    ptrdiff_t first = search->first, end = search->end, kept = first;
    const size_t whole[2] = {0, search->blocks};
    for (ptrdiff_t window = first - ABOVE - BELOW; window < end; window++) {
        const size_t *extent = search->selected ? search->extent + 2 * (window + BELOW + 1 + ABOVE) : whole;
        if (extent[0] < extent[1]) add_cells(search, window + BELOW, extent[0], extent[1]);
        if (window >= first) find_windows(search, window);
        if (window <= first || window % AREA) continue;
        if (!keep_rows(search, kept, window - 1)) return 0;
        kept = window - 1;
    }
    memset(window_row(search, end), 0, search->blocks * sizeof *search->windows);
    return keep_rows(search, kept, end);
}

int find_runs(const Noise *noise, const StripeParams *params, const Bands *bands, List *runs) {
    size_t cells = (noise->image->height + CELL - 1) / CELL;
    Search search = {.noise = noise, .params = params, .blocks = noise->blocks, .cells = cells, .runs = runs};
    search.first = -1;
    search.end = (ptrdiff_t)cells;
    search.sums = calloc((RING + WINDOWS + 1) * search.blocks, sizeof *search.sums);
    search.row_sum = malloc(4 * search.blocks * sizeof *search.row_sum);
    search.active = malloc(search.blocks);
    int done = search.sums && search.row_sum && search.active && (!bands->sides || mark_bands(&search, bands));
    if (done) {
        search.windows = search.sums + RING * search.blocks;
        search.open_run = search.windows + WINDOWS * search.blocks;
        for (size_t b = 0; b < search.blocks; b++) search.open_run[b] = -1;
        done = pass(&search);
    }
    free(search.sums);
    free(search.row_sum);
    free(search.active);
    free(search.selected);
    free(search.extent);
    return done;
}

/* 1 where the response is at least so strong and strongest in its column. */
static void mark_ridges(const float *restrict response, float minimum, size_t count, uint8_t *restrict ridge) {
    const float *restrict above = response - BLOCK, *restrict below = response + BLOCK;
    for (size_t i = 0; i < count; i++)
        ridge[i] = (response[i] < above[i]) & (response[i] <= below[i]) & (response[i] <= -minimum);
}

static Ridge ridge_at(const float *here, int32_t column, int32_t row, float noise) {
    float before = *(here - BLOCK), after = here[BLOCK], curvature = (before + after) - 2 * here[0];
    float shift = 0.5f * (before - after) / curvature;
    return (Ridge){column, row, (float)row + shift, -here[0], curvature, noise, -1};
}

/* Indices of the ridges among eight pixels; without branches, which would be mispredicted. */
static size_t places(const uint8_t *ridge, size_t columns, uint8_t place[8]) {
    size_t count = 0;
    for (uint8_t i = 0; i < 8; i++) {
        place[count] = i;
        count += ridge[i] & (i < columns);
    }
    return count;
}

/* Ridges in rows of one area of noise. */
static int smooth_rows(const Noise *noise, const StripeParams *params, size_t block, size_t first, size_t rows,
                       Patch *patch, List *found) {
    uint8_t ridge[CHUNK * BLOCK], place[8];
    size_t reach = noise->filter->reach, columns = noise->image->width - block * BLOCK, pairs = (rows + 3) / 2;
    float figure = noise_at(noise, first, block);
    const float *response = patch->curvature + BLOCK;
    load_pixels(noise->image, (ptrdiff_t)first - 1 - (ptrdiff_t)reach, block * BLOCK, 2 * (pairs + reach), patch);
    bend_pixels(noise->filter, 2 * pairs * BLOCK, patch);
    mark_ridges(response, min_response(params, figure), rows * BLOCK, ridge);
    for (size_t i = 0; i < rows * BLOCK; i += 8) {
        uint64_t eight;
        memcpy(&eight, ridge + i, sizeof eight);
        if (eight == 0) continue;
        if (!reserve(found, 8)) return 0;
        size_t count = places(ridge + i, columns > i % BLOCK ? columns - i % BLOCK : 0, place);
        for (size_t j = 0; j < count; j++) {
            size_t at = i + place[j];
            ((Ridge *)found->data)[found->used++] =
                ridge_at(response + at, (int32_t)(at % BLOCK), (int32_t)(first + at / BLOCK), figure);
        }
    }
    return 1;
}

/* Ridges of one run of cells; the outermost rows of the image have none. */
static int smooth_run(const Noise *noise, const StripeParams *params, const Run *run, Patch *patch, List *found) {
    size_t last = noise->image->height - 1, first = (size_t)run->first * CELL, end = (size_t)(run->last + 1) * CELL;
    if (first == 0) first = 1;
    if (end > last) end = last;
    while (first < end) {
        size_t rows = NOISE_ROWS - first % NOISE_ROWS;
        if (rows > CHUNK) rows = CHUNK;
        if (rows > end - first) rows = end - first;
        if (!smooth_rows(noise, params, (size_t)run->block, first, rows, patch, found)) return 0;
        first += rows;
    }
    return 1;
}

/* The ridges of one block, sorted by column, appended to all. */
static int append_sorted(size_t block, const List *found, List *ridges) {
    if (!reserve(ridges, found->used)) return 0;
    size_t place[BLOCK] = {0}, next = ridges->used;
    const Ridge *ridge = found->data;
    for (size_t i = 0; i < found->used; i++) place[ridge[i].x]++;
    for (size_t x = 0; x < BLOCK; x++) {
        size_t count = place[x];
        place[x] = next;
        next += count;
    }
    for (size_t i = 0; i < found->used; i++) {
        Ridge *out = (Ridge *)ridges->data + place[ridge[i].x]++;
        *out = ridge[i];
        out->x += (int32_t)(block * BLOCK);
    }
    ridges->used = next;
    return 1;
}

/* The runs by blocks; `end` of each block among them. */
static Run *sorted_runs(const List *runs, size_t blocks, size_t *end) {
    const Run *run = runs->data;
    Run *sorted = malloc((runs->used + 1) * sizeof *sorted);
    if (sorted == NULL) return NULL;
    memset(end, 0, (blocks + 1) * sizeof *end);
    for (size_t i = 0; i < runs->used; i++) end[run[i].block + 1]++;
    for (size_t b = 0; b < blocks; b++) end[b + 1] += end[b];
    for (size_t i = 0; i < runs->used; i++) sorted[end[run[i].block]++] = run[i];
    return sorted;
}

int find_ridges(const Noise *noise, const StripeParams *params, const List *runs, List *found, List *ridges) {
    size_t *end = malloc((noise->blocks + 1) * sizeof *end);
    Run *sorted = end ? sorted_runs(runs, noise->blocks, end) : NULL;
    Patch patch;
    int done = sorted != NULL && reserve(ridges, runs->used * BLOCK / 2);
    for (size_t i = 0, block = 0; done && block < noise->blocks; block++) {
        found->used = 0;
        for (; done && i < end[block]; i++) done = smooth_run(noise, params, sorted + i, &patch, found);
        if (done && found->used) done = append_sorted(block, found, ridges);
    }
    free(end);
    free(sorted);
    return done;
}
