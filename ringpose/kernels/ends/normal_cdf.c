/* The table of the normal distribution function. */
#include "normal_cdf.h"

#include <math.h>

double NORMAL_CDF[CDF_STEPS + 1];

void fill_normal_cdf(void) {
    for (int i = 0; i <= CDF_STEPS; i++) NORMAL_CDF[i] = 0.5 * (1 + erf((-4 + 8.0 * i / CDF_STEPS) / sqrt(2)));
}
