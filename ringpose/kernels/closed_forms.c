/* The paper's closed form, read literally, and the same inside the ring's plane. */
#include <math.h>

#include "forms.h"
#include "singular.h"

#define MILLIMETRES 1000.0 /* in a metre */
#define ARC_CUT 1e-12      /* singular values under this share of the largest count as none */

typedef double Point[3];

static double inner(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static double length(const double a[3]) { return sqrt(inner(a, a)); }

static void mean_of(const Point *points, int count, double mean[3]) {
    for (int k = 0; k < 3; k++) {
        mean[k] = 0;
        for (int i = 0; i < count; i++) mean[k] += points[i][k] / count;
    }
}

static void face(double normal[3], const double point[3]) {
    if (inner(normal, point) > 0)
        for (int k = 0; k < 3; k++) normal[k] = -normal[k];
}

/* Rows 2 (P_k - P_0)^T R = |P_k|^2 - |P_0|^2 for each edge, the points measured from their mean. */
static void equal_distance_rows(const Problem *problem, const Point *points, Matrix *rows, double *target) {
    rows->rows = 0;
    rows->columns = 3;
    for (int edge = 0; edge < 2; edge++) {
        int first = -1;
        for (int i = 0; i < problem->count; i++) {
            if (problem->edge[i] != edge) continue;
            if (first >= 0) {
                int row = rows->rows++;
                for (int k = 0; k < 3; k++) rows->at[k][row] = 2 * (points[i][k] - points[first][k]);
                target[row] = inner(points[i], points[i]) - inner(points[first], points[first]);
            } else
                first = i;
        }
    }
}

/* Smallest over largest singular value after scaling the rows to unit length. */
static double inverse_condition(const Matrix *matrix) {
    Matrix scaled;
    Singular found;
    scaled.rows = matrix->rows;
    scaled.columns = matrix->columns;
    for (int i = 0; i < matrix->rows; i++) {
        double square = 0;
        for (int j = 0; j < matrix->columns; j++) square += matrix->at[j][i] * matrix->at[j][i];
        double scale = square > 0 ? 1 / sqrt(square) : 1;
        for (int j = 0; j < matrix->columns; j++) scaled.at[j][i] = scale * matrix->at[j][i];
    }
    singular_values(&scaled, &found);
    return found.value[0] > 0 ? found.value[matrix->columns - 1] / found.value[0] : 0;
}

/* The centre from the mean of the points, and q. */
static double damped_center(const Problem *problem, const Matrix *rows, const double *target, double *step) {
    double quotient = problem->regular ? NAN : inverse_condition(rows);
    double share = fmin(quotient / problem->singular_below, 1); /* 1 if it is NaN */
    Singular found;
    singular_values(rows, &found);
    damped_solution(&found, target, problem->singular_below * sqrt(1 - share * share), 0, step);
    return quotient;
}

static void mean_radii(const Problem *problem, const Point *points, const double center[3], double radius[2]) {
    for (int edge = 0; edge < 2; edge++) {
        double sum = 0;
        int count = 0;
        for (int i = 0; i < problem->count; i++) {
            if (problem->edge[i] != edge) continue;
            double apart[3] = {points[i][0] - center[0], points[i][1] - center[1], points[i][2] - center[2]};
            sum += length(apart);
            count++;
        }
        radius[edge] = count ? sum / count : NAN;
    }
}

void paper_form(const Problem *problem, const Point *points_m, double form[FORM_NUMBERS]) {
    int count = problem->count;
    Point points[MOST_POINTS], centred[MOST_POINTS], mean, plane, step, center;
    double ones[MOST_POINTS], target[MOST_ROWS];
    Matrix rows;
    Singular found;
    rows.rows = count;
    rows.columns = 3;
    for (int i = 0; i < count; i++) {
        ones[i] = 1;
        for (int k = 0; k < 3; k++) rows.at[k][i] = points[i][k] = MILLIMETRES * points_m[i][k];
    }
    mean_of((const Point *)points, count, mean);
    singular_values(&rows, &found);
    damped_solution(&found, ones, 0, 0, plane);

    for (int i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) centred[i][k] = points[i][k] - mean[k];
    equal_distance_rows(problem, (const Point *)centred, &rows, target);
    for (int k = 0; k < 3; k++) rows.at[k][rows.rows] = plane[k];
    target[rows.rows++] = 1 - inner(plane, mean);
    form[QUOTIENT] = damped_center(problem, &rows, target, step);

    double size = length(plane);
    for (int k = 0; k < 3; k++) {
        center[k] = mean[k] + step[k];
        form[NORMAL + k] = plane[k] / size;
        form[CENTER + k] = center[k] / MILLIMETRES;
        form[GRASP + k] = mean[k] / MILLIMETRES;
    }
    face(form + NORMAL, mean);
    form[OFFSET] = -1 / size / MILLIMETRES;
    mean_radii(problem, (const Point *)points, center, form + RADIUS);
    for (int edge = 0; edge < 2; edge++) form[RADIUS + edge] /= MILLIMETRES;
}

/* Where two arcs about one centre cross the radius through the mean of their points, and that radius' direction. */
static void cross_arcs(const Problem *problem, const double (*flat)[2], double *middle, double outward[2]) {
    int count = problem->count;
    double scale = 0, target[MOST_POINTS], s[MOST_COLUMNS];
    for (int i = 0; i < count; i++) scale = fmax(scale, fmax(fabs(flat[i][0]), fabs(flat[i][1])));
    scale = fmax(scale, 1e-300);
    Matrix rows;
    rows.rows = count;
    rows.columns = 4;
    for (int i = 0; i < count; i++) {
        double x = flat[i][0] / scale, y = flat[i][1] / scale;
        rows.at[0][i] = x * x + y * y;
        rows.at[1][i] = y;
        rows.at[2][i] = problem->edge[i] == 0;
        rows.at[3][i] = problem->edge[i] == 1;
        target[i] = -x;
    }
    Singular found;
    singular_values(&rows, &found);
    damped_solution(&found, target, 0, ARC_CUT, s);
    double bend = s[0] / scale, steepness = hypot(1, s[1]);
    *middle = 0;
    for (int edge = 0; edge < 2; edge++) {
        double level = s[2 + edge] * scale, square = steepness * steepness - 4 * bend * level;
        *middle += -level / (steepness + sqrt(fmax(square, 0)));
    }
    outward[0] = 1 / steepness;
    outward[1] = s[1] / steepness;
}

static void mid_band_point(const Problem *problem, const Point *points, const double mean[3], const double normal[3],
                           double grasp[3]) {
    double between[3] = {0, 0, 0}, flat[MOST_POINTS][2], middle, outward[2];
    int seen[2] = {0, 0};
    for (int i = 0; i < problem->count; i++) seen[problem->edge[i]]++;
    for (int i = 0; i < problem->count; i++)
        for (int k = 0; k < 3; k++)
            between[k] += (problem->edge[i] ? points[i][k] : -points[i][k]) / seen[problem->edge[i]];
    double lift = inner(between, normal);
    for (int k = 0; k < 3; k++) between[k] -= lift * normal[k];
    double size = seen[0] && seen[1] ? length(between) : 0, x[3], y[3];
    for (int k = 0; k < 3; k++) x[k] = size > 0 ? between[k] / size : NAN;
    for (int k = 0; k < 3; k++) y[k] = normal[(k + 1) % 3] * x[(k + 2) % 3] - normal[(k + 2) % 3] * x[(k + 1) % 3];
    if (!(size > 0)) {
        for (int k = 0; k < 3; k++) grasp[k] = NAN;
        return;
    }
    for (int i = 0; i < problem->count; i++) {
        double apart[3] = {points[i][0] - mean[0], points[i][1] - mean[1], points[i][2] - mean[2]};
        flat[i][0] = inner(apart, x);
        flat[i][1] = inner(apart, y);
    }
    cross_arcs(problem, (const double(*)[2])flat, &middle, outward);
    for (int k = 0; k < 3; k++) grasp[k] = mean[k] + middle * (outward[0] * x[k] + outward[1] * y[k]);
}

void constrained_form(const Problem *problem, const Point *points_m, double form[FORM_NUMBERS]) {
    int count = problem->count;
    Point centred[MOST_POINTS], mean;
    double target[MOST_ROWS], step[2];
    Matrix rows, in_plane;
    Singular found;
    rows.rows = count;
    rows.columns = 3;
    in_plane.columns = 2;
    mean_of(points_m, count, mean);
    for (int i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) rows.at[k][i] = centred[i][k] = points_m[i][k] - mean[k];
    singular_values(&rows, &found);
    for (int k = 0; k < 3; k++) form[NORMAL + k] = found.axis[2][k];
    face(form + NORMAL, mean);
    form[OFFSET] = inner(form + NORMAL, mean);

    equal_distance_rows(problem, (const Point *)centred, &rows, target);
    in_plane.rows = rows.rows;
    for (int i = 0; i < rows.rows; i++) {
        double row[3] = {rows.at[0][i], rows.at[1][i], rows.at[2][i]};
        for (int j = 0; j < 2; j++) in_plane.at[j][i] = inner(row, found.axis[j]);
    }
    form[QUOTIENT] = damped_center(problem, &in_plane, target, step);
    for (int k = 0; k < 3; k++)
        form[CENTER + k] = mean[k] + step[0] * found.axis[0][k] + step[1] * found.axis[1][k];
    mean_radii(problem, points_m, form + CENTER, form + RADIUS);
    mid_band_point(problem, points_m, mean, form + NORMAL, form + GRASP);
}

void nearest_plane(const Point *points_m, int count, double plane[PLANE_NUMBERS]) {
    Point mean;
    Matrix rows;
    Singular found;
    mean_of(points_m, count, mean);
    rows.rows = count;
    rows.columns = 3;
    for (int i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) rows.at[k][i] = points_m[i][k] - mean[k];
    singular_values(&rows, &found);
    for (int k = 0; k < 3; k++) {
        plane[k] = found.axis[2][k];
        plane[4 + k] = found.value[k];
    }
    plane[3] = inner(plane, mean);
}
