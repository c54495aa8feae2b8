/* Variance of a fitted edge's position. */
#ifndef RINGPOSE_END_SIGMAS_H
#define RINGPOSE_END_SIGMAS_H

#include "end_edges.h"

/* Bias of an edge's position by the curvature of the model, Eq. (3.10), -1/2 sum(u_k m_k'') times the variance of the
   position (Box 1971): speckle is proportional to the light, so that the foot of the edge, where the curve is convex,
   has most of the weight, and the edge would be found too far inside. For columns without saturation. */
double second_order_bias(const Columns *columns, const Edge *edge, double variance);

/* Variance of an edge's position along the columns. `correlation`: of the speckle of neighbouring columns;
   `information`: of the logarithm of the edge's width. */
double edge_variance(const Columns *columns, const Edge *edge, double correlation, double information,
                     const EndParams *params);

/* Mean squared distance from the edge, whose own variance is given, over all possible positions of the end. */
double variance_over_places(const Columns *columns, const EdgeFit *fit, const Edge *edge, double variance,
                            double correlation);

#endif
