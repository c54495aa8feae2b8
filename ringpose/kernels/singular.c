/* Singular values by one-sided Jacobi rotations (Hestenes): columns are turned in pairs until all are orthogonal.
   Accurate to rounding even where values differ by ten orders, as those of the paper's equations in millimetres. */
#include "singular.h"

#include <math.h>

enum { MOST_SWEEPS = 30 };
#define ORTHOGONAL 1e-15

static double dot(const double *a, const double *b, int n) {
    double sum = 0;
    for (int i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

static void turn(double *a, double *b, int n, double cosine, double sine) {
    for (int i = 0; i < n; i++) {
        double first = a[i], second = b[i];
        a[i] = cosine * first - sine * second;
        b[i] = sine * first + cosine * second;
    }
}

/* Makes two columns orthogonal; 0 if they were. */
static int made_orthogonal(Singular *found, int p, int q) {
    int rows = found->scaled.rows, columns = found->scaled.columns;
    double *a = found->scaled.at[p], *b = found->scaled.at[q];
    double aa = dot(a, a, rows), bb = dot(b, b, rows), ab = dot(a, b, rows);
    if (!(fabs(ab) > ORTHOGONAL * sqrt(aa * bb))) return 0;
    double zeta = (bb - aa) / (2 * ab);
    double tangent = copysign(1 / (fabs(zeta) + sqrt(1 + zeta * zeta)), zeta);
    double cosine = 1 / sqrt(1 + tangent * tangent), sine = cosine * tangent;
    turn(a, b, rows, cosine, sine);
    turn(found->axis[p], found->axis[q], columns, cosine, sine);
    return 1;
}

static void swap(Singular *found, int p, int q) {
    turn(found->scaled.at[p], found->scaled.at[q], found->scaled.rows, 0, 1);
    turn(found->axis[p], found->axis[q], found->scaled.columns, 0, 1);
    double value = found->value[p];
    found->value[p] = found->value[q];
    found->value[q] = value;
}

void singular_values(const Matrix *matrix, Singular *found) {
    int columns = matrix->columns;
    found->scaled.rows = matrix->rows;
    found->scaled.columns = columns;
    for (int j = 0; j < columns; j++) {
        for (int i = 0; i < matrix->rows; i++) found->scaled.at[j][i] = matrix->at[j][i];
        for (int i = 0; i < columns; i++) found->axis[j][i] = i == j;
    }
    for (int sweep = 0, turned = 1; turned && sweep < MOST_SWEEPS; sweep++) {
        turned = 0;
        for (int p = 0; p < columns; p++)
            for (int q = p + 1; q < columns; q++) turned |= made_orthogonal(found, p, q);
    }
    for (int j = 0; j < columns; j++) found->value[j] = sqrt(dot(found->scaled.at[j], found->scaled.at[j], matrix->rows));
    for (int p = 0; p < columns; p++)
        for (int q = p + 1; q < columns; q++)
            if (found->value[q] > found->value[p]) swap(found, p, q);
}

void damped_solution(const Singular *found, const double *target, double damping, double cut, double *solution) {
    int columns = found->scaled.columns;
    double most = found->value[0], extra = damping * most * damping * most;
    for (int i = 0; i < columns; i++) solution[i] = 0;
    for (int j = 0; j < columns; j++) {
        double square = found->value[j] * found->value[j] + extra;
        if (!(square > 0) || !(found->value[j] > cut * most)) continue;
        double gain = dot(found->scaled.at[j], target, found->scaled.rows) / square;
        for (int i = 0; i < columns; i++) solution[i] += gain * found->axis[j][i];
    }
}
