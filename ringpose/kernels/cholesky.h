/* Symmetric, positive equations by their triangle (Cholesky); matrices by rows, of n rows and columns. */
#ifndef RINGPOSE_CHOLESKY_H
#define RINGPOSE_CHOLESKY_H

#include <math.h>

/* The factor L of a = L L^T, in the lower triangle of a; 0 if a is not positive definite. */
static int factorised(double *a, int n) {
    for (int j = 0; j < n; j++) {
        for (int k = 0; k < j; k++)
            for (int i = j; i < n; i++) a[i * n + j] -= a[i * n + k] * a[j * n + k];
        if (!(a[j * n + j] > 0) || isinf(a[j * n + j])) return 0;
        double root = sqrt(a[j * n + j]);
        for (int i = j; i < n; i++) a[i * n + j] /= root;
    }
    return 1;
}

/* L x = b, for `count` columns of b, in place. */
static void solve_lower(const double *l, int n, double *b, int count) {
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < i; k++)
            for (int c = 0; c < count; c++) b[i * count + c] -= l[i * n + k] * b[k * count + c];
        for (int c = 0; c < count; c++) b[i * count + c] /= l[i * n + i];
    }
}

/* L^T x = b. */
static void solve_upper(const double *l, int n, double *b, int count) {
    for (int i = n; i-- > 0;) {
        for (int k = i + 1; k < n; k++)
            for (int c = 0; c < count; c++) b[i * count + c] -= l[k * n + i] * b[k * count + c];
        for (int c = 0; c < count; c++) b[i * count + c] /= l[i * n + i];
    }
}

/* L L^T x = b. */
static inline void solve(const double *l, int n, double *b, int count) {
    solve_lower(l, n, b, count);
    solve_upper(l, n, b, count);
}

#endif
