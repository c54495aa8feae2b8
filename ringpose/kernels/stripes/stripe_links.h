/* Ridges of neighbouring columns linked into pieces. */
#ifndef RINGPOSE_STRIPE_LINKS_H
#define RINGPOSE_STRIPE_LINKS_H

#include "stripe_search.h"

typedef struct {
    int32_t columns, strong_columns;
} StripePiece;

/* Sets the piece of each ridge; 0 if there is no memory. */
int link_ridges(const StripeImage *image, const Filter *filter, const StripeParams *params, List *ridges, List *pieces);

#endif
