/* The intensity profile of a stripe along its line: the amplitude of a Gaussian cross-section in every column, and the
   share of it that saturation leaves visible (headroom). */
#include "ends.h"
#include "kernels.h"
#include "median.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_REACH = 14, MAX_ROWS = 2 * MAX_REACH + 1 };

/* Pixels of one column about the stripe's line. */
typedef struct {
    int rows;
    double offset[MAX_ROWS], shape[MAX_ROWS], bright[MAX_ROWS], ambient[MAX_ROWS];
} Section;

/* Rows of a section that are used: those beyond `inner` from the line; those beyond `flank` give the background level,
   those of a side that is brighter than the other by more than `contrast` excepted. */
typedef struct {
    double inner, flank, contrast;
} Parts;

/* Offset of a row that is not used. */
#define UNUSED (-1.0)

typedef struct {
    double value, residual_variance, gain; /* amplitude; gain: variance of the amplitude over that of a pixel */
} Peak;

/* A pixel of either image. */
static inline double pixel(const Images *images, const void *data, ptrdiff_t row, ptrdiff_t column) {
    ptrdiff_t at = row * images->width + column;
    return images->wide ? (double)((const uint16_t *)data)[at] : (double)((const uint8_t *)data)[at];
}

/* Columns that are fitted at once. */
enum { TOGETHER = 4 };

enum { SECTION_ROWS = 10, ROWS = 2 * SECTION_ROWS + 1, SECTION_COLUMNS = 64, SIGMAS = 17 };

/* For each row about the line, medians over some columns of the face: grey value, and light of the lasers alone.
   Returns the number of columns whose section lies in the image. */
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

/* Gaussian at integer steps by recursion: g[k + 1] = g[k] f[k], f[k + 1] = f[k] fall^2, f[0] = fall * ratio, where
   `fall` is its value one step from the middle. */
static void fill_gauss(double fall, double ratio, int count, double *value) {
    double here = 1, factor = fall * ratio, square = fall * fall;
    for (int k = 0; k < count; k++) {
        value[k] = here;
        here *= factor;
        factor *= square;
    }
}

/* Residual sum of squares of a Gaussian plus a constant; infinite if its amplitude is negative. The line is rounded to
   whole rows, which adds a variance of 1/12. */
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

/* Sigma of the cross-section in columns first, first + 1, ... with the line at y: the Gaussian nearest to its medians,
   where not saturated. */
