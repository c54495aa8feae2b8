/* Cross-sections of a stripe: their width, and how bright each is. Twin: reference_profile.py. */
#include "sections.h"

#include <math.h>
#include <stdlib.h>

#include "minimum.h"
#include "select.h"

enum { SECTION_ROWS = 10, ROWS = 2 * SECTION_ROWS + 1, SECTION_COLUMNS = 64, SIGMAS = 17 };

/* Medians over some columns of the face of each row about the line, of the light and of what the lasers add; 0 if no
   column's section lies in the image. */
static size_t median_section(const Images *images, const double *y, ptrdiff_t first, ptrdiff_t face,
                             double *bright, double *value) {
    double lit[ROWS][SECTION_COLUMNS], added[ROWS][SECTION_COLUMNS];
    ptrdiff_t some = face < SECTION_COLUMNS ? face : SECTION_COLUMNS;
    size_t found = 0;
    for (ptrdiff_t k = 0; k < some; k++) {
        ptrdiff_t i = k * face / some, row = (ptrdiff_t)rint(y[i]);
        if (row - SECTION_ROWS < 0 || row + SECTION_ROWS >= images->height) continue;
        for (ptrdiff_t r = 0; r < ROWS; r++) {
            ptrdiff_t at = row + r - SECTION_ROWS, column = first + i;
            lit[r][found] = pixel(images, images->lit, at, column);
            if (images->dark) added[r][found] = lit[r][found] - pixel(images, images->dark, at, column);
        }
        found++;
    }
    for (int r = 0; found && r < ROWS; r++) {
        bright[r] = median(lit[r], found);
        value[r] = images->dark ? median(added[r], found) : bright[r];
    }
    return found;
}

/* Values of a Gaussian at whole steps from where it is 1: each is the one before times a factor that falls by the
   square of `fall`, its value at one step from the middle; `lean` is what the first factor differs from that. */
static void fill_gauss(double fall, double lean, int count, double *value) {
    double here = 1, factor = fall * lean, square = fall * fall;
    for (int k = 0; k < count; k++) {
        value[k] = here;
        here *= factor;
        factor *= square;
    }
}

/* Squares that a Gaussian on a level leaves of a section; infinite if it would be a dark one. Rows are rounded to whole
   pixels from the line, which adds a variance of 1/12. */
static double section_cost(const int *offset, const double *value, int rows, double sigma) {
    double gauss[SECTION_ROWS + 1], shape[ROWS], mean_shape = 0, mean = 0, norm = 0, product = 0, cost = 0;
    if (rows < 6) return INFINITY;
    fill_gauss(exp(-0.5 / (sigma * sigma + 1.0 / 12)), 1, SECTION_ROWS + 1, gauss);
    for (int r = 0; r < rows; r++) {
        shape[r] = gauss[abs(offset[r])];
        mean_shape += shape[r] / rows;
        mean += value[r] / rows;
    }
    for (int r = 0; r < rows; r++) {
        norm += (shape[r] - mean_shape) * (shape[r] - mean_shape);
        product += (shape[r] - mean_shape) * (value[r] - mean);
    }
    double amplitude = product / fmax(norm, 1e-12);
    if (!(amplitude > 0)) return INFINITY;
    for (int r = 0; r < rows; r++) {
        double residual = value[r] - mean - amplitude * (shape[r] - mean_shape);
        cost += residual * residual;
    }
    return cost;
}

double section_sigma(const Images *images, const double *y, ptrdiff_t first, ptrdiff_t count, double saturation) {
    double bright[ROWS], value[ROWS], cost[SIGMAS];
    int offset[ROWS];
    if (!median_section(images, y, first, count, bright, value)) return 1.5;
    int rows = 0, k = 0;
    for (int r = 0; r < ROWS; r++)
        if (bright[r] < saturation) {
            offset[rows] = r - SECTION_ROWS;
            value[rows++] = value[r];
        }
    for (int s = 0; s < SIGMAS; s++) {
        cost[s] = section_cost(offset, value, rows, 0.7 * pow(4 / 0.7, s / 16.0));
        if (cost[s] < cost[k]) k = s;
    }
    if (!isfinite(cost[k])) return 1.5;
    double shift = k > 0 && k < SIGMAS - 1 ? parabola(cost[k - 1], cost[k], cost[k + 1]) : 0;
    return 0.7 * pow(4 / 0.7, (k + shift) / 16);
}

void read_section(const Images *images, double y, ptrdiff_t column, int reach, Section *section) {
    ptrdiff_t middle = (ptrdiff_t)rint(y);
    section->rows = 2 * reach + 1;
    for (int k = 0; k < section->rows; k++) {
        ptrdiff_t row = middle + k - reach, at = row < 0 ? 0 : row >= images->height ? images->height - 1 : row;
        section->offset[k] = fabs((double)at - y);
        section->bright[k] = pixel(images, images->lit, at, column);
        if (images->dark) section->ambient[k] = pixel(images, images->dark, at, column);
    }
    double darker = fmin(section->bright[0], section->bright[section->rows - 1]);
    for (int k = 0; !images->dark && k < section->rows; k++) section->ambient[k] = darker;
}

void shape_section(const Images *images, double y, double sigma, int reach, Section *section) {
    double per_variance = 1 / (sigma * sigma), middle = rint(y), off = y - middle, *shape = section->shape;
    if (middle < reach || middle + reach >= (double)images->height) { /* rows are repeated there */
        for (int k = 0; k < section->rows; k++)
            shape[k] = exp(-0.5 * section->offset[k] * section->offset[k] * per_variance);
        return;
    }
    double here = exp(-0.5 * off * off * per_variance), fall = exp(-0.5 * per_variance);
    double lean = exp(off * per_variance), value[MOST_ROWS];
    fill_gauss(fall, lean, reach + 1, value);
    for (int k = 0; k <= reach; k++) shape[reach + k] = here * value[k];
    fill_gauss(fall, 1 / lean, reach + 1, value);
    for (int k = 1; k <= reach; k++) shape[reach - k] = here * value[k];
}

Peak fitted_peak(const Section *section, const double *value, const Parts *parts) {
    double level = 0, under = 0, norm = 0, sum = 0, weights = 0, squares = 0, residuals = 0;
    int beside = 0, used = 0;
    for (int k = 0; k < section->rows; k++)
        if (section->offset[k] > parts->flank) {
            beside++;
            level += value[k];
            under += section->shape[k];
        }
    if (beside) level /= beside;
    if (beside) under /= beside;
    for (int k = 0; k < section->rows; k++) {
        double shape = section->shape[k];
        if (!(section->offset[k] > parts->inner) || section->offset[k] > parts->flank) continue;
        norm += shape * (shape - under);
        sum += shape * (value[k] - level);
        weights += shape;
        squares += shape * shape;
    }
    norm = fmax(norm, 1e-9);
    Peak peak = {sum / norm, 0, (squares + (beside ? weights * weights / beside : 0)) / (norm * norm)};
    for (int k = 0; k < section->rows; k++) {
        if (!(section->offset[k] > parts->inner)) continue;
        double residual = value[k] - level - peak.value * (section->shape[k] - under);
        residuals += residual * residual;
        used++;
    }
    peak.rough = residuals / (used > 3 ? used - 2 : 1);
    return peak;
}
