/* The intensity profile of a stripe along its line: the amplitude of a Gaussian cross-section in every column, and the
   share of it that saturation leaves visible (headroom). */
#include "profile.h"
#include "kernels.h"
#include "median.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_REACH = 14, MAX_ROWS = 2 * MAX_REACH + 1 };

/* Rows of a section that are used: those beyond `inner` from the line; those beyond `flank` give the background level,
   those of a side that is brighter than the other by more than `contrast` excepted. */
typedef struct {
    double inner, flank, contrast;
} Parts;

/* Offset of a row that is not used. */
#define UNUSED (-1.0)

/* A pixel of either image. */
static inline double pixel(const Images *images, const void *data, ptrdiff_t row, ptrdiff_t column) {
    ptrdiff_t at = row * images->width + column;
    return images->wide ? (double)((const uint16_t *)data)[at] : (double)((const uint8_t *)data)[at];
}

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

/* Columns that are fitted together, in GNU C vectors. */
enum { TOGETHER = 4 };
typedef double Doubles __attribute__((vector_size(8 * TOGETHER), aligned(8), may_alias));
typedef int64_t Masks __attribute__((vector_size(8 * TOGETHER), aligned(8), may_alias));

/* The rows of some columns about the stripe's line: distance from it, light of the lasers, and what a stripe with a
   peak of 1 would show. */
typedef struct {
    Doubles offset[MAX_ROWS], value[MAX_ROWS], shape[MAX_ROWS];
} Sections;

/* Amplitudes, residual variances, and variances of the amplitudes over that of a pixel. */
typedef struct {
    Doubles value, residual_variance, gain;
} Peaks;

/* First row of a column's section. Of a line far outside the image none lies in it. */
static inline ptrdiff_t top_row(const Images *images, double y, int reach) {
    return (ptrdiff_t)fmin(fmax(rint(y), -reach - 1), (double)(images->height + reach)) - reach;
}

/* At the border the outermost rows are repeated. */
static inline ptrdiff_t inside(const Images *images, ptrdiff_t row) {
    return row < 0 ? 0 : row < images->height ? row : images->height - 1;
}

/* Sections of the columns of the profile with those indices, up to `reach` from the line. */
static inline void load_sections(const Images *images, const Profile *profile, const ptrdiff_t index[TOGETHER],
                                 int reach, Sections *sections) {
    double per_variance = 1 / (profile->sigma * profile->sigma), fall = exp(-0.5 * per_variance), square = fall * fall;
    Doubles here, ratio;
    for (int i = 0; i < TOGETHER; i++) {
        double *value = (double *)sections->value + i, *offset = (double *)sections->offset + i;
        double y = profile->y[index[i]], off = y - rint(y);
        ptrdiff_t top = top_row(images, y, reach), column = profile->first + index[i];
        here[i] = exp(-0.5 * off * off * per_variance);
        ratio[i] = exp(off * per_variance);
        for (int k = 0; k <= 2 * reach; k++) {
            ptrdiff_t row = inside(images, top + k);
            value[TOGETHER * k] = pixel(images, images->lit, row, column);
            offset[TOGETHER * k] = fabs((double)row - y);
            if (images->dark) value[TOGETHER * k] -= pixel(images, images->dark, row, column);
        }
    }
    Doubles below = here - here + 1, above = below, down = fall * ratio, up = fall * (1 / ratio);
    for (int k = 0; k <= reach; k++) {
        sections->shape[reach + k] = here * below;
        sections->shape[reach - k] = here * above;
        below *= down;
        above *= up;
        down *= square;
        up *= square;
    }
    for (int i = 0; i < TOGETHER; i++) { /* rows that are repeated */
        ptrdiff_t top = top_row(images, profile->y[index[i]], reach);
        if (top >= 0 && top + 2 * reach < images->height) continue;
        for (int k = 0; k <= 2 * reach; k++)
            if (inside(images, top + k) != top + k)
                sections->shape[k][i] = exp(-0.5 * sections->offset[k][i] * sections->offset[k][i] * per_variance);
    }
}

/* A vector where a mask is set, else 0. */
#define WHERE(mask, vector) ((Doubles)((Masks)(vector) & (mask)))

/* Leaves out the rows of a brighter side, where a stripe on the body lies a few rows beside the line. */
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