static double section_sigma(const Images *images, const double *y, ptrdiff_t first, ptrdiff_t count,
                            double saturation) {
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

/* The rows up to `reach` from the line at y; at the border the outermost are repeated. */
static void read_section(const Images *images, double y, ptrdiff_t column, int reach, Section *section) {
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

/* Adds to a section that was read what a stripe of that sigma and a peak of 1 would show. */
static void shape_section(const Images *images, double y, double sigma, int reach, Section *section) {
    double per_variance = 1 / (sigma * sigma), middle = rint(y), off = y - middle, *shape = section->shape;
    if (middle < reach || middle + reach >= (double)images->height) { /* rows are repeated there */
        for (int k = 0; k < section->rows; k++)
            shape[k] = exp(-0.5 * section->offset[k] * section->offset[k] * per_variance);
        return;
    }
    double here = exp(-0.5 * off * off * per_variance), fall = exp(-0.5 * per_variance);
    double ratio = exp(off * per_variance), value[MAX_ROWS];
    fill_gauss(fall, ratio, reach + 1, value);
    for (int k = 0; k <= reach; k++) shape[reach + k] = here * value[k];
    fill_gauss(fall, 1 / ratio, reach + 1, value);
    for (int k = 1; k <= reach; k++) shape[reach - k] = here * value[k];
}

/* Peak of the Gaussian section on the level of the rows beside it, in values of its rows. */
static Peak fitted_peak(const Section *section, const double *value, const Parts *parts) {
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
    peak.residual_variance = residuals / (used > 3 ? used - 2 : 1);
    return peak;
}

/* ---- four columns at once ---- */

typedef double Doubles __attribute__((vector_size(8 * TOGETHER), aligned(8), may_alias));
typedef int64_t Masks __attribute__((vector_size(8 * TOGETHER), aligned(8), may_alias));

typedef struct {
    Doubles offset[MAX_ROWS], value[MAX_ROWS], shape[MAX_ROWS];
} Sections;

/* True if the sections of this number of columns lie in the image. */
static int sections_inside(const Images *images, const double *y, int reach) {
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
    Doubles here, ratio;
    for (int i = 0; i < TOGETHER; i++) {
        double off = y[i] - rint(y[i]);
        here[i] = exp(-0.5 * off * off * per_variance);
        ratio[i] = exp(off * per_variance);
    }
    Doubles below = here - here + 1, above = below, down = fall * ratio, up = fall * (1 / ratio);
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

/* A vector where a mask is set, else 0. */
#define WHERE(mask, vector) ((Doubles)((Masks)(vector) & (mask)))

/* Leaves out the rows of a brighter side, where a stripe on the body lies a few rows beside the line. Sections at the
   image's border, and the last columns of a profile, are fitted one by one, with both sides. */
static inline void leave_out_brighter_sides(Sections *sections, int rows, const Parts *parts) {
    const Doubles zero = {0}, one = zero + 1;
    Doubles sum[2] = {zero, zero}, count[2] = {zero, zero};
    for (int k = 0; k < rows; k++) {
        Masks flank = sections->offset[k] > parts->flank;
        sum[k > rows / 2] += WHERE(flank, sections->value[k]);
        count[k > rows / 2] += WHERE(flank, one);
    }
    Doubles difference = sum[1] * count[0] - sum[0] * count[1], limit = parts->contrast * count[0] * count[1];
    Masks second = difference > limit, first = -difference > limit;
    for (int k = 0; k < rows; k++) {
        Masks unused = (sections->offset[k] > parts->flank) & (k > rows / 2 ? second : first);
        sections->offset[k] = WHERE(unused, zero + UNUSED) + WHERE(~unused, sections->offset[k]);
    }
}

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

/* The same peaks of this number of columns first, first + 1, ... with the line at y, in what the lasers add. */
VECTOR_LOOP
static void fitted_peaks(const Images *images, const double *y, ptrdiff_t first, double sigma, int reach,
                         const Parts *parts,
                  Peak peak[TOGETHER]) {
    Sections sections;
    Doubles found[3];
    load_sections(images, y, first, reach, &sections);
    shape_sections(y, sigma, reach, &sections);
    if (isfinite(parts->contrast)) leave_out_brighter_sides(&sections, 2 * reach + 1, parts);
    fit_peaks(&sections, 2 * reach + 1, parts, found);
    for (int i = 0; i < TOGETHER; i++) peak[i] = (Peak){found[0][i], found[1][i], found[2][i]};
}

enum { CURVE_POINTS = 64, WINDOW = 64, RUN = 5 };

/* Columns beyond the face in which no light is expected, before the stripe on the body behind begins. */
enum { NEAR_FIRST = 2, NEAR_LAST = 9 };

/* Search for the peak of a clipped stripe: columns of the face, ratio of steps, largest peak in saturation values, least
   growth of what is visible by a step. */
enum { PEAK_COLUMNS = 24 };
#define PEAK_STEP 1.25
#define MAX_PEAK 4
#define MIN_GROWTH 1.02

/* Range of the ambient light across a section, in amplitudes of the stripe, from which its subtraction may leave texture:
   a tenth of it remains where the target has moved by a tenth of a pixel. */
#define MIN_CONTRAST 0.3

/* Ambient light, in amplitudes of the stripe, below which light beside the stripe is that of lasers. */
#define MAX_AMBIENT 0.1

/* Difference of both sides, in the same unit, above which the brighter one shows another stripe. */
#define MIN_SIDE_CONTRAST 0.05

/* Mean over lower quartile of the residual variances of sections with normal noise. */
#define LOW_TO_MEAN 1.4

/* numpy.interp on ascending x. */
static double interpolated(double at, const double *x, const double *y, ptrdiff_t n) {
    if (at <= x[0]) return y[0];
    if (at >= x[n - 1]) return y[n - 1];
    ptrdiff_t low = 0, high = n - 1;
    while (high - low > 1) {
        ptrdiff_t middle = (low + high) / 2;
        if (x[middle] <= at)
            low = middle;
        else
            high = middle;
    }
    return y[low] + (y[high] - y[low]) / (x[high] - x[low]) * (at - x[low]);
}

void free_profile(Profile *profile) {
    free(profile->y);
    free(profile->saturated);
}

/* The line in the image as taken. 1, or 0 if the face has fewer than two columns, or -1 without memory. */
static int distort_line(const StripeLine *line, const Lens *lens, const EndParams *params, ptrdiff_t width,
                    Profile *profile) {
    double straight[CURVE_POINTS], x[CURVE_POINTS], y[CURVE_POINTS];
    double from = line->x_start - params->beyond_columns, to = line->x_end + params->beyond_columns;
    for (int i = 0; i < CURVE_POINTS; i++) {
        straight[i] = from + (to - from) * i / (CURVE_POINTS - 1);
        x[i] = straight[i];
        y[i] = line->middle_y + line->slope * (straight[i] - line->middle_x);
        distort_pixel(lens, &x[i], &y[i]);
        if (!isfinite(x[i]) || !isfinite(y[i]) || (i > 0 && !(x[i] > x[i - 1]))) return 0;
    }
    double first = fmax(ceil(x[0]), 0), last = fmin(floor(x[CURVE_POINTS - 1]), (double)(width - 1));
    if (!(last >= first)) return 0;
    double start = interpolated(line->x_start, straight, x, CURVE_POINTS) - 0.5;
    double end = interpolated(line->x_end, straight, x, CURVE_POINTS) + 0.5;
    profile->first = (ptrdiff_t)first;
    profile->count = (ptrdiff_t)(last - first) + 1;
    ptrdiff_t n = profile->count;
    profile->y = malloc((6 + LIGHT_LEVELS) * (size_t)n * sizeof(double));
    profile->saturated = malloc((size_t)n);
    if (!profile->y || !profile->saturated) return -1;
    profile->amplitude = profile->y + n;
    profile->residual_variance = profile->y + 2 * n;
    profile->texture = profile->y + 3 * n;
    profile->scratch = profile->y + 4 * n;
    profile->ambient = profile->y + 5 * n;
    for (int k = 0; k < LIGHT_LEVELS; k++) profile->headroom[k] = profile->y + (6 + k) * n;
    profile->face_first = n;
    profile->face_last = -1;
    for (ptrdiff_t i = 0; i < n; i++) {
        double column = first + (double)i;
        profile->y[i] = interpolated(column, x, y, CURVE_POINTS);
        if (column > start && column < end) {
            if (profile->face_first == n) profile->face_first = i;
            profile->face_last = i;
        }
    }
    return profile->face_last > profile->face_first;
}

/* Distance from the line up to which the stripe is saturated in `1 - flanks_share` of the columns; -1 if it is not. */
static double saturated_half_width(double *half_width, size_t face, double sigma, const EndParams *params) {
    double widest = kth(half_width, face, (size_t)((1 - params->flanks_share) * (double)(face - 1)));
    return widest > 0 ? fmin(widest + 0.5, params->flank_sigmas * sigma - 1) : -1;
}

/* Marks a column with a saturated pixel; returns the largest distance from the line at which the stripe is saturated. */
static double mark_saturation(Profile *profile, ptrdiff_t i, const Section *section, const EndParams *params) {
    double widest = 0;
    profile->saturated[i] = 0;
    for (int k = 0; k < section->rows; k++)
        if (section->bright[k] >= params->saturation) {
            profile->saturated[i] = 1;
            if (section->ambient[k] < params->saturation / 2) widest = fmax(widest, section->offset[k]);
        }
    return widest;
}

double low_residual_variance(double *variance, size_t n) { return LOW_TO_MEAN * kth(variance, n, (n - 1) / 4); }

/* Residual variance beyond the ends of the face, where the stripe is dark: the smaller of both sides. */
static double unlit_residual_variance(Profile *profile) {
    double minimum = INFINITY;
    ptrdiff_t first[2] = {profile->face_first - NEAR_LAST, profile->face_last + NEAR_FIRST};
    for (int side = 0; side < 2; side++) {
        size_t found = 0;
        for (ptrdiff_t i = first[side]; i <= first[side] + NEAR_LAST - NEAR_FIRST; i++)
            if (i >= 0 && i < profile->count) profile->scratch[found++] = profile->residual_variance[i];
        if (found > (NEAR_LAST - NEAR_FIRST) / 2)
            minimum = fmin(minimum, low_residual_variance(profile->scratch, found));
    }
    if (isfinite(minimum)) return minimum;
    size_t n = (size_t)profile->count;
    memcpy(profile->scratch, profile->residual_variance, n * sizeof(double));
    return low_residual_variance(profile->scratch, n);
}

/* Variance of the amplitudes due to background texture: the residual variance beyond twice that of noise and of the
   stripe itself (median over the face); beyond four times that it counts as certain and enters `background`. Where the
   background was subtracted and is faint, the residuals are those of speckle and of stripes beside the line. */
static void fill_texture(Profile *profile, double expected, const EndParams *params) {
    size_t n = (size_t)profile->count, face = (size_t)(profile->face_last - profile->face_first + 1);
    double white = unlit_residual_variance(profile), factor = params->texture_factor * params->texture_factor;
    double background = 0;
    for (size_t k = 0; k < face; k++) {
        size_t i = (size_t)profile->face_first + k;
        double peak = fmax(profile->amplitude[i], 1);
        profile->scratch[k] = fmax(profile->residual_variance[i] - white, 0) / (peak * peak);
    }
    double share = median(profile->scratch, face);
    for (size_t i = 0; i < n; i++) {
        double peak = fabs(profile->amplitude[i]), own = share * peak * fmax(peak, expected);
        profile->texture[i] = factor * fmax(profile->residual_variance[i] - 2 * (white + own), 0);
        if (profile->ambient[i] < MIN_CONTRAST * expected) profile->texture[i] = 0;
        if ((ptrdiff_t)i >= profile->face_first && (ptrdiff_t)i <= profile->face_last)
            background += fmax(profile->texture[i] - 2 * factor * own, 0);
    }
    profile->background = background / ((double)face * expected * expected);
}

/* Amplitude that a fit finds of a stripe with this peak, where saturation clips it. */
static double visible_peak(const Section *section, double peak, const Parts *parts, const EndParams *params) {
    double shown[MAX_ROWS];
    for (int k = 0; k < section->rows; k++)
        shown[k] = fmin(peak * section->shape[k], fmax(params->saturation - section->ambient[k], 0));
    return fitted_peak(section, shown, parts).value;
}

/* Peak of which clipping leaves the observed amplitude: in the median of some columns of the face. */
static double unclipped_peak(const Images *images, const Profile *profile, int reach, const Parts *parts,
                             double observed, const EndParams *params) {
    double shown[PEAK_COLUMNS], before = 0;
    const ptrdiff_t face = profile->face_last - profile->face_first + 1;
    const ptrdiff_t some = face < PEAK_COLUMNS ? face : PEAK_COLUMNS;
    for (double peak = observed; peak < MAX_PEAK * params->saturation; peak *= PEAK_STEP) {
        for (ptrdiff_t k = 0; k < some; k++) {
            Section section;
            const ptrdiff_t i = profile->face_first + k * face / some;
            read_section(images, profile->y[i], profile->first + i, reach, &section);
            shape_section(images, profile->y[i], profile->sigma, reach, &section);
            shown[k] = visible_peak(&section, peak, parts, params);
        }
        const double here = median(shown, (size_t)some);
        if (here >= observed)
            return before > 0 ? peak * pow(PEAK_STEP, (observed - here) / (here - before)) : peak;
        if (before > 0 && here < MIN_GROWTH * before) return peak; /* what is visible hardly depends on the peak */
        before = here;
    }
    return MAX_PEAK * params->saturation;
}

/* Headroom of each column for a stripe of the expected amplitude. */
static void fill_room(const Images *images, Profile *profile, int reach, const Parts *parts, double expected,
                      const EndParams *params) {
    static const double lit[LIGHT_LEVELS] = {0.1, 0.5, 1};
    Section section;
    profile->clipped = 1;
    for (ptrdiff_t i = 0; i < profile->count; i++) {
        read_section(images, profile->y[i], profile->first + i, reach, &section);
        shape_section(images, profile->y[i], profile->sigma, reach, &section);
        for (int r = 0; r < LIGHT_LEVELS; r++)
            profile->headroom[r][i] = visible_peak(&section, lit[r] * expected, parts, params) / (lit[r] * expected);
    }
}

/* Amplitudes of one or TOGETHER columns from the i-th on; returns how many. */
static ptrdiff_t next_peaks(const Images *images, const Profile *profile, ptrdiff_t i, int reach, const Parts *parts,
                            Peak peak[TOGETHER]) {
    const double *y = profile->y + i;
    if (profile->count - i >= TOGETHER && sections_inside(images, y, reach)) {
        fitted_peaks(images, y, profile->first + i, profile->sigma, reach, parts, peak);
        return TOGETHER;
    }
    Section section;
    read_section(images, *y, profile->first + i, reach, &section);
    shape_section(images, *y, profile->sigma, reach, &section);
    for (int k = 0; images->dark && k < section.rows; k++) section.bright[k] -= section.ambient[k];
    *peak = fitted_peak(&section, section.bright, parts);
    return 1;
}

/* Amplitude and residual variance of every column; the gain is that of the first one. Returns the amplitude on the face
   (median). */
static double fill_peaks(const Images *images, Profile *profile, int reach, const Parts *parts) {
    Peak peak[TOGETHER];
    for (ptrdiff_t i = 0, found; i < profile->count; i += found) {
        found = next_peaks(images, profile, i, reach, parts, peak);
        if (i == 0) profile->gain = peak[0].gain;
        for (ptrdiff_t k = 0; k < found; k++) {
            profile->amplitude[i + k] = peak[k].value;
            profile->residual_variance[i + k] = peak[k].residual_variance;
        }
    }
    size_t face = (size_t)(profile->face_last - profile->face_first + 1);
    memcpy(profile->scratch, profile->amplitude + profile->face_first, face * sizeof(double));
    return fmax(median(profile->scratch, face), 1);
}

/* Marks saturation in a column; returns its brightest ambient light. */
static double scan_column(const Images *images, Profile *profile, ptrdiff_t i, int reach, const EndParams *params) {
    double maximum = 0, middle = rint(profile->y[i]), brightest = 0;
    ptrdiff_t column = profile->first + i, row = (ptrdiff_t)middle - reach;
    for (int k = 0; k < LIGHT_LEVELS; k++) profile->headroom[k][i] = 1;
    profile->scratch[i] = profile->saturated[i] = 0;
    if (!images->dark && middle >= reach && middle + reach < (double)images->height) {
        for (int k = 0; k <= 2 * reach; k++) {
            double here = pixel(images, images->lit, row + k, column);
            maximum = here > maximum ? here : maximum;
        }
        double start = pixel(images, images->lit, row, column), end = pixel(images, images->lit, row + 2 * reach, column);
        profile->ambient[i] = INFINITY;
        if (maximum < params->saturation) return fmin(start, end);
    }
    Section section;
    read_section(images, profile->y[i], column, reach, &section);
    profile->scratch[i] = mark_saturation(profile, i, &section, params);
    double darkest = INFINITY;
    for (int k = 0; k < section.rows; k++) {
        brightest = fmax(brightest, section.ambient[k]);
        darkest = fmin(darkest, section.ambient[k]);
    }
    profile->ambient[i] = images->dark ? brightest - darkest : INFINITY;
    return brightest;
}

/* Amplitude, headroom and texture of every column. */
static void fill_profile(const Images *images, Profile *profile, const EndParams *params) {
    int reach = (int)ceil(params->flank_sigmas * profile->sigma) + 1;
    if (reach > MAX_REACH) reach = MAX_REACH;
    double brightest = 0;
    size_t face = (size_t)(profile->face_last - profile->face_first + 1);
    for (ptrdiff_t i = 0; i < profile->count; i++)
        brightest = fmax(brightest, scan_column(images, profile, i, reach, params));
    double inner = saturated_half_width(profile->scratch + profile->face_first, face, profile->sigma, params);
    Parts parts = {inner, images->dark ? INFINITY : fmax(2 * profile->sigma, inner + 1), INFINITY};
    double expected = fill_peaks(images, profile, reach, &parts);
    if (!images->dark && brightest < MAX_AMBIENT * expected) {
        parts.contrast = MIN_SIDE_CONTRAST * expected;
        expected = fill_peaks(images, profile, reach, &parts);
        for (ptrdiff_t i = 0; i < profile->count; i++) profile->ambient[i] = 0; /* nothing lit that has a texture */
    }
    if (expected + brightest > params->saturation) {
        expected = unclipped_peak(images, profile, reach, &parts, expected, params);
        fill_room(images, profile, reach, &parts, expected, params);
    }
    fill_texture(profile, expected, params);
}

int read_profile(const Images *images, const StripeLine *line, const Lens *lens, const EndParams *params,
                 Profile *profile) {
    int laid = distort_line(line, lens, params, images->width, profile);
    if (laid < 1) return laid;
    ptrdiff_t first = profile->face_first, face = profile->face_last - first + 1;
    profile->sigma = section_sigma(images, profile->y + first, profile->first + first, face, params->saturation);
    fill_profile(images, profile, params);
    return 1;
}

static double full_level(const Profile *profile, ptrdiff_t i, const EndParams *params) {
    return profile->amplitude[i] / fmax(profile->headroom[FULL][i], params->min_headroom);
}

ptrdiff_t last_undimmed(const Profile *profile, ptrdiff_t near, int outward, const EndParams *params) {
    double inside[WINDOW], run[RUN];
    size_t found = 0;
    for (ptrdiff_t step = 1; (double)step < params->inside_columns && found < WINDOW; step++) {
        ptrdiff_t i = near - step * outward;
        if (i < 0 || i >= profile->count) break;
        inside[found++] = full_level(profile, i, params);
    }
    double level = found ? median(inside, found) : 0;
    ptrdiff_t beyond = outward > 0 ? profile->count - 1 - near : near;
    if (!(level > 0) || beyond < RUN) return near;
    ptrdiff_t undimmed = 0;
    for (; undimmed + RUN <= beyond; undimmed++) {
        for (int k = 0; k < RUN; k++) run[k] = full_level(profile, near + outward * (undimmed + 1 + k), params);
        if (!(median(run, RUN) > params->undimmed_level * level)) break;
    }
    return undimmed ? near + outward * (undimmed + RUN / 2) : near;
}
