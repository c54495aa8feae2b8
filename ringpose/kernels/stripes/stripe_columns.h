/* How one piece's columns are measured. No Python in here. */
#ifndef RINGPOSE_STRIPE_COLUMNS_H
#define RINGPOSE_STRIPE_COLUMNS_H

#include "stripes.h"

/* Sums are kept in so many parts, as vectors do it. */
enum { PARTS = 4 };

/* The columns of one piece: their ridges, what the piece's filter says there, the centres, and scratch. */
typedef struct {
    size_t count;
    int32_t *x, *row;
    float *ridge_y, *half_width, *noise, *slope, *bend;
    double *y, *variance, *peak, *square, *ratio;
} Columns;

/* A filter for a stripe of that width (sigma), or for a flat top (0). */
typedef struct {
    const StripeImage *image;
    Patch *patch;
    const Filter *filter;
    double width, inverse_spread; /* of the square of the sigma of the stripe's response; 0 for a flat top */
    double peak_per_response, sigma_per_noise;
    double whole; /* rows from the upper or lower border from which on a centre is that of the whole stripe */
} Measure;

/* Those rows. */
double whole_from(const Filter *filter, double width);

/* Memory for so many columns; NULL if there is none. */
void *allocate_columns(Columns *columns, size_t count);

void take_ridges(const Ridge *ridges, const int32_t *order, size_t count, Columns *columns);

/* The centres, with the variances that the sensor's noise explains; columns in which the filter sees no ridge near by
   are dropped. */
void measure_columns(const Measure *how, Columns *columns);

/* How many columns from one on lie so close that their rows are worked on together; the first and last row. */
size_t neighbours(const Columns *columns, size_t first, int32_t *top, int32_t *bottom);

/* What second differences between centres show: near ones, unless far ones show much more. */
typedef struct {
    double sum;     /* of their squares over what the sensor's noise explains */
    size_t count;   /* of differences */
    size_t lag;     /* columns between the centres */
    int background; /* whether it is far ones */
} Scatter;

Scatter scatter(Columns *columns);

/* The same of centres that far apart. */
Scatter scatter_at(Columns *columns, size_t lag);

/* Mean of those squares, together with a few that are as expected. */
double excess(Scatter of, double expected);

/* Variance of a centre that those differences show. */
double scatter_variance(Columns *columns, Scatter of);

/* Centres anew, from those that the filter found, where speckle scatters them so: by weights that suit each column.
   Columns that show none near by are dropped. Returns how they scatter, over what noise explains of the former. */
Scatter weigh_columns(const Measure *how, Scatter of, Columns *columns, Columns *weighed);

/* A piece that is measured: its scatter, and that by the filter that suited its width. */
typedef struct {
    Scatter of, first;
    size_t columns;
} PieceScatter;

/* The excess of the latter that half the differences of all pieces keep below; sorts them. 1 without any. */
double usual_excess(PieceScatter *pieces, size_t count);

/* Raises the variances to what the differences around each column show; where there are few, to what those of the piece
   and of the frame do. */
void raise_variances(Columns *columns, Scatter of, double usual);

#endif
