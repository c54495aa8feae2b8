/* One least-squares line for each straight piece, through sub-pixel positions of its edge. */
#include "segments.h"

#include <stdlib.h>

/* Adds the crest of the magnitude across the piece; a pixel that is no maximum there says nothing of the line. */
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

int line_through(const Moments *sum, int flat, double *slope, double *offset) {
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

int fit_pieces(const Magnitude *magnitude, const Pixel *pixels, const Piece *pieces, size_t count, size_t trim,
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
