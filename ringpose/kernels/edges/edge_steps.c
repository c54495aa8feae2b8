/* Sub-pixel position of the intensity step near predicted places of an edge: profiles across the edge, and the template
   of a blurred step fitted at every offset. */
#include "arguments.h"

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "kernels.h"

typedef struct {
    const void *data;
    size_t height, width;
    double right, bottom; /* column and row of the last pixel */
    int wide;             /* uint16_t instead of uint8_t */
} EdgePicture;

#define PROFILE_PARAMS(REAL, COUNT)                                                                                 \
    COUNT(reach_px, 0, INT32_MAX)                                                                                   \
    COUNT(inside_px, 2, INT32_MAX)                                                                                  \
    COUNT(outside_px, 0, INT32_MAX)                                                                                 \
    COUNT(along_px, 1, INT32_MAX)                                                                                   \
    REAL(noise_dn, NOT_NEGATIVE)                                                                                    \
    COUNT(pooled, 1, INT32_MAX)                                                                                     \
    COUNT(saturation_dn, 1, UINT16_MAX)
RECORD_STRUCT(ProfileParams, PROFILE_PARAMS);
RECORD(ProfileParams, PROFILE_PARAMS);

typedef struct {
    double *value, *noise;
    uint8_t *saturated;
    size_t count, samples;
} Profiles;

/* Independent of the image: rows of samples, columns of step positions. */
typedef struct {
    const double *across, *place, *unit, *weight, *level, *step;
    size_t places;
} Templates;

#define STEP_PARAMS(REAL, COUNT)                                                                                    \
    REAL(flat, NOT_NEGATIVE)                                                                                        \
    REAL(touched_px, NOT_NEGATIVE)                                                                                  \
    REAL(spacing_px, POSITIVE)                                                                                      \
    COUNT(pooled, 1, INT32_MAX)
RECORD_STRUCT(StepParams, STEP_PARAMS);
RECORD(StepParams, STEP_PARAMS);

#define EDGE_STEP_COLUMNS(COLUMN, COLUMNS_OF)                                                                       \
    COLUMN(offset_px) COLUMN(sigma_px) COLUMN(height) COLUMN(height_dn) COLUMN(cost)
ROW_STRUCT(EdgeStep, EDGE_STEP_COLUMNS);
TABLE(EdgeStep, EDGE_STEP_COLUMNS);

/* Properties of all samples of a profile; the compiler specialises the loops for them. */
typedef struct {
    int wide;  /* elements of 16 bits */
    int inner; /* none lies at the image's border or beyond */
} SampleKind;

/* NaN becomes 0. */
static double clamped(double value, double maximum) { return !(value > 0) ? 0 : value > maximum ? maximum : value; }

