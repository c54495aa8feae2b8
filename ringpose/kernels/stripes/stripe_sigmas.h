/* Standard deviations of centres from second differences. */
#ifndef RINGPOSE_STRIPE_SIGMAS_H
#define RINGPOSE_STRIPE_SIGMAS_H

#include <stddef.h>
#include <stdint.h>

/* Partial sums, as a vector register holds them. */
enum { PARTS = 4 };

/* The columns of one piece: ridges, filter responses, centres, and scratch memory. */
typedef struct {
    size_t count;
    int32_t *x, *row;
    float *ridge_y, *half_width, *noise, *slope, *curvature;
    double *y, *variance, *peak, *square, *ratio;
} Columns;

/* Scatter of centres by second differences at a near lag, or at a far one if that is much larger. */
typedef struct {
    double sum;     /* of the squared differences over the variance expected from sensor noise */
    size_t count;   /* number of differences */
    size_t lag;     /* columns between the centres */
    int background; /* true for the far lag */
} Scatter;

Scatter scatter(Columns *columns);

/* Scatter of centres by second differences at a given lag. */
Scatter scatter_at(Columns *columns, size_t lag);

/* Mean of the terms of `Scatter.sum` (reduced chi-square), shrunk towards `expected`. */
double excess(Scatter of, double expected);

/* Variance of a centre according to the second differences. */
double scatter_variance(Columns *columns, Scatter of);

/* A measured piece: its scatter, and that with the filter matched to its width. */
typedef struct {
    Scatter of, first;
    size_t columns;
} PieceScatter;

/* Weighted median of the excess of all pieces; sorts them. 1 if there are none. */
double pooled_excess(PieceScatter *pieces, size_t count);

/* Raises the variances to the scatter around each column, shrunk towards that of the piece and of the frame. */
void raise_variances(Columns *columns, Scatter of, double pooled);

#endif
