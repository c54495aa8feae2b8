/* Cuts chains into straight pieces: the length condition and the direction shares; twin: reference.cuts. */
#include "kernels.h"

#include <math.h>
#include <stdlib.h>

enum { HORIZONTAL, VERTICAL, OBLIQUE, KINDS };

static int kind_of_step(Pixel from, Pixel to) {
    return from.y == to.y ? HORIZONTAL : from.x == to.x ? VERTICAL : OBLIQUE;
}

/* Estimated length minus chord. */
static double excess(const double steps[KINDS], Pixel from, Pixel to) {
    double wide = steps[HORIZONTAL] + steps[OBLIQUE], high = steps[VERTICAL] + steps[OBLIQUE];
    double dx = (double)to.x - from.x, dy = (double)to.y - from.y;
    return sqrt(wide * wide + high * high) - sqrt(dx * dx + dy * dy);
}

/* The pixel that lies farthest from the chord, the first such; at least one step on, so that cutting ends. */
static size_t farthest(const Pixel *pixel, size_t first, size_t last) {
    double dx = (double)pixel[last].x - pixel[first].x, dy = (double)pixel[last].y - pixel[first].y, most = 0;
    size_t at = first + 1;
    for (size_t k = first + 1; k < last; k++) {
        double x = (double)pixel[k].x - pixel[first].x, y = (double)pixel[k].y - pixel[first].y;
        double off = fabs(dx * y - dy * x);
        if (off > most) {
            most = off;
            at = k;
        }
    }
    return at;
}

/* Last pixel of the straight piece that begins at `first`; `end` is one past the chain. */
static size_t piece_end(const Pixel *pixel, size_t first, size_t end, CutRules rules) {
    double steps[KINDS] = {0, 0, 0};
    ptrdiff_t head[KINDS] = {0, 0, 0}, window[KINDS] = {0, 0, 0};
    for (size_t k = first + 1; k < end; k++) {
        int kind = kind_of_step(pixel[k - 1], pixel[k]);
        steps[kind] += 1;
        if (excess(steps, pixel[first], pixel[k]) > rules.deviation) return farthest(pixel, first, k);
        window[kind]++;
        if (k - first <= rules.window) {
            head[kind]++;
            continue;
        }
        size_t old = k - rules.window;
        window[kind_of_step(pixel[old - 1], pixel[old])]--;
        ptrdiff_t change = 0;
        for (int i = 0; i < KINDS; i++) change += window[i] > head[i] ? window[i] - head[i] : head[i] - window[i];
        if ((double)change > rules.share_change * (double)rules.window) return k - rules.window / 2;
    }
    return end - 1;
}

int cut_chains(const Pixel *pixels, const int32_t *starts, size_t chains, CutRules rules, List *pieces) {
    for (size_t i = 0; i < chains; i++) {
        size_t first = (size_t)starts[i], end = (size_t)starts[i + 1];
        while (end - first >= rules.shortest) {
            size_t last = piece_end(pixels, first, end, rules);
            if (last - first + 1 >= rules.shortest) {
                if (!reserve(pieces, 1)) return 0;
                ((Piece *)pieces->data)[pieces->used++] = (Piece){(int32_t)first, (int32_t)last};
            }
            first = last;
            if (last + 1 == end) break;
        }
    }
    return 1;
}
