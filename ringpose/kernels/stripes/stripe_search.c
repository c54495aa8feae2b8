/* Where ridges may be, from sums over cells of 4 x 16 pixels.

   Most of a frame is dark, and whole numbers tell so quickly. Two cells below each other are a window; it holds what
   is brighter than the cells above and below it, from which it is one cell apart. */
#include "stripes.h"

#include <stdlib.h>
#include <string.h>

/* Cells that a window is compared with lie so far from its first one. */
enum { ABOVE = 2, BELOW = 3, RING = ABOVE + BELOW + 1 };

/* Rows of windows that wait until all rows of their area of noise have been read, with one above and one below. */
enum { AREA = NOISE_ROWS / CELL, WINDOWS = AREA + 3 };

/* A window is passed over if one that overlaps it is brighter by this factor: ridges are half a cell off at most. */
enum { WINDOW_SHARE = 4 };

/* Beside a window with a ridge, one of which a stripe fills this share may hold its end. */
#define NEIGHBOUR_SHARE 0.4f

typedef struct {
    const Noise *noise;
    const StripeRules *rules;
    size_t blocks, cells;
    int32_t *sums;     /* of a ring of rows of cells */
    int32_t *windows;  /* of a ring of rows of windows */
    int32_t *open_run; /* last of each block, or -1 */
    uint64_t *row_sum; /* scratch: a row of cells in halves or quarters of blocks */
    uint8_t *active;   /* scratch: a row of windows */
    uint8_t *wanted;   /* windows that bands ask for, from those that begin in cell -1; or NULL */
    uint8_t *asked;    /* rows of windows that hold some of those */
    ptrdiff_t first, end; /* of these rows */
    uint8_t *needed;   /* cells that those look at, from cell -3 */
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

/* Eight bytes at a time: the even and odd pixels in lanes of twice their bits. Row after row, as memory is quickest
   read. */
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

/* Sums of those cells of a row that some wanted window looks at. */
static void add_needed_cells(const Search *search, ptrdiff_t cell) {
    size_t row = (size_t)(cell + 1 + ABOVE), end = search->extent[2 * row + 1];
    const uint8_t *need = search->needed + row * search->blocks;
    for (size_t b = search->extent[2 * row]; b < end;) {
        size_t from = b;
        while (b < end && need[b]) b++;
        if (b > from) add_cells(search, cell, from, b);
        while (b < end && !need[b]) b++;
    }
}

/* ---- windows ---- */

/* How much brighter two cells are than those next to them, or than those beyond if these are darker: steep stripes
   reach into the next ones, and what surrounds a stripe into those beyond. */
VECTOR_LOOP
static void add_windows(const int32_t *const cells[RING], size_t blocks, int32_t *restrict window) {
    const int32_t *restrict far_above = cells[0], *restrict above = cells[1], *restrict first = cells[2];
    const int32_t *restrict second = cells[3], *restrict below = cells[4], *restrict far_below = cells[5];
    for (size_t b = 0; b < blocks; b++) {
        int32_t near = above[b] + below[b], far = far_above[b] + far_below[b];
        window[b] = (first[b] + second[b]) - (near < far ? near : far);
    }
}

/* A row of windows; those that no band asks for are nothing. */
static void find_windows(const Search *search, ptrdiff_t cell) {
    int32_t *window = window_row(search, cell);
    if (search->wanted && !search->asked[cell + 1]) {
        memset(window, 0, search->blocks * sizeof *window);
        return;
    }
    const int32_t *cells[RING];
    for (ptrdiff_t i = 0; i < RING; i++) cells[i] = cell_row(search, cell - ABOVE + i);
    add_windows(cells, search->blocks, window);
    if (!search->wanted) return;
    const uint8_t *wanted = search->wanted + (size_t)(cell + 1) * search->blocks;
    for (size_t b = 0; b < search->blocks; b++) window[b] = wanted[b] ? window[b] : 0;
}

VECTOR_LOOP
static void mark_windows(const int32_t *restrict before, const int32_t *restrict here, const int32_t *restrict after,
                         int32_t least, size_t blocks, uint8_t *restrict active) {
    for (size_t b = 0; b < blocks; b++) {
        int32_t most = before[b] > after[b] ? before[b] : after[b];
        active[b] = (here[b] >= least) & (WINDOW_SHARE * here[b] >= most);
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
    float least = search->rules->coarse_per_response *
                  least_response(search->rules, noise_at(search->noise, row, block));
    if ((float)window[block] < least) return 1;
    size_t from = block > 0 ? block - 1 : 0, to = block + 1 < search->blocks ? block + 1 : block;
    int32_t first = cell < 0 ? 0 : (int32_t)cell, last = (int32_t)clamped(cell + 1, search->cells);
    for (size_t b = from; b <= to; b++)
        if ((float)window[b] >= NEIGHBOUR_SHARE * least && !add_run(search, b, first, last)) return 0;
    return 1;
}

static int keep_windows(Search *search, ptrdiff_t cell, int32_t least) {
    const int32_t *here = window_row(search, cell);
    if (search->wanted && !search->asked[cell + 1]) return 1;
    mark_windows(window_row(search, cell - 1), here, window_row(search, cell + 1), least, search->blocks,
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
        memset(search->wanted + row * search->blocks + from, 1, to - from);
        search->asked[row] = 1;
    }
    for (size_t row = first; row < end + ABOVE + BELOW; row++) {
        size_t *extent = search->extent + 2 * row;
        memset(search->needed + row * search->blocks + from, 1, to - from);
        if (extent[1] == 0 || extent[0] > from) extent[0] = from;
        if (extent[1] < to) extent[1] = to;
    }
}

static int mark_bands(Search *search, const Bands *bands) {
    const StripeImage *image = search->noise->image;
    size_t blocks = search->blocks, rows = search->cells + 1, all = rows + ABOVE + BELOW;
    search->extent = calloc(2 * all, sizeof *search->extent);
    search->wanted = calloc((rows + all) * blocks + rows, 1);
    if (search->wanted == NULL || search->extent == NULL) return 0;
    search->needed = search->wanted + rows * blocks;
    search->asked = search->needed + all * blocks;
    for (size_t band = 0; band < bands->count; band++) {
        const int32_t *side = bands->sides + SIDES * band;
        size_t left = clamped(side[0], image->width + 1), right = clamped(side[1], image->width + 1);
        size_t top = clamped(side[2], image->height + 1), bottom = clamped(side[3], image->height + 1);
        if (left < right && top < bottom) mark_band(search, left / BLOCK, (right - 1) / BLOCK + 1, top, bottom);
    }
    while (search->first < search->end && !search->asked[search->first + 1]) search->first++;
    while (search->first < search->end && !search->asked[search->end]) search->end--;
    return 1;
}

/* ---- all ---- */

/* Keeps windows from row to row. */
static int keep_rows(Search *search, ptrdiff_t from, ptrdiff_t to) {
    double least = (double)search->rules->coarse_per_response * search->rules->least_response;
    int32_t least_sum = least < 1 ? 1 : least < 1e9 ? (int32_t)least : 1000000000;
    for (ptrdiff_t cell = from; cell < to; cell++)
        if (!keep_windows(search, cell, least_sum)) return 0;
    return 1;
}

/* Rows of cells, from those that the first window is compared with; windows follow when their last cell is known, and
   are kept when those of the whole area of noise are: its samples are then at hand. */
static int pass(Search *search) {
    ptrdiff_t first = search->first, end = search->end, kept = first;
    for (ptrdiff_t window = first - ABOVE - BELOW; window < end; window++) {
        if (search->wanted)
            add_needed_cells(search, window + BELOW);
        else
            add_cells(search, window + BELOW, 0, search->blocks);
        if (window >= first) find_windows(search, window);
        if (window <= first || window % AREA) continue;
        if (!keep_rows(search, kept, window - 1)) return 0;
        kept = window - 1;
    }
    memset(window_row(search, end), 0, search->blocks * sizeof *search->windows);
    return keep_rows(search, kept, end);
}

int find_runs(const Noise *noise, const StripeRules *rules, const Bands *bands, List *runs) {
    size_t cells = (noise->image->height + CELL - 1) / CELL;
    Search search = {.noise = noise, .rules = rules, .blocks = noise->blocks, .cells = cells, .runs = runs};
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
    free(search.wanted);
    free(search.extent);
    return done;
}
