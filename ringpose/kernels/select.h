/* The median by selection. */
#ifndef RINGPOSE_SELECT_H
#define RINGPOSE_SELECT_H

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

/* Puts the values below a pivot first (or those up to it), without branches; returns how many they are. */
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

/* Of many values, so many tell about where the median lies: between those of these ranks. */
enum { MANY = 256, TOO_MANY = 2048, TELLING = 41, LOWER = 13, UPPER = 27 };

/* Copies values about the median, in one pass without branches, and tells how many are smaller than those; 0 if the
   median is not sure to be among them. */
static size_t near_median(const double *value, size_t n, double *near, size_t *smaller) {
    double some[TELLING];
    size_t inside = 0, fewer = 0;
    for (size_t i = 0; i < TELLING; i++) some[i] = value[i * n / TELLING];
    sort_few(some, TELLING);
    double low = some[LOWER], high = some[UPPER];
    for (size_t i = 0; i < n; i++) {
        near[inside] = value[i];
        fewer += value[i] < low;
        inside += (size_t)(value[i] >= low) & (size_t)(value[i] <= high);
    }
    *smaller = fewer;
    return fewer < n / 2 && n / 2 < fewer + inside ? inside : 0;
}

/* NumPy's median of n > 0 values without NaN, which are reordered. */
static double median(double *value, size_t n) {
    double near[TOO_MANY];
    size_t smaller = 0, middle = n / 2, count = n;
    size_t found = n < MANY || n > TOO_MANY ? 0 : near_median(value, n, near, &smaller);
    if (found) {
        value = near;
        count = found;
        middle -= smaller;
    }
    double upper = kth(value, count, middle);
    if (n % 2) return upper;
    double lower = value[0];
    for (size_t i = 1; i < middle; i++) lower = value[i] > lower ? value[i] : lower;
    return 0.5 * (lower + upper);
}

#endif
