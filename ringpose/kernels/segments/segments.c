/* Least-squares lines through the sub-pixel edge positions of straight pieces, and joining of lines that continue each
   other. Line ends are looked up in a grid of square cells, half as wide as the reach of a growing line. */
#include "arguments.h"

#include <math.h>
#include <stdlib.h>

#include "segments.h"

typedef struct {
    const int16_t *data;
    size_t height, width;
} Magnitude;

typedef struct {
    double start_x, start_y, end_x, end_y;
} Line;

typedef struct {
    double count, x, y, xx, xy, yy;
} Moments;

typedef struct {
    double max_gap;       /* along the line, pixels */
    double max_offset;     /* of an end from the joined line, pixels */
    int64_t min_pixels; /* pixels of a line to which others are joined */
} JoinParams;

/* Adds the sub-pixel maximum of the magnitude across the piece, if the pixel is one. */
static void add_crest(const Magnitude *magnitude, Pixel at, int flat, Moments *sum) {
    if (at.x < 1 || at.y < 1 || at.x >= (int32_t)magnitude->width - 1 || at.y >= (int32_t)magnitude->height - 1) return;
    ptrdiff_t width = (ptrdiff_t)magnitude->width, step = flat ? width : 1;
    const int16_t *value = magnitude->data + at.y * width + at.x;
    int before = *(value - step), here = *value, after = value[step];
    int curvature = before - 2 * here + after;
    if (before > here || after > here || curvature == 0) return;
    double shift = (before - after) / (2.0 * curvature);
    double x = at.x + (flat ? 0.0 : shift), y = at.y + (flat ? shift : 0.0);
    sum->count += 1;
    sum->x += x;
    sum->y += y;
    sum->xx += x * x;
    sum->xy += x * y;
    sum->yy += y * y;
}

static int line_through(const Moments *sum, int flat, double *slope, double *offset) {
    double u = flat ? sum->x : sum->y, v = flat ? sum->y : sum->x, uu = flat ? sum->xx : sum->yy;
    double spread = sum->count * uu - u * u;
    if (!(spread > 0)) return 0;
    *slope = (sum->count * sum->xy - u * v) / spread;
    *offset = (v - *slope * u) / sum->count;
    return 1;
}

static Line fitted(const Magnitude *magnitude, const Pixel *pixel, size_t count, size_t trim, Moments *sum) {
    Pixel start = pixel[0], end = pixel[count - 1];
    int flat = llabs((int64_t)end.x - start.x) >= llabs((int64_t)end.y - start.y);
    if (trim > count / 4) trim = count / 4;
    for (size_t i = trim; i < count - trim; i++) add_crest(magnitude, pixel[i], flat, sum);
    double slope, offset;
    if (!line_through(sum, flat, &slope, &offset)) return (Line){start.x, start.y, end.x, end.y};
    if (flat) return (Line){start.x, offset + slope * start.x, end.x, offset + slope * end.x};
    return (Line){offset + slope * start.y, start.y, offset + slope * end.y, end.y};
}

static int fit_pieces(const Magnitude *magnitude, const Pixel *pixels, const Piece *pieces, size_t count, size_t trim,
               List *lines, List *moments) {
    if (!reserve(lines, count) || !reserve(moments, count)) return 0;
    Line *line = lines->data;
    Moments *sum = moments->data;
    for (size_t i = 0; i < count; i++) {
        size_t first = (size_t)pieces[i].first, last = (size_t)pieces[i].last;
        sum[i] = (Moments){0, 0, 0, 0, 0, 0};
        line[i] = fitted(magnitude, pixels + first, last - first + 1, trim, sum + i);
    }
    lines->used = moments->used = count;
    return 1;
}

typedef struct {
    double x, y;
} Point;

/* A line that grows at its tip. */
typedef struct {
    Point tail, tip;
    Moments sum;
} Growing;

typedef struct {
    Point at;
    int32_t end; /* 2 * line, or 2 * line + 1 */
} Item;

typedef struct {
    const Point *ends; /* two a line */
    const Moments *moments;
    size_t count;
    JoinParams params;
    double half, cells_per_px; /* of the square that a tip can reach; cells are half as wide as it */
    uint32_t columns, rows;
    uint32_t *first; /* item of each cell, row by row; one entry more */
    Item *items;     /* sorted by cell */
    uint8_t *taken;
} Board;

enum { MAX_CELLS = 1024 }; /* in a row or column; what lies beyond is in the last one */

/* Column or row of cells, of `count`. */
static uint32_t cell_at(const Board *board, double value, uint32_t count) {
    double cell = value * board->cells_per_px;
    return cell >= count ? count - 1 : cell >= 0 ? (uint32_t)cell : 0;
}

static uint32_t cell_of(const Board *board, Point point) {
    return cell_at(board, point.y, board->rows) * board->columns + cell_at(board, point.x, board->columns);
}

