/* Ridges of the smoothed image, column by column. */
#include "stripes.h"

#include <stdlib.h>
#include <string.h>

/* 1 where the response is at least so strong and strongest in its column. */
static void mark_ridges(const float *restrict response, float least, size_t count, uint8_t *restrict ridge) {
    const float *restrict above = response - BLOCK, *restrict below = response + BLOCK;
    for (size_t i = 0; i < count; i++)
        ridge[i] = (response[i] < above[i]) & (response[i] <= below[i]) & (response[i] <= -least);
}

static Ridge ridge_at(const float *here, int32_t column, int32_t row, float noise) {
    float before = *(here - BLOCK), after = here[BLOCK], bend = (before + after) - 2 * here[0];
    float shift = 0.5f * (before - after) / bend;
    return (Ridge){column, row, (float)row + shift, -here[0], bend, noise, -1};
}

/* Which of eight pixels are ridges, of those in so many columns; branches would be guessed wrongly. */
static size_t places(const uint8_t *ridge, size_t columns, uint8_t place[8]) {
    size_t count = 0;
    for (uint8_t i = 0; i < 8; i++) {
        place[count] = i;
        count += ridge[i] & (i < columns);
    }
    return count;
}

/* Ridges in rows of one area of noise. */
static int smooth_rows(const Noise *noise, const StripeRules *rules, size_t block, size_t first, size_t rows,
                       Patch *patch, List *found) {
    uint8_t ridge[CHUNK * BLOCK], place[8];
    size_t reach = noise->filter->reach, columns = noise->image->width - block * BLOCK, pairs = (rows + 3) / 2;
    float figure = noise_at(noise, first, block);
    const float *response = patch->bend + BLOCK;
    load_pixels(noise->image, (ptrdiff_t)first - 1 - (ptrdiff_t)reach, block * BLOCK, 2 * (pairs + reach), patch);
    bend_pixels(noise->filter, 2 * pairs * BLOCK, patch);
    mark_ridges(response, least_response(rules, figure), rows * BLOCK, ridge);
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
static int smooth_run(const Noise *noise, const StripeRules *rules, const Run *run, Patch *patch, List *found) {
    size_t last = noise->image->height - 1, first = (size_t)run->first * CELL, end = (size_t)(run->last + 1) * CELL;
    if (first == 0) first = 1;
    if (end > last) end = last;
    while (first < end) {
        size_t rows = NOISE_ROWS - first % NOISE_ROWS;
        if (rows > CHUNK) rows = CHUNK;
        if (rows > end - first) rows = end - first;
        if (!smooth_rows(noise, rules, (size_t)run->block, first, rows, patch, found)) return 0;
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

int find_ridges(const Noise *noise, const StripeRules *rules, const List *runs, List *found, List *ridges) {
    size_t *end = malloc((noise->blocks + 1) * sizeof *end);
    Run *sorted = end ? sorted_runs(runs, noise->blocks, end) : NULL;
    Patch patch;
    int done = sorted != NULL && reserve(ridges, runs->used * BLOCK / 2);
    for (size_t i = 0, block = 0; done && block < noise->blocks; block++) {
        found->used = 0;
        for (; done && i < end[block]; i++) done = smooth_run(noise, rules, sorted + i, &patch, found);
        if (done && found->used) done = append_sorted(block, found, ridges);
    }
    free(end);
    free(sorted);
    return done;
}
