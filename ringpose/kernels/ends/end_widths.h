/* How wide the edges of an image are. No Python in here. */
#ifndef RINGPOSE_END_WIDTHS_H
#define RINGPOSE_END_WIDTHS_H

#include <stddef.h>

#include "end_fits.h"

/* A logarithm of a width in columns, and its information. */
typedef struct {
    double logarithm, information;
} EdgeWidth;

/* What one end says of its width. */
EdgeWidth own_width(const Columns *columns, const EdgeFit *fit, double sigma, double likeness);

/* The width of all ends of an image: one lens blurs them. */
EdgeWidth common_width(const EdgeWidth *width, size_t ends, const EndRules *rules);

/* An end's width by itself and by the others. */
EdgeWidth settled_width(const EdgeWidth *own, const EdgeWidth *common, const EndRules *rules);

/* An edge of some width. */
typedef struct {
    double position, width, outside;
    double per_width; /* columns by which the position moves for a width that is e times as large */
} Edge;

Edge edge_of_width(const EdgeFit *fit, double sigma, double width);

#endif
