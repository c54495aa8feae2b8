/* Cross-sections of a stripe: their width, and how bright each is. */
#include "sections.h"

#include <math.h>
#include <stdlib.h>

#include "kernels.h"
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

/* ---- four columns at once ---- */

typedef double Doubles __attribute__((vector_size(8 * TOGETHER), aligned(8), may_alias));
typedef int64_t Masks __attribute__((vector_size(8 * TOGETHER), aligned(8), may_alias));

typedef struct {
    Doubles offset[MOST_ROWS], value[MOST_ROWS], shape[MOST_ROWS];
} Sections;

int sections_inside(const Images *images, const double *y, int reach) {
    int inside = 1;
    for (int i = 0; i < TOGETHER; i++)
        inside &= rint(y[i]) >= reach && rint(y[i]) + reach < (double)images->height;
    return inside;
}

static inline void load_sections(const Images *images, const double *y, ptrdiff_t first, int reach,
                                 Sections *sections) {
    for (int i = 0; i < TOGETHER; i++) {
        double *value = (double *)sections->value + i, *offset = (double *)sections->offset + i;
        ptrdiff_t top = (ptrdiff_t)rint(y[i]) - reach;
        for (int k = 0; k <= 2 * reach; k++) {
            value[TOGETHER * k] = pixel(images, images->lit, top + k, first + i);
            offset[TOGETHER * k] = fabs((double)(top + k) - y[i]);
        }
        for (int k = 0; images->dark && k <= 2 * reach; k++)
            value[TOGETHER * k] -= pixel(images, images->dark, top + k, first + i);
    }
}

static inline void shape_sections(const double *y, double sigma, int reach, Sections *sections) {
    double per_variance = 1 / (sigma * sigma), fall = exp(-0.5 * per_variance), square = fall * fall;
    Doubles here, lean;
    for (int i = 0; i < TOGETHER; i++) {
        double off = y[i] - rint(y[i]);
        here[i] = exp(-0.5 * off * off * per_variance);
        lean[i] = exp(off * per_variance);
    }
    Doubles below = here - here + 1, above = below, down = fall * lean, up = fall * (1 / lean);
    Doubles *shape = sections->shape + reach;
    for (int k = 0; k <= reach; k++) {
        shape[k] = here * below;
        shape[-k] = here * above;
        below *= down;
        above *= up;
        down *= square;
        up *= square;
    }
}

/* What a vector is where a mask is set, else nothing. */
#define WHERE(mask, vector) ((Doubles)((Masks)(vector) & (mask)))

static inline void fit_peaks(const Sections *sections, int rows, const Parts *parts, Doubles peak[3]) {
    const Doubles zero = {0}, one = zero + 1;
    Doubles level = zero, under = zero, beside = zero, used = zero, residuals = zero;
    Doubles norm = zero, sum = zero, weights = zero, squares = zero;
    for (int k = 0; k < rows; k++) {
        Masks flank = sections->offset[k] > parts->flank;
        beside += WHERE(flank, one);
        level += WHERE(flank, sections->value[k]);
        under += WHERE(flank, sections->shape[k]);
    }
    Masks any = beside > 0;
    Doubles count = beside + WHERE(~any, one);
    level /= count;
    under /= count;
    for (int k = 0; k < rows; k++) {
        Masks core = (sections->offset[k] > parts->inner) & (sections->offset[k] <= parts->flank);
        Doubles shape = WHERE(core, sections->shape[k]);
        norm += shape * (sections->shape[k] - under);
        sum += shape * (sections->value[k] - level);
        weights += shape;
        squares += shape * shape;
    }
    Masks enough = norm > 1e-9;
    norm = WHERE(enough, norm) + WHERE(~enough, zero + 1e-9);
    peak[0] = sum / norm;
    peak[2] = (squares + WHERE(any, weights * weights / count)) / (norm * norm);
    for (int k = 0; k < rows; k++) {
        Masks here = sections->offset[k] > parts->inner;
        Doubles residual = sections->value[k] - level - peak[0] * (sections->shape[k] - under);
        residuals += WHERE(here, residual * residual);
        used += WHERE(here, one);
    }
    Masks many = used > 3;
    peak[1] = residuals / (WHERE(many, used - 2) + WHERE(~many, one));
}

VECTOR_LOOP
void fitted_peaks(const Images *images, const double *y, ptrdiff_t first, double sigma, int reach, const Parts *parts,
                  Peak peak[TOGETHER]) {
    Sections sections;
    Doubles found[3];
    load_sections(images, y, first, reach, &sections);
    shape_sections(y, sigma, reach, &sections);
    fit_peaks(&sections, 2 * reach + 1, parts, found);
    for (int i = 0; i < TOGETHER; i++) peak[i] = (Peak){found[0][i], found[1][i], found[2][i]};
}
