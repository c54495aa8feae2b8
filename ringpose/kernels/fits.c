/* One least-squares line for each straight piece, through sub-pixel positions of its edge; twin: reference.fits. */
#include "kernels.h"

#include <stdlib.h>

typedef struct {
    double count, u, uu, v, uv;
} Sums;

/* Adds the crest of the magnitude across the piece; a pixel that is no maximum there says nothing of the line. */
static void add_crest(const Magnitude *magnitude, Pixel at, int flat, int64_t u, int64_t v, Sums *sums) {
    if (at.x < 1 || at.y < 1 || at.x >= (int32_t)magnitude->width - 1 || at.y >= (int32_t)magnitude->height - 1) return;
    ptrdiff_t width = (ptrdiff_t)magnitude->width, step = flat ? width : 1;
    const int16_t *value = magnitude->data + at.y * width + at.x;
    int before = *(value - step), here = *value, after = value[step];
    int curvature = before - 2 * here + after;
    if (before > here || after > here || curvature == 0) return;
    double crest = (double)v + (before - after) / (2.0 * curvature);
    sums->count += 1;
    sums->u += (double)u;
    sums->uu += (double)u * (double)u;
    sums->v += crest;
    sums->uv += (double)u * crest;
}

static Line fitted(const Magnitude *magnitude, const Pixel *pixel, size_t count, size_t trim) {
    Pixel start = pixel[0], end = pixel[count - 1];
    int64_t wide = (int64_t)end.x - start.x, high = (int64_t)end.y - start.y;
    int flat = llabs(wide) >= llabs(high);
    if (trim > count / 4) trim = count / 4;
    Sums sums = {0, 0, 0, 0, 0};
    for (size_t i = trim; i < count - trim; i++) {
        int64_t x = (int64_t)pixel[i].x - start.x, y = (int64_t)pixel[i].y - start.y;
        add_crest(magnitude, pixel[i], flat, flat ? x : y, flat ? y : x, &sums);
    }
    double spread = sums.count * sums.uu - sums.u * sums.u;
    if (spread <= 0) return (Line){start.x, start.y, end.x, end.y};
    double slope = (sums.count * sums.uv - sums.u * sums.v) / spread;
    double offset = (sums.v - slope * sums.u) / sums.count;
    if (flat) return (Line){start.x, start.y + offset, end.x, start.y + (offset + slope * (double)wide)};
    return (Line){start.x + offset, start.y, start.x + (offset + slope * (double)high), end.y};
}

int fit_pieces(const Magnitude *magnitude, const Pixel *pixels, const Piece *pieces, size_t count, size_t trim,
               List *lines) {
    if (!reserve(lines, count)) return 0;
    Line *line = lines->data;
    for (size_t i = 0; i < count; i++) {
        size_t first = (size_t)pieces[i].first, last = (size_t)pieces[i].last;
        line[i] = fitted(magnitude, pixels + first, last - first + 1, trim);
    }
    lines->used = count;
    return 1;
}
