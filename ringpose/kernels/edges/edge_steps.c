/* Where, near predicted places of an edge, brightness steps, to a fraction of a pixel. */
#include "edges.h"
#include "kernels.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* What is known of all samples of a profile; the compiler makes loops of their own for them. */
typedef struct {
    int wide;  /* elements of 16 bits */
    int inner; /* none lies at the image's border or beyond */
} Kind;

/* What is no number becomes 0. */
static double clamped(double value, double most) { return !(value > 0) ? 0 : value > most ? most : value; }

/* Grey value between the pixels; those of the border go on beyond it. */
static inline double between(const EdgePicture *picture, const Kind kind, double x, double y) {
    const size_t width = picture->width;
    if (!kind.inner) {
        x = clamped(x, picture->right);
        y = clamped(y, picture->bottom);
    }
    const int32_t column = (int32_t)x, row = (int32_t)y;
    const size_t at = (size_t)row * width + (size_t)column, right = kind.inner || column < picture->right;
    const size_t below = kind.inner || row < picture->bottom ? width : 0;
    const double u = x - column, v = y - row;
    int here, beside, under, across;
    if (kind.wide) {
        const uint16_t *pixel = (const uint16_t *)picture->data + at;
        here = pixel[0], beside = pixel[right], under = pixel[below], across = pixel[below + right];
    } else {
        const uint8_t *pixel = (const uint8_t *)picture->data + at;
        here = pixel[0], beside = pixel[right], under = pixel[below], across = pixel[below + right];
    }
    const double upper = here + u * (beside - here), lower = under + u * (across - under);
    return upper + v * (lower - upper);
}

/* Running mean over neighbours, fewer at the ends. */
static int pool(double *values, size_t count, size_t window) {
    double *sum = malloc((count + 1) * sizeof *sum);
    if (sum == NULL) return 0;
    sum[0] = 0;
    for (size_t i = 0; i < count; i++) sum[i + 1] = sum[i] + values[i];
    const size_t half = window / 2;
    for (size_t i = 0; i < count; i++) {
        const size_t first = i > half ? i - half : 0, end = i + half + 1 < count ? i + half + 1 : count;
        values[i] = (sum[end] - sum[first]) / (double)(end - first);
    }
    free(sum);
    return 1;
}

/* One profile's mean values, and which samples hide their brightness. */
static inline void take_samples(const EdgePicture *picture, const Kind kind, const double place[2],
                                const double normal[2], const ProfileRules *rules, double *value, uint8_t *saturated,
                                size_t samples) {
    const int along = (int)rules->along;
    const double hiding = rules->saturation - 0.5;
    for (size_t s = 0; s < samples; s++) {
        const double across = (double)s - rules->reach - rules->inside;
        const double x = place[0] + across * normal[0], y = place[1] + across * normal[1];
        double sum = 0;
        int hidden = 0;
        for (int k = 0; k < along; k++) {
            const double beside = k - (along - 1) / 2.0;
            const double grey = between(picture, kind, x - beside * normal[1], y + beside * normal[0]);
            sum += grey;
            hidden |= grey >= hiding;
        }
        value[s] = sum / along;
        saturated[s] = (uint8_t)hidden;
    }
}

VECTOR_LOOP
static void take_profile(const EdgePicture *picture, const double place[2], const double normal[2],
                         const ProfileRules *rules, double *value, uint8_t *saturated, size_t samples) {
    const double reach = rules->reach + rules->inside + rules->outside + rules->along;
    const int inner = place[0] > reach && place[0] < picture->right - reach && place[1] > reach &&
                      place[1] < picture->bottom - reach && fabs(normal[0]) < 1.01 && fabs(normal[1]) < 1.01;
    if (picture->wide)
        take_samples(picture, (Kind){1, 0}, place, normal, rules, value, saturated, samples);
    else if (inner)
        take_samples(picture, (Kind){0, 1}, place, normal, rules, value, saturated, samples);
    else
        take_samples(picture, (Kind){0, 0}, place, normal, rules, value, saturated, samples);
}

/* Subtracts the mean of the first values from all; returns the variance of the first ones. */
static double level(double *value, size_t samples, size_t surface) {
    double mean = 0, square = 0;
    for (size_t s = 0; s < surface; s++) mean += value[s];
    mean /= (double)surface;
    for (size_t s = 0; s < samples; s++) value[s] -= mean;
    for (size_t s = 0; s < surface; s++) square += value[s] * value[s];
    return square / (double)(surface - 1);
}

