/* How the closed forms move with their points. */
#include <math.h>
#include <string.h>

#include "forms.h"

#define FAR_ABOVE 2.0   /* quotients beyond this many times the limit stay beyond it in all steps */
#define ALONG_Z 0x1p-52 /* a normal whose part across z is smaller is along z */

static double inner(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static double largest_distance(const double (*points)[3], int count) {
    double mean[3] = {0, 0, 0}, most = 0;
    for (int i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) mean[k] += points[i][k] / count;
    for (int i = 0; i < count; i++) {
        double apart[3] = {points[i][0] - mean[0], points[i][1] - mean[1], points[i][2] - mean[2]};
        most = fmax(most, inner(apart, apart));
    }
    return sqrt(most);
}

static void tilt_basis(const double normal[3], double basis[2][3]) {
    double x = normal[0], y = normal[1], z = normal[2], size = hypot(x, y);
    double a = size > ALONG_Z ? -y / size : 1, b = size > ALONG_Z ? x / size : 0;
    basis[0][0] = a, basis[0][1] = b, basis[0][2] = 0;
    basis[1][0] = -z * b, basis[1][1] = z * a, basis[1][2] = x * b - y * a;
}

/* One column: what differs between two solutions, over twice the step. */
static void differences(const double *normal, const double (*basis)[3], const double *up, const double *down,
                        double width, double column[SOLUTION_NUMBERS]) {
    double apart[3], up_along = inner(up, normal), down_along = inner(down, normal);
    for (int k = 0; k < 3; k++) apart[k] = up[CENTER + k] - down[CENTER + k];
    for (int j = 0; j < 2; j++) {
        column[j] = inner(up, basis[j]) / up_along - inner(down, basis[j]) / down_along;
        column[3 + j] = inner(apart, basis[j]);
        column[5 + j] = up[RADIUS + j] - down[RADIUS + j];
    }
    column[2] = up[OFFSET] - down[OFFSET];
    for (int k = 0; k < 3; k++) {
        column[7 + k] = apart[k];
        column[10 + k] = up[GRASP + k] - down[GRASP + k];
    }
    for (int i = 0; i < SOLUTION_NUMBERS; i++) column[i] /= width;
}

void form_derivatives(Form solve, const Problem *problem, const double (*points_m)[3], double step,
                      double form[FORM_NUMBERS], double *jacobian) {
    int count = 3 * problem->count;
    double moved[MOST_POINTS][3], up[FORM_NUMBERS], down[FORM_NUMBERS], basis[2][3], column[SOLUTION_NUMBERS];
    double *coordinate = &moved[0][0], reach = step * largest_distance(points_m, problem->count);
    Problem near = *problem;
    solve(problem, points_m, form);
    near.regular = form[QUOTIENT] > FAR_ABOVE * problem->singular_below;
    tilt_basis(form + NORMAL, basis);
    memcpy(moved, points_m, (size_t)count * sizeof(double));
    for (int at = 0; at < count; at++) {
        double own = coordinate[at];
        coordinate[at] = own + reach;
        solve(&near, (const double(*)[3])moved, up);
        coordinate[at] = own - reach;
        solve(&near, (const double(*)[3])moved, down);
        coordinate[at] = own;
        differences(form + NORMAL, (const double(*)[3])basis, up, down, 2 * reach, column);
        for (int i = 0; i < SOLUTION_NUMBERS; i++) jacobian[i * count + at] = column[i];
    }
}