/* Cells over all ends. */
static void size_board(Board *board) {
    /* A tip reaches from 2 `max_offset` behind it to `max_gap` ahead, and 2 `max_offset` to both sides. */
    const double along = board->params.max_gap / 2 + board->params.max_offset, beside = 2 * board->params.max_offset;
    board->half = 1.01 * sqrt(along * along + beside * beside);
    board->cells_per_px = 1 / board->half;
    board->columns = board->rows = MAX_CELLS;
    double right = 0, bottom = 0;
    for (size_t i = 0; i < 2 * board->count; i++) {
        right = board->ends[i].x > right ? board->ends[i].x : right;
        bottom = board->ends[i].y > bottom ? board->ends[i].y : bottom;
    }
    board->columns = cell_at(board, right, MAX_CELLS) + 1;
    board->rows = cell_at(board, bottom, MAX_CELLS) + 1;
}

/* Sorts the ends into their cells. */
static int fill_board(Board *board) {
    const size_t ends = 2 * board->count, cells = (size_t)board->columns * board->rows;
    board->first = calloc(cells + 2, sizeof *board->first);
    board->items = malloc((ends + 1) * sizeof *board->items);
    board->taken = calloc(board->count + 1, 1);
    if (board->first == NULL || board->items == NULL || board->taken == NULL) return 0;
    uint32_t *next = board->first + 1;
    for (size_t i = 0; i < ends; i++) next[cell_of(board, board->ends[i]) + 1]++;
    for (size_t i = 1; i <= cells; i++) next[i] += next[i - 1];
    for (size_t i = 0; i < ends; i++)
        board->items[next[cell_of(board, board->ends[i])]++] = (Item){board->ends[i], (int32_t)i};
    return 1;
}

static Moments sum_of(const Moments *a, const Moments *b) {
    return (Moments){a->count + b->count, a->x + b->x,   a->y + b->y,
                     a->xx + b->xx,       a->xy + b->xy, a->yy + b->yy};
}

/* Joins both into one line, if all their ends lie near it. */
static int joined_line(const Board *board, const Growing *line, int32_t near, Growing *joined) {
    const Point far = board->ends[near ^ 1];
    const Point ends[4] = {line->tail, line->tip, board->ends[near], far};
    const int flat = fabs(far.x - line->tail.x) >= fabs(far.y - line->tail.y);
    double slope, offset, tip = flat ? line->tip.x : line->tip.y;
    const double tail = flat ? line->tail.x : line->tail.y, end = flat ? far.x : far.y;
    joined->sum = sum_of(&line->sum, board->moments + near / 2);
    if (!line_through(&joined->sum, flat, &slope, &offset)) return 0;
    for (int i = 0; i < 4; i++) {
        double u = flat ? ends[i].x : ends[i].y, v = flat ? ends[i].y : ends[i].x;
        if (!(fabs(v - (offset + slope * u)) <= board->params.max_offset)) return 0;
    }
    if (!(fabs(tip - tail) > fabs(end - tail))) tip = end;
    joined->tail = flat ? (Point){tail, offset + slope * tail} : (Point){offset + slope * tail, tail};
    joined->tip = flat ? (Point){tip, offset + slope * tip} : (Point){offset + slope * tip, tip};
    return 1;
}

/* The nearest free end from one item to another that continues the line in the direction; makes it the best one. */
static int32_t nearest_end(const Board *board, const uint32_t items[2], const Growing *line, Point way, int32_t found,
                           double *nearest, Growing *best) {
    const double max_gap = board->params.max_gap, beside = 2 * board->params.max_offset;
    for (uint32_t i = items[0]; i < items[1]; i++) {
        const Point near = board->items[i].at;
        const double x = near.x - line->tip.x, y = near.y - line->tip.y, along = x * way.x + y * way.y;
        if ((along < -beside) | (along > max_gap) | (fabs(x * way.y - y * way.x) > beside)) continue;
        const int32_t end = board->items[i].end;
        const Point far = board->ends[end ^ 1];
        const double distance = x * x + y * y;
        if (board->taken[end / 2] || (far.x - near.x) * way.x + (far.y - near.y) * way.y <= 0) continue;
        if (distance > *nearest || (distance == *nearest && end >= found)) continue;
        Growing joined;
        if (!joined_line(board, line, end, &joined)) continue;
        *nearest = distance;
        found = end;
        *best = joined;
    }
    return found;
}

/* The nearest free end that continues the line; -1 if there is none. */
static int32_t next_end(const Board *board, const Growing *line, Growing *best) {
    const double middle = board->params.max_gap / 2 - board->params.max_offset;
    const double dx = line->tip.x - line->tail.x, dy = line->tip.y - line->tail.y, length = sqrt(dx * dx + dy * dy);
    double nearest = INFINITY;
    int32_t found = -1;
    if (!(length > 0)) return found;
    const Point way = {dx / length, dy / length};
    const double x = line->tip.x + way.x * middle, y = line->tip.y + way.y * middle;
    const uint32_t left = cell_at(board, x - board->half, board->columns);
    const uint32_t right = cell_at(board, x + board->half, board->columns);
    const uint32_t bottom = cell_at(board, y + board->half, board->rows);
    for (uint32_t row = cell_at(board, y - board->half, board->rows); row <= bottom; row++) {
        const uint32_t *first = board->first + (size_t)row * board->columns;
        const uint32_t items[2] = {first[left], first[right + 1]};
        found = nearest_end(board, items, line, way, found, &nearest, best);
    }
    return found;
}

