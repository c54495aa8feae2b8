/* The median by selection. */
#ifndef RINGPOSE_MEDIAN_H
#define RINGPOSE_MEDIAN_H

#include <stddef.h>

enum { FEW = 12 };

static void sort_few(double *value, size_t n) {
    for (size_t i = 1; i < n; i++) {
        double here = value[i];
        size_t place = i;
        for (; place > 0 && value[place - 1] > here; place--) value[place] = value[place - 1];
        value[place] = here;
    }
}

/* Partition without branches: values below a pivot (or up to it) first; returns their number. */
static size_t below(double *value, size_t n, double pivot, int equal_too) {
    size_t count = 0;
    for (size_t i = 0; i < n; i++) {
        double here = value[i];
        value[i] = value[count];
        value[count] = here;
        count += equal_too ? here <= pivot : here < pivot;
    }
    return count;
}

static double middle_of_three(double a, double b, double c) {
    double low = a < b ? a : b, high = a < b ? b : a;
    return c < low ? low : c < high ? c : high;
}

/* The k-th smallest of n values without NaN, which are reordered: smaller ones lie before it. */
static double kth(double *value, size_t n, size_t k) {
    while (n > FEW) {
        double pivot = middle_of_three(value[n / 4], value[n / 2], value[n - n / 4]);
        size_t fewer = below(value, n, pivot, 0);
        if (k < fewer) {
            n = fewer;
            continue;
        }
        if (fewer == 0) fewer = below(value, n, pivot, 1); /* then none of these is larger */
        if (k < fewer) return pivot;
        value += fewer;
        n -= fewer;
        k -= fewer;
    }
    sort_few(value, n);
    return value[k];
}

/* NumPy's median of n > 0 values without NaN, which are reordered. */
static double median(double *value, size_t n) {
    size_t middle = n / 2;
    double upper = kth(value, n, middle);
    if (n % 2) return upper;
    double lower = value[0];
    for (size_t i = 1; i < middle; i++) lower = value[i] > lower ? value[i] : lower;
    return 0.5 * (lower + upper);
}

#endif
