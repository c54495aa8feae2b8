/* Cuts chains into straight pieces: the length condition and the direction shares. */
#include "segments.h"

#include <math.h>
#include <stdlib.h>

/* Counts of steps; all others are oblique. */
typedef struct {
    int64_t horizontal, vertical;
} Steps;

static Steps step_between(Pixel from, Pixel to) {
    const int horizontal = from.y == to.y;
    return (Steps){horizontal, !horizontal & (from.x == to.x)};
}

/* Whether the estimated length exceeds the chord by more than the deviation. Their difference is that of the squares
   by their sum, and the sum is at least that of the longer sides: mostly this spares the roots. */
static int exceeds(Steps steps, int64_t all, Pixel from, Pixel to, double deviation) {
    const double wide = (double)(all - steps.vertical), high = (double)(all - steps.horizontal);
    const double dx = fabs((double)to.x - from.x), dy = fabs((double)to.y - from.y);
    const double length = wide * wide + high * high, chord = dx * dx + dy * dy;
    const double sides = (wide > high ? wide : high) + (dx > dy ? dx : dy);
    if (length - chord <= deviation * sides && deviation >= 0) return 0;
    return sqrt(length) - sqrt(chord) > deviation;
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
    Steps steps = {0, 0}, head = {0, 0}, window = {0, 0};
    const double most = rules.share_change * (double)rules.window;
    for (size_t k = first + 1; k < end; k++) {
        const Steps now = step_between(pixel[k - 1], pixel[k]);
        steps.horizontal += now.horizontal;
        steps.vertical += now.vertical;
        if (exceeds(steps, (int64_t)(k - first), pixel[first], pixel[k], rules.deviation))
            return farthest(pixel, first, k);
        if (k - first <= rules.window) {
            head = window = steps;
            continue;
        }
        const Steps old = step_between(pixel[k - rules.window - 1], pixel[k - rules.window]);
        window.horizontal += now.horizontal - old.horizontal;
        window.vertical += now.vertical - old.vertical;
        const int64_t horizontal = window.horizontal - head.horizontal, vertical = window.vertical - head.vertical;
        const int64_t change = llabs(horizontal) + llabs(vertical) + llabs(horizontal + vertical);
        if ((double)change > most) return k - rules.window / 2;
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
