/* The most likely ring of stripes and break points. */
#include "ring_search.h"

#include <math.h>
#include <string.h>

#include "triangle.h"

enum { SHIFT = 3, TURN = 4, CURVATURE = 5, BAND = 6 };

static double inner(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

int scratch_numbers(int errors) { return errors * (errors + STATE + 1); }

/* 1 - k (radius -+ band / 2), so that no curvature is forbidden. */
static void add_radii(const RingState *state, const KnownRadii *radii, Search *search, int row) {
    for (int edge = 0; edge < 2; edge++) {
        if (isnan(radii->radius[edge])) continue;
        double sign = edge ? 1 : -1, middle = radii->radius[edge] - 0.5 * sign * state->band;
        double weight = radii->radius[edge] / radii->sd[edge], *by_state = search->by_state[row];
        memset(by_state, 0, STATE * sizeof *by_state);
        by_state[CURVATURE] = -weight * middle;
        by_state[BAND] = weight * 0.5 * sign * state->curvature;
        search->residual[row++] = weight * (1 - state->curvature * middle);
    }
}

static void find_rows(const Evidence *evidence, const Prediction *prediction, Search *search) {
    int sights = evidence->sighted.ends + evidence->sighted.points;
    predict(&search->state, &evidence->sighted, prediction);
    memcpy(search->residual, prediction->residual, (size_t)sights * sizeof(double));
    memcpy(search->by_state, prediction->by_state, (size_t)sights * sizeof search->by_state[0]);
    compare_edges(&search->state, &evidence->edges, prediction->origin, search->residual + sights,
                  search->by_state + sights);
    add_radii(&search->state, &evidence->radii, search, sights + evidence->edges.count);
}

/* Break points and edges may be in the wrong place; lines are fitted robustly before. */
static void weigh(const double *residual, const Evidence *evidence, double huber, Search *search) {
    const int first = evidence->sighted.ends, end = first + evidence->sighted.points + evidence->edges.count;
    for (int i = 0; i < search->rows; i++) {
        double size = i >= first && i < end ? fabs(residual[i]) : 0;
        search->weight[i] = size > huber ? huber / size : 1;
    }
}

/* J^T W J, and J^T W r in the last column. */
static void add_normal_rows(const Search *search, double normal[STATE][STATE + 1]) {
    memset(normal, 0, STATE * sizeof normal[0]);
    for (int row = 0; row < search->rows; row++) {
        const double *by_state = search->by_state[row];
        for (int i = 0; i < STATE; i++) {
            double weighted = by_state[i] * search->weight[row];
            for (int j = i; j < STATE; j++) normal[i][j] += weighted * by_state[j];
            normal[i][STATE] += weighted * search->residual[row];
        }
    }
}

/* What common errors take from it: their part, solved for them. What is left in scratch behind the triangle gives the
   errors once the ring's step is known. */
static int eliminated(const Search *search, const Common *common, double normal[STATE][STATE + 1]) {
    int n = common->errors, wide = STATE + 1;
    double *own = search->scratch, *mixed = own + n * n;
    memset(own, 0, (size_t)scratch_numbers(n) * sizeof *own);
    for (int row = 0; row < search->rows; row++) {
        const double *by_error = common->rows + row * n, *by_state = search->by_state[row];
        for (int i = 0; i < n; i++) {
            double weighted = by_error[i] * search->weight[row];
            if (weighted == 0) continue; /* most errors move few residuals */
            for (int j = 0; j <= i; j++) own[i * n + j] += weighted * by_error[j];
            for (int j = 0; j < STATE; j++) mixed[i * wide + j] += weighted * by_state[j];
            mixed[i * wide + STATE] += weighted * search->residual[row];
        }
    }
    for (int i = 0; i < n; i++) own[i * n + i] += 1;
    if (!factorised(own, n)) return 0;
    solve_lower(own, n, mixed, wide);
    for (int k = 0; k < n; k++)
        for (int i = 0; i < STATE; i++)
            for (int j = i; j < wide; j++) normal[i][j] -= mixed[k * wide + i] * mixed[k * wide + j];
    solve_upper(own, n, mixed, wide);
    return 1;
}

static void find_error_step(const Search *search, int errors, const double step[STATE]) {
    const double *mixed = search->scratch + errors * errors;
    for (int i = 0; i < errors; i++) {
        search->error_step[i] = -mixed[i * (STATE + 1) + STATE];
        for (int j = 0; j < STATE; j++) search->error_step[i] -= mixed[i * (STATE + 1) + j] * step[j];
    }
}

static int find_step(const Common *common, double ridge, Search *search, double step[STATE]) {
    double normal[STATE][STATE + 1], triangle[STATE][STATE];
    add_normal_rows(search, normal);
    if (common->errors && !eliminated(search, common, normal)) return 0;
    for (int i = 0; i < STATE; i++)
        for (int j = i; j < STATE; j++) search->normal_matrix[i][j] = search->normal_matrix[j][i] = normal[i][j];
    memcpy(triangle, search->normal_matrix, sizeof triangle);
    for (int i = 0; i < STATE; i++) triangle[i][i] += ridge, step[i] = -normal[i][STATE];
    if (!factorised(triangle[0], STATE)) return 0;
    memset(search->inverse, 0, sizeof search->inverse);
    for (int i = 0; i < STATE; i++) search->inverse[i][i] = 1;
    solve_lower(triangle[0], STATE, step, 1);
    solve_upper(triangle[0], STATE, step, 1);
    solve_lower(triangle[0], STATE, search->inverse[0], STATE);
    solve_upper(triangle[0], STATE, search->inverse[0], STATE);
    find_error_step(search, common->errors, step);
    return 1;
}

static int is_plausible(const RingState *state, const double step[STATE], const SearchRules *rules) {
    double plane[3];
    for (int i = 0; i < STATE; i++)
        if (!isfinite(step[i])) return 0;
    for (int i = 0; i < 3; i++) plane[i] = state->plane[i] + step[i];
    double inverse_depth = sqrt(inner(plane, plane)), curvature = fabs(state->curvature + step[CURVATURE]);
    return 1 / rules->most_depth < inverse_depth && inverse_depth < 1 / rules->least_depth &&
           curvature < rules->steepest;
}

static double size_of(const double matrix[STATE][STATE], const double step[STATE]) {
    double sum = 0;
    for (int i = 0; i < STATE; i++)
        for (int j = 0; j < STATE; j++) sum += step[i] * matrix[i][j] * step[j];
    return sum;
}

static void expect_left(const Common *common, const double step[STATE], const Search *search) {
    for (int row = 0; row < search->rows; row++) {
        double left = search->residual[row];
        for (int i = 0; i < STATE; i++) left += search->by_state[row][i] * step[i];
        for (int i = 0; i < common->errors; i++)
            left += common->rows[row * common->errors + i] * search->error_step[i];
        search->left[row] = left;
    }
}

/* `outward` goes with the plane and is turned about its normal. */
static void move(const double step[STATE], RingState *state) {
    double *q = state->plane, *u = state->outward, size = sqrt(inner(q, q)), along[3];
    for (int i = 0; i < 3; i++) /* the normal, -q / |q|, times u */
        along[i] = -(q[(i + 1) % 3] * u[(i + 2) % 3] - q[(i + 2) % 3] * u[(i + 1) % 3]) / size;
    for (int i = 0; i < 3; i++) {
        u[i] += step[TURN] * along[i];
        q[i] += step[i];
    }
    double off = inner(u, q) / inner(q, q);
    for (int i = 0; i < 3; i++) u[i] -= off * q[i];
    double length = sqrt(inner(u, u));
    for (int i = 0; i < 3; i++) u[i] /= length;
    state->shift += step[SHIFT];
    state->curvature += step[CURVATURE];
    state->band += step[BAND];
}

int search_ring(const Evidence *evidence, const Common *common, const SearchRules *rules, int first, int last,
                const Prediction *prediction, Search *search) {
    double step[STATE];
    for (int number = first; number < last; number++) {
        find_rows(evidence, prediction, search);
        weigh(number ? search->left : search->residual, evidence, rules->huber, search);
        if (!find_step(common, rules->ridge, search, step)) return SEARCH_FAILED;
        if (!is_plausible(&search->state, step, rules)) return SEARCH_FAILED;
        if (number && size_of(search->normal_matrix, step) < rules->step_sigmas * rules->step_sigmas)
            return SEARCH_DONE;
        expect_left(common, step, search);
        move(step, &search->state);
    }
    return SEARCH_MOVED;
}
