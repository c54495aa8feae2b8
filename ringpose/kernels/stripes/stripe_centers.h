/* Sub-pixel centres of linked ridges. */
#ifndef RINGPOSE_STRIPE_CENTERS_H
#define RINGPOSE_STRIPE_CENTERS_H

#include "stripe_links.h"

/* Centres, piece after piece; there is room for all ridges of the kept pieces. */
typedef struct {
    double *position, *sigma, *peak; /* position: x and y */
    int64_t *piece;
    size_t count;
} Centers;

/* Number of ridges in pieces that are long and strong enough. */
size_t kept_ridges(const StripeParams *params, const List *pieces);

/* Returns 0 if there is no memory. */
int find_centers(const StripeImage *image, const Filter *filters, size_t filter_count, const StripeParams *params,
                 const List *ridges, const List *pieces, Centers *centers);

#endif