/* Peaks of the Gaussian sections on the level of the rows beside them. */
static inline void fit_peaks(const Sections *sections, int rows, const Parts *parts, Peaks *peaks) {
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
    peaks->value = sum / norm;
    peaks->gain = (squares + WHERE(any, weights * weights / count)) / (norm * norm);
    for (int k = 0; k < rows; k++) {
        Masks here = sections->offset[k] > parts->inner;
        Doubles residual = sections->value[k] - level - peaks->value * (sections->shape[k] - under);
        residuals += WHERE(here, residual * residual);
        used += WHERE(here, one);
    }
    Masks many = used > 3;
    peaks->residual_variance = residuals / (WHERE(many, used - 2) + WHERE(~many, one));
}

/* Peaks in what the lasers add to columns of the profile. */
VECTOR_LOOP
static void fit_lit_peaks(const Images *images, const Profile *profile, const ptrdiff_t index[TOGETHER], int reach,
                          const Parts *parts, Peaks *peaks) {
    Sections sections;
    load_sections(images, profile, index, reach, &sections);
    if (isfinite(parts->contrast)) leave_out_brighter_sides(&sections, 2 * reach + 1, parts);
    fit_peaks(&sections, 2 * reach + 1, parts, peaks);
}

/* Light beside the stripe: in the image without lasers, or of the darker end of the section. */
static inline double ambient_at(const Images *images, ptrdiff_t top, int reach, int k, ptrdiff_t column) {
    if (images->dark) return pixel(images, images->dark, inside(images, top + k), column);
    return fmin(pixel(images, images->lit, inside(images, top), column),
                pixel(images, images->lit, inside(images, top + 2 * reach), column));
}

/* Amplitudes that a fit finds of stripes with some peaks, where saturation clips them. */
VECTOR_LOOP
static void fit_clipped_peaks(const Images *images, const Profile *profile, const ptrdiff_t index[TOGETHER], int reach,
                              const Parts *parts, double saturation, const double *peak, int count, Doubles *shown) {
    Sections sections;
    Doubles room[MAX_ROWS];
    Peaks peaks;
    load_sections(images, profile, index, reach, &sections);
    for (int i = 0; i < TOGETHER; i++) {
        ptrdiff_t top = top_row(images, profile->y[index[i]], reach);
        for (int k = 0; k <= 2 * reach; k++)
            room[k][i] = fmax(saturation - ambient_at(images, top, reach, k, profile->first + index[i]), 0);
    }
    for (int n = 0; n < count; n++) {
        for (int k = 0; k <= 2 * reach; k++) {
            Doubles light = peak[n] * sections.shape[k];
            Masks below = light < room[k];
            sections.value[k] = WHERE(below, light) + WHERE(~below, room[k]);
        }
        fit_peaks(&sections, 2 * reach + 1, parts, &peaks);
        shown[n] = peaks.value;
    }
}

enum { CURVE_POINTS = 64, WINDOW = 64, RUN = 5 };

/* Columns beyond the face in which no light is expected, before the stripe on the body behind begins. */
enum { NEAR_FIRST = 2, NEAR_LAST = 9 };

/* Search for the peak of a clipped stripe: columns of the face, ratio of steps, largest peak in saturation values,
   least growth of what is visible by a step. */
enum { PEAK_COLUMNS = 24 };
#define PEAK_STEP 1.25
#define MAX_PEAK 4
#define MIN_GROWTH 1.02

/* Range of the ambient light across a section, in amplitudes of the stripe, from which its subtraction may leave
   texture: a tenth of it remains where the target has moved by a tenth of a pixel. */
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

/* The line in the distorted image. Returns 1, 0 if the face has fewer than two columns, or -1 without memory. */
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