/* Bilinear interpolation; the border is replicated. */
static inline double between(const EdgePicture *picture, const SampleKind kind, double x, double y) {
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

/* Mean values of one profile, and which samples are saturated. */
static inline void take_samples(const EdgePicture *picture, const SampleKind kind, const double place[2],
                                const double normal[2], const ProfileParams *params, double *value, uint8_t *saturated,
                                size_t samples) {
    const int along = (int)params->along_px;
    const double hiding = params->saturation_dn - 0.5;
    for (size_t s = 0; s < samples; s++) {
        const double across = (double)s - params->reach_px - params->inside_px;
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
                         const ProfileParams *params, double *value, uint8_t *saturated, size_t samples) {
    const double reach = params->reach_px + params->inside_px + params->outside_px + params->along_px;
    const int inner = place[0] > reach && place[0] < picture->right - reach && place[1] > reach &&
                      place[1] < picture->bottom - reach && fabs(normal[0]) < 1.01 && fabs(normal[1]) < 1.01;
    if (picture->wide)
        take_samples(picture, (SampleKind){1, 0}, place, normal, params, value, saturated, samples);
    else if (inner)
        take_samples(picture, (SampleKind){0, 1}, place, normal, params, value, saturated, samples);
    else
        take_samples(picture, (SampleKind){0, 0}, place, normal, params, value, saturated, samples);
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

/* Mean intensity across each place, less that of the surface, in units of its noise. 0 if there is no memory. */
static int edge_profiles(const EdgePicture *picture, const double *place, const double *normal,
                         const ProfileParams *params,
                  Profiles *profiles) {
    const size_t samples = profiles->samples;
    for (size_t i = 0; i < profiles->count; i++) {
        double *value = profiles->value + i * samples;
        take_profile(picture, place + 2 * i, normal + 2 * i, params, value, profiles->saturated + i * samples, samples);
        profiles->noise[i] = level(value, samples, (size_t)params->inside_px);
    }
    if (!pool(profiles->noise, profiles->count, (size_t)params->pooled)) return 0;
    for (size_t i = 0; i < profiles->count; i++) {
        profiles->noise[i] = sqrt(profiles->noise[i] + params->noise_dn * params->noise_dn / params->along_px);
        for (size_t s = 0; s < samples; s++) profiles->value[i * samples + s] /= profiles->noise[i];
    }
    return 1;
}

/* GNU C vectors: step positions whose sums are accumulated together, in registers. */
enum { BLOCK = 4 };
typedef double Doubles __attribute__((vector_size(8 * BLOCK), aligned(8), may_alias));
#define DOUBLES(address) (*(Doubles *)(address))

/* Weighted least squares for every step position: residual sum of squares, and height of the step. */
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

/* Step of lowest cost with parabolic interpolation; sigma from the curvature of the cost, not yet scaled by the
   residual variance. */
static EdgeStep most_likely_step(const Profiles *profiles, size_t i, const Templates *templates,
                                 const StepParams *params, double *scratch) {
    const size_t places = templates->places;
    double *cost = scratch, *height = scratch + places;
    project(profiles->value + i * profiles->samples, profiles->samples, templates, cost, height);
    size_t best = 0;
    for (size_t p = 1; p < places; p++)
        if (cost[p] < cost[best]) best = p;
    best = best < 1 ? 1 : best > places - 2 ? places - 2 : best;
    const double left = cost[best - 1], minimum = cost[best], right = cost[best + 1];
    const double curvature = left - 2 * minimum + right;
    const int found = curvature > params->flat && minimum <= left && minimum <= right;
    const double shift = found ? (left - right) / (2 * curvature) * params->spacing_px : 0;
    const double offset = templates->place[best] + shift, size = fabs(height[best]);
    const int hidden = !found || is_touched(profiles, i, templates, offset, params->touched_px);
    return (EdgeStep){hidden ? NAN : offset, params->spacing_px * sqrt(2 / (found ? curvature : 1)), size,
                      size * profiles->noise[i] / templates->unit[best], minimum};
}

static int edge_steps(const Profiles *profiles, const Templates *templates, const StepParams *params, EdgeStep *steps) {
    const size_t count = profiles->count;
    double *scratch = malloc((2 * templates->places + count + 1) * sizeof *scratch);
    if (scratch == NULL) return 0;
    double *excess_cost = scratch + 2 * templates->places;
    for (size_t i = 0; i < count; i++) {
        steps[i] = most_likely_step(profiles, i, templates, params, scratch);
        excess_cost[i] = steps[i].cost / (double)(profiles->samples - 3);
    }
    const int done = pool(excess_cost, count, (size_t)params->pooled);
    for (size_t i = 0; done && i < count; i++) {
        const double excess = sqrt(fmax(excess_cost[i], 1));
        steps[i].sigma_px *= excess;
        steps[i].height /= excess;
    }
    free(scratch);
    return done;
}

PyObject *call_edge_profiles(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"image", IMAGE, {ANY, ANY}},
                                          {"place", FLOAT64, {N, 2}},
                                          {"normal", FLOAT64, {N, 2}},
                                          {"params", &ProfileParams_record, {0}},
                                          {">value", FLOAT64, {N, M}},
                                          {">saturated", BOOL, {N, M}},
                                          {">noise", FLOAT64, {N}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const Py_buffer *image = &a.view[0], *value = &a.view[4];
    const ProfileParams *params = (const ProfileParams *)a.number[3];
    if (!require(value->shape[1] >= params->inside_px,
                 "value: must have more samples than lie inside"))
        return close_arguments(&a, NULL);
    Profiles profiles = {value->buf, a.view[6].buf, a.view[5].buf, (size_t)value->shape[0], (size_t)value->shape[1]};
    const double right = (double)image->shape[1] - 1, bottom = (double)image->shape[0] - 1;
    const EdgePicture picture = {image->buf, (size_t)image->shape[0], (size_t)image->shape[1], right, bottom,
                                 image->itemsize == 2};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = edge_profiles(&picture, a.view[1].buf, a.view[2].buf, params, &profiles);
    Py_END_ALLOW_THREADS
    return close_arguments(&a, done ? Py_BuildValue("") : PyErr_NoMemory());
}

PyObject *call_edge_steps(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"value", FLOAT64, {N, M}},  {"saturated", BOOL, {N, M}}, {"noise", FLOAT64, {N}},
                                          {"across", FLOAT64, {M}},    {"place", FLOAT64, {K}},        {"unit", FLOAT64, {K}},
                                          {"table", FLOAT64, {3, M, K}}, {"params", &StepParams_record, {0}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const size_t count = (size_t)a.view[0].shape[0], samples = (size_t)a.view[0].shape[1];
    const size_t places = (size_t)a.view[4].shape[0];
    if (!require(samples > 3 && places > 2, "table: must have more than 3 samples and 2 places"))
        return close_arguments(&a, NULL);
    const double *table = a.view[6].buf;
    Profiles profiles = {a.view[0].buf, a.view[2].buf, a.view[1].buf, count, samples};
    const Templates templates = {a.view[3].buf, a.view[4].buf, a.view[5].buf, table, table + samples * places,
                                 table + 2 * samples * places, places};
    EdgeStep *step = malloc((count + 1) * sizeof *step);
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = step && edge_steps(&profiles, &templates, (const StepParams *)a.number[7], step);
    Py_END_ALLOW_THREADS
    PyObject *result = done ? PyBytes_FromStringAndSize((const char *)step, (Py_ssize_t)(count * sizeof *step))
                            : PyErr_NoMemory();
    free(step);
    return close_arguments(&a, result);
}
