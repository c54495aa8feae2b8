/* Singular values of small matrices of up to four columns, and least squares by them. No Python in here. */
#ifndef RINGPOSE_SINGULAR_H
#define RINGPOSE_SINGULAR_H

enum { MOST_ROWS = 2 * 64 + 1, MOST_COLUMNS = 4 };

typedef struct {
    int rows, columns;
    double at[MOST_COLUMNS][MOST_ROWS]; /* column after column */
} Matrix;

/* matrix V = U S, columns in descending order. */
typedef struct {
    Matrix scaled;                            /* U S */
    double value[MOST_COLUMNS];               /* S */
    double axis[MOST_COLUMNS][MOST_COLUMNS];  /* columns of V */
} Singular;

void singular_values(const Matrix *matrix, Singular *found);

/* (A^T A + damping^2 s_max^2 I)^-1 A^T b, without what is below cut * s_max. */
void damped_solution(const Singular *found, const double *target, double damping, double cut, double *solution);

#endif