/* Peak of a stripe that has the observed amplitude after clipping: median over some columns of the face. */
static double unclipped_peak(const Images *images, const Profile *profile, int reach, const Parts *parts,
                             double observed, const EndParams *params) {
    double shown[PEAK_COLUMNS], before = 0;
    const ptrdiff_t face = profile->face_last - profile->face_first + 1;
    const ptrdiff_t some = face < PEAK_COLUMNS ? face : PEAK_COLUMNS;
    for (double peak = observed; peak < MAX_PEAK * params->saturation_dn; peak *= PEAK_STEP) {
        for (ptrdiff_t first = 0; first < some; first += TOGETHER) {
            ptrdiff_t index[TOGETHER];
            Doubles found;
            for (ptrdiff_t k = 0; k < TOGETHER; k++)
                index[k] = profile->face_first + (first + k < some ? first + k : some - 1) * face / some;
            fit_clipped_peaks(images, profile, index, reach, parts, params->saturation_dn, &peak, 1, &found);
            for (ptrdiff_t k = 0; k < TOGETHER && first + k < some; k++) shown[first + k] = found[k];
        }
        const double here = median(shown, (size_t)some);
        if (here >= observed)
            return before > 0 ? peak * pow(PEAK_STEP, (observed - here) / (here - before)) : peak;
        if (before > 0 && here < MIN_GROWTH * before) return peak; /* what is visible hardly depends on the peak */
        before = here;
    }
    return MAX_PEAK * params->saturation_dn;
}

/* Indices of columns next to each other; beyond the last one it is repeated. */
static void neighbours(const Profile *profile, ptrdiff_t first, ptrdiff_t index[TOGETHER]) {
    for (ptrdiff_t k = 0; k < TOGETHER; k++) index[k] = first + k < profile->count ? first + k : profile->count - 1;
}

/* Headroom of each column for a stripe of the expected amplitude. */
static void fill_room(const Images *images, Profile *profile, int reach, const Parts *parts, double expected,
                      const EndParams *params) {
    const double peak[LIGHT_LEVELS] = {0.1 * expected, 0.5 * expected, expected};
    profile->clipped = 1;
    for (ptrdiff_t i = 0; i < profile->count; i += TOGETHER) {
        ptrdiff_t index[TOGETHER];
        Doubles shown[LIGHT_LEVELS];
        neighbours(profile, i, index);
        fit_clipped_peaks(images, profile, index, reach, parts, params->saturation_dn, peak, LIGHT_LEVELS, shown);
        for (int level = 0; level < LIGHT_LEVELS; level++)
            for (int k = 0; k < TOGETHER; k++) profile->headroom[level][index[k]] = shown[level][k] / peak[level];
    }
}

/* Amplitude and residual variance of every column; the gain is that of the first one. Returns the amplitude on the face
   (median). */
static double fill_peaks(const Images *images, Profile *profile, int reach, const Parts *parts) {
    for (ptrdiff_t i = 0; i < profile->count; i += TOGETHER) {
        ptrdiff_t index[TOGETHER];
        Peaks peaks;
        neighbours(profile, i, index);
        fit_lit_peaks(images, profile, index, reach, parts, &peaks);
        if (i == 0) profile->gain = peaks.gain[0];
        for (int k = 0; k < TOGETHER; k++) {
            profile->amplitude[index[k]] = peaks.value[k];
            profile->residual_variance[index[k]] = peaks.residual_variance[k];
        }
    }
    size_t face = (size_t)(profile->face_last - profile->face_first + 1);
    memcpy(profile->scratch, profile->amplitude + profile->face_first, face * sizeof(double));
    return fmax(median(profile->scratch, face), 1);
}

/* Marks saturation in a column, with its largest distance from the line in `scratch`; returns the brightest ambient
   light. */
static double scan_column(const Images *images, Profile *profile, ptrdiff_t i, int reach, const EndParams *params) {
    double y = profile->y[i], brightest = 0, darkest = INFINITY;
    ptrdiff_t column = profile->first + i, top = top_row(images, y, reach);
    for (int k = 0; k < LIGHT_LEVELS; k++) profile->headroom[k][i] = 1;
    profile->scratch[i] = profile->saturated[i] = 0;
    for (int k = 0; k <= 2 * reach; k++) {
        ptrdiff_t row = inside(images, top + k);
        double ambient = ambient_at(images, top, reach, k, column);
        brightest = ambient > brightest ? ambient : brightest;
        darkest = ambient < darkest ? ambient : darkest;
        if (pixel(images, images->lit, row, column) < params->saturation_dn) continue;
        profile->saturated[i] = 1;
        if (ambient < 0.5 * (double)params->saturation_dn) profile->scratch[i] = fmax(profile->scratch[i], fabs((double)row - y));
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
    if (expected + brightest > params->saturation_dn) {
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
    profile->sigma = section_sigma(images, profile->y + first, profile->first + first, face, params->saturation_dn);
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
