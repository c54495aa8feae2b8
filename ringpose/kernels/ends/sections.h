/* Cross-sections of a stripe. No Python in here. */
#ifndef RINGPOSE_SECTIONS_H
#define RINGPOSE_SECTIONS_H

#include <stddef.h>

#include "ends.h"

enum { MOST_REACH = 14, MOST_ROWS = 2 * MOST_REACH + 1 };

/* One column's pixels about a stripe's line. */
typedef struct {
    int rows;
    double offset[MOST_ROWS], shape[MOST_ROWS], bright[MOST_ROWS], ambient[MOST_ROWS];
} Section;

/* What is read of a section: rows beyond `inner`, those beyond `flank` for the level beneath. */
typedef struct {
    double inner, flank;
} Parts;

typedef struct {
    double value, rough, gain; /* the peak, the variance about the fit, the share of a pixel's that reaches the peak */
} Peak;

/* A pixel of either image. */
static inline double pixel(const Images *images, const void *data, ptrdiff_t row, ptrdiff_t column) {
    ptrdiff_t at = row * images->width + column;
    return images->wide ? (double)((const uint16_t *)data)[at] : (double)((const uint8_t *)data)[at];
}

/* Sigma of the cross-section in columns first, first + 1, ... with the line at y: the Gaussian nearest to its medians,
   where not saturated. */
double section_sigma(const Images *images, const double *y, ptrdiff_t first, ptrdiff_t count, double saturation);

/* The rows up to `reach` from the line at y; at the border the outermost are repeated. */
void read_section(const Images *images, double y, ptrdiff_t column, int reach, Section *section);

/* Adds to a section that was read what a stripe of that sigma and a peak of 1 would show. */
void shape_section(const Images *images, double y, double sigma, int reach, Section *section);

/* Peak of the Gaussian section on the level of the rows beside it, in values of its rows. */
Peak fitted_peak(const Section *section, const double *value, const Parts *parts);

/* Columns that are fitted at once. */
enum { TOGETHER = 4 };

/* Whether the sections of so many columns lie in the image. */
int sections_inside(const Images *images, const double *y, int reach);

/* The same peaks of so many columns first, first + 1, ... with the line at y, in what the lasers add. */
void fitted_peaks(const Images *images, const double *y, ptrdiff_t first, double sigma, int reach, const Parts *parts,
                  Peak peak[TOGETHER]);

#endif