/* Extends the line at its tip as far as possible; returns the number of pixels of the lines joined to it. */
static int64_t grow(const Board *board, const Piece *pieces, Growing *line) {
    int64_t support = 0;
    Growing longer;
    for (int32_t end; (end = next_end(board, line, &longer)) >= 0; *line = longer) {
        board->taken[end / 2] = 1;
        support += (int64_t)pieces[end / 2].last - pieces[end / 2].first + 1;
    }
    return support;
}

static Growing turned(Growing line) { return (Growing){line.tip, line.tail, line.sum}; }

static void join_all(const Board *board, const Piece *pieces, List *joined, List *support) {
    for (size_t i = 0; i < board->count; i++) {
        int64_t pixels = (int64_t)pieces[i].last - pieces[i].first + 1;
        if (board->taken[i] || pixels < board->params.min_pixels) continue;
        board->taken[i] = 1;
        Growing line = {board->ends[2 * i], board->ends[2 * i + 1], board->moments[i]};
        pixels += grow(board, pieces, &line);
        line = turned(line);
        pixels += grow(board, pieces, &line);
        ((Line *)joined->data)[joined->used++] = (Line){line.tip.x, line.tip.y, line.tail.x, line.tail.y};
        ((int64_t *)support->data)[support->used++] = pixels;
    }
}

static int join_lines(const double *ends, const Moments *moments, const Piece *pieces, size_t count, JoinParams params,
               List *joined, List *support) {
    Board board = {(const Point *)ends, moments, count, params, 0, 0, 0, 0, NULL, NULL, NULL};
    if (count > INT32_MAX / 2 || !reserve(joined, count) || !reserve(support, count)) return 0;
    size_board(&board);
    int done = fill_board(&board);
    if (done) join_all(&board, pieces, joined, support);
    free(board.first);
    free(board.items);
    free(board.taken);
    return done;
}

static int pieces_inside(const Py_buffer *pieces, Py_ssize_t pixels) {
    const Piece *piece = pieces->buf;
    for (Py_ssize_t i = 0; i < pieces->shape[0]; i++) {
        if (piece[i].first >= 0 && piece[i].first <= piece[i].last && piece[i].last < pixels) continue;
        PyErr_Format(PyExc_ValueError, "pieces: number %zd is not within the pixels", i);
        return 0;
    }
    return 1;
}

PyObject *call_fits(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"magnitude", INT16, {ANY, ANY}},
                                          {"pixels", INT32, {ANY, 2}},
                                          {"pieces", INT32, {ANY, 2}},
                                          {"trim", WHOLE, {0, INT32_MAX}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    if (!pieces_inside(&a.view[2], a.view[1].shape[0])) return close_arguments(&a, NULL);
    const Magnitude area = {a.view[0].buf, (size_t)a.view[0].shape[0], (size_t)a.view[0].shape[1]};
    const size_t count = (size_t)a.view[2].shape[0], trim = (size_t)a.number[3][0].whole;
    List lines = {NULL, 0, 0, sizeof(Line)}, moments = {NULL, 0, 0, sizeof(Moments)};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = fit_pieces(&area, a.view[1].buf, a.view[2].buf, count, trim, &lines, &moments);
    Py_END_ALLOW_THREADS
    return close_arguments(&a, Py_BuildValue("(NN)", list_bytes(done, &lines), list_bytes(done, &moments)));
}

PyObject *call_joins(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"lines", FLOAT64, {N, 4}}, {"moments", FLOAT64, {N, 6}},
                                          {"pieces", INT32, {N, 2}}, {"gap", REAL, {0}},
                                          {"aside", REAL, {0}},    {"shortest", WHOLE, {0, INT32_MAX}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const JoinParams params = {a.number[3][0].real, a.number[4][0].real, a.number[5][0].whole};
    if (!require(params.max_gap >= 0 && params.max_gap < 1e6 && params.max_offset > 0 && params.max_offset < 1e6,
                 "gap, aside: must be 0 to 1e6, and aside more than 0"))
        return close_arguments(&a, NULL);
    List joined = {NULL, 0, 0, sizeof(Line)}, support = {NULL, 0, 0, sizeof(int64_t)};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = join_lines(a.view[0].buf, a.view[1].buf, a.view[2].buf, (size_t)a.view[0].shape[0], params, &joined,
                      &support);
    Py_END_ALLOW_THREADS
    return close_arguments(&a, Py_BuildValue("(NN)", list_bytes(done, &joined), list_bytes(done, &support)));
}