int edge_profiles(const EdgePicture *picture, const double *place, const double *normal, const ProfileRules *rules,
                  Profiles *profiles) {
    const size_t samples = profiles->samples;
    for (size_t i = 0; i < profiles->count; i++) {
        double *value = profiles->value + i * samples;
        take_profile(picture, place + 2 * i, normal + 2 * i, rules, value, profiles->saturated + i * samples, samples);
        profiles->noise[i] = level(value, samples, (size_t)rules->inside);
    }
    if (!pool(profiles->noise, profiles->count, (size_t)rules->pooled)) return 0;
    for (size_t i = 0; i < profiles->count; i++) {
        profiles->noise[i] = sqrt(profiles->noise[i] + rules->noise * rules->noise / rules->along);
        for (size_t s = 0; s < samples; s++) profiles->value[i * samples + s] /= profiles->noise[i];
    }
    return 1;
}

/* GNU C's vectors: places of the edge that are summed for together, in registers. */
enum { BLOCK = 4 };
typedef double Doubles __attribute__((vector_size(8 * BLOCK), aligned(8), may_alias));
#define DOUBLES(address) (*(Doubles *)(address))

/* Sums over the samples of a profile for every place of the edge: what remains unexplained, and the step's height. */
VECTOR_LOOP
static void project(const double *value, size_t samples, const Templates *templates, double *cost, double *height) {
    const size_t places = templates->places;
    const double *weight = templates->weight, *level = templates->level, *step = templates->step;
    size_t p = 0;
    for (; p + BLOCK <= places; p += BLOCK) {
        Doubles square = {0}, base = {0}, high = {0};
        for (size_t s = 0, at = p; s < samples; s++, at += places) {
            const double v = value[s];
            square += v * v * DOUBLES(weight + at);
            base += v * DOUBLES(level + at);
            high += v * DOUBLES(step + at);
        }
        DOUBLES(cost + p) = square - (base * base + high * high);
        DOUBLES(height + p) = high;
    }
    for (; p < places; p++) {
        double square = 0, base = 0, high = 0;
        for (size_t s = 0, at = p; s < samples; s++, at += places) {
            square += value[s] * value[s] * weight[at];
            base += value[s] * level[at];
            high += value[s] * step[at];
        }
        cost[p] = square - (base * base + high * high);
        height[p] = high;
    }
}

static int is_touched(const Profiles *profiles, size_t i, const Templates *templates, double offset, double touched) {
    for (size_t s = 0; s < profiles->samples; s++)
        if (profiles->saturated[i * profiles->samples + s] && fabs(templates->across[s] - offset) < touched) return 1;
    return 0;
}

/* The likeliest place; its sigma is still the square root of the curvature, its cost that of a profile. */
static EdgeStep likeliest(const Profiles *profiles, size_t i, const Templates *templates, const StepRules *rules,
                          double *scratch) {
    const size_t places = templates->places;
    double *cost = scratch, *height = scratch + places;
    project(profiles->value + i * profiles->samples, profiles->samples, templates, cost, height);
    size_t best = 0;
    for (size_t p = 1; p < places; p++)
        if (cost[p] < cost[best]) best = p;
    best = best < 1 ? 1 : best > places - 2 ? places - 2 : best;
    const double left = cost[best - 1], least = cost[best], right = cost[best + 1], bend = left - 2 * least + right;
    const int found = bend > rules->flat && least <= left && least <= right;
    const double shift = found ? (left - right) / (2 * bend) * rules->spacing : 0;
    const double offset = templates->place[best] + shift, size = fabs(height[best]);
    const int hidden = !found || is_touched(profiles, i, templates, offset, rules->touched);
    return (EdgeStep){hidden ? NAN : offset, rules->spacing * sqrt(2 / (found ? bend : 1)), size,
                      size * profiles->noise[i] / templates->unit[best], least};
}

int edge_steps(const Profiles *profiles, const Templates *templates, const StepRules *rules, EdgeStep *steps) {
    const size_t count = profiles->count;
    double *scratch = malloc((2 * templates->places + count + 1) * sizeof *scratch);
    if (scratch == NULL) return 0;
    double *misfit = scratch + 2 * templates->places;
    for (size_t i = 0; i < count; i++) {
        steps[i] = likeliest(profiles, i, templates, rules, scratch);
        misfit[i] = steps[i].cost / (double)(profiles->samples - 3);
    }
    const int done = pool(misfit, count, (size_t)rules->pooled);
    for (size_t i = 0; done && i < count; i++) {
        const double excess = sqrt(fmax(misfit[i], 1));
        steps[i].sigma *= excess;
        steps[i].height /= excess;
    }
    free(scratch);
    return done;
}
