/* The median by selection. */
#ifndef RINGPOSE_SELECT_H
#define RINGPOSE_SELECT_H

#include <stddef.h>

/* The k-th smallest of n values (Hoare), which are reordered. */
static double kth(double *value, size_t n, size_t k) {
    size_t low = 0, high = n - 1;
    while (low < high) {
        double pivot = value[low + (high - low) / 2];
        size_t i = low, j = high;
        for (;;) {
            while (value[i] < pivot) i++;
            while (value[j] > pivot) j--;
            if (i >= j) break;
            double swap = value[i];
            value[i++] = value[j];
            value[j--] = swap;
        }
        if (k <= j)
            high = j;
        else
            low = j + 1;
    }
    return value[k];
}

/* NumPy's median of n > 0 values without NaN, which are reordered. */
static double median(double *value, size_t n) {
    double upper = kth(value, n, n / 2);
    if (n % 2) return upper;
    double lower = value[0];
    for (size_t i = 1; i < n / 2; i++)
        if (value[i] > lower) lower = value[i];
    return 0.5 * (lower + upper);
}

#endif
