/* The brightness of a stripe along its line, column by column. */
#include "profile.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "sections.h"
#include "select.h"

enum { CURVE_POINTS = 64, WINDOW = 64, RUN = 5 };

/* Columns beyond the face in which it is dark, before the stripe on the body behind begins. */
enum { NEAR_FIRST = 2, NEAR_LAST = 9 };

/* Mean of squares of normal residuals in a section over the lower quartile of some. */
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

double line_y(const Profile *profile, double x) {
    double at = x - (double)profile->first;
    if (at <= 0) return profile->y[0];
    if (at >= (double)(profile->count - 1)) return profile->y[profile->count - 1];
    ptrdiff_t low = (ptrdiff_t)at;
    return profile->y[low] + (profile->y[low + 1] - profile->y[low]) * (at - (double)low);
}

void free_profile(Profile *profile) {
    free(profile->y);
    free(profile->saturated);
}

/* The line in the image as taken. 1, or 0 if the face has fewer than two columns, or -1 without memory. */
static int lay_line(const StripeLine *line, const Lens *lens, const EndRules *rules, ptrdiff_t width,
                    Profile *profile) {
    double straight[CURVE_POINTS], x[CURVE_POINTS], y[CURVE_POINTS];
    double from = line->x_start - rules->beyond_columns, to = line->x_end + rules->beyond_columns;
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
    profile->y = malloc((5 + ROOMS) * (size_t)n * sizeof(double));
    profile->saturated = malloc((size_t)n);
    if (!profile->y || !profile->saturated) return -1;
    profile->amplitude = profile->y + n;
    profile->rough = profile->y + 2 * n;
    profile->texture = profile->y + 3 * n;
    profile->scratch = profile->y + 4 * n;
    for (int k = 0; k < ROOMS; k++) profile->room[k] = profile->y + (5 + k) * n;
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

/* Distance from the line up to which the stripe is saturated in most columns, whose own distances are given; -1 if it
   hardly is. */
static double clipped_to(double *half_width, size_t face, double sigma, const EndRules *rules) {
    double widest = kth(half_width, face, (size_t)((1 - rules->flanks_share) * (double)(face - 1)));
    return widest > 0 ? fmin(widest + 0.5, rules->flank_sigmas * sigma - 1) : -1;
}

/* Whether a column has a saturated pixel, and how far from the line the stripe itself is saturated. */
static double note_saturation(Profile *profile, ptrdiff_t i, const Section *section, const EndRules *rules) {
    double widest = 0;
    profile->saturated[i] = 0;
    for (int k = 0; k < section->rows; k++)
        if (section->bright[k] >= rules->saturation) {
            profile->saturated[i] = 1;
            if (section->ambient[k] < rules->saturation / 2) widest = fmax(widest, section->offset[k]);
        }
    return widest;
}

double low_roughness(double *rough, size_t n) { return LOW_TO_MEAN * kth(rough, n, (n - 1) / 4); }

/* What a section leaves unexplained beyond the ends of the face, before the body's stripe begins: the side on which it
   is less. */
static double unlit_roughness(Profile *profile) {
    double least = INFINITY;
    ptrdiff_t first[2] = {profile->face_first - NEAR_LAST, profile->face_last + NEAR_FIRST};
    for (int side = 0; side < 2; side++) {
        size_t found = 0;
        for (ptrdiff_t i = first[side]; i <= first[side] + NEAR_LAST - NEAR_FIRST; i++)
            if (i >= 0 && i < profile->count) profile->scratch[found++] = profile->rough[i];
        if (found > (NEAR_LAST - NEAR_FIRST) / 2) least = fmin(least, low_roughness(profile->scratch, found));
    }
    if (isfinite(least)) return least;
    size_t n = (size_t)profile->count;
    memcpy(profile->scratch, profile->rough, n * sizeof(double));
    return low_roughness(profile->scratch, n);
}

/* Variance of the peaks by what a section leaves unexplained beyond noise, and beyond its share on the face: what
   leaves twice as much is not the stripe's own, it lies beneath, and surely so four times the usual. */
static void fill_texture(Profile *profile, double expected, const EndRules *rules) {
    size_t n = (size_t)profile->count, face = (size_t)(profile->face_last - profile->face_first + 1);
    double white = unlit_roughness(profile), factor = rules->texture_factor * rules->texture_factor, beneath = 0;
    for (size_t k = 0; k < face; k++) {
        size_t i = (size_t)profile->face_first + k;
        double peak = fmax(profile->amplitude[i], 1);
        profile->scratch[k] = fmax(profile->rough[i] - white, 0) / (peak * peak);
    }
    double share = median(profile->scratch, face);
    for (size_t i = 0; i < n; i++) {
        double peak = fabs(profile->amplitude[i]), own = share * peak * fmax(peak, expected);
        profile->texture[i] = factor * fmax(profile->rough[i] - 2 * (white + own), 0);
        if ((ptrdiff_t)i >= profile->face_first && (ptrdiff_t)i <= profile->face_last)
            beneath += fmax(profile->texture[i] - 2 * factor * own, 0);
    }
    profile->beneath = beneath / ((double)face * expected * expected);
}

/* The room that saturation leaves a stripe of the expected peak, by column. */
static void fill_room(const Images *images, Profile *profile, int reach, const Parts *parts, double expected,
                      const EndRules *rules) {
    static const double lit[ROOMS] = {0.1, 0.5, 1};
    Section section;
    double shown[MOST_ROWS];
    profile->clipped = 1;
    for (ptrdiff_t i = 0; i < profile->count; i++) {
        read_section(images, profile->y[i], profile->first + i, reach, &section);
        shape_section(images, profile->y[i], profile->sigma, reach, &section);
        for (int r = 0; r < ROOMS; r++) {
            double peak = lit[r] * expected;
            for (int k = 0; k < section.rows; k++)
                shown[k] = fmin(peak * section.shape[k], fmax(rules->saturation - section.ambient[k], 0));
            profile->room[r][i] = fitted_peak(&section, shown, parts).value / peak;
        }
    }
}

/* Peaks of some columns from the i-th on; returns how many. */
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

/* Peak and what its section leaves unexplained in every column; the gain is the first one's. */
static void fill_peaks(const Images *images, Profile *profile, int reach, const Parts *parts) {
    Peak peak[TOGETHER];
    for (ptrdiff_t i = 0, found; i < profile->count; i += found) {
        found = next_peaks(images, profile, i, reach, parts, peak);
        if (i == 0) profile->gain = peak[0].gain;
        for (ptrdiff_t k = 0; k < found; k++) {
            profile->amplitude[i + k] = peak[k].value;
            profile->rough[i + k] = peak[k].rough;
        }
    }
}

/* Notes saturation in a column; returns its brightest ambient light. */
static double note_column(const Images *images, Profile *profile, ptrdiff_t i, int reach, const EndRules *rules) {
    double most = 0, middle = rint(profile->y[i]), brightest = 0;
    ptrdiff_t column = profile->first + i, row = (ptrdiff_t)middle - reach;
    for (int k = 0; k < ROOMS; k++) profile->room[k][i] = 1;
    profile->scratch[i] = profile->saturated[i] = 0;
    if (!images->dark && middle >= reach && middle + reach < (double)images->height) {
        for (int k = 0; k <= 2 * reach; k++) {
            double here = pixel(images, images->lit, row + k, column);
            most = here > most ? here : most;
        }
        double end = pixel(images, images->lit, row + 2 * reach, column);
        if (most < rules->saturation) return fmin(pixel(images, images->lit, row, column), end);
    }
    Section section;
    read_section(images, profile->y[i], column, reach, &section);
    profile->scratch[i] = note_saturation(profile, i, &section, rules);
    for (int k = 0; k < section.rows; k++) brightest = fmax(brightest, section.ambient[k]);
    return brightest;
}

/* Brightness of the stripe in every column, and what room saturation leaves it. */
static void fill_profile(const Images *images, Profile *profile, const EndRules *rules) {
    int reach = (int)ceil(rules->flank_sigmas * profile->sigma) + 1;
    if (reach > MOST_REACH) reach = MOST_REACH;
    double brightest = 0;
    size_t face = (size_t)(profile->face_last - profile->face_first + 1);
    for (ptrdiff_t i = 0; i < profile->count; i++)
        brightest = fmax(brightest, note_column(images, profile, i, reach, rules));
    double inner = clipped_to(profile->scratch + profile->face_first, face, profile->sigma, rules);
    Parts parts = {inner, images->dark ? INFINITY : fmax(2 * profile->sigma, inner + 1)};
    fill_peaks(images, profile, reach, &parts);
    memcpy(profile->scratch, profile->amplitude + profile->face_first, face * sizeof(double));
    double expected = fmax(median(profile->scratch, face), 1);
    if (expected + brightest > rules->saturation) fill_room(images, profile, reach, &parts, expected, rules);
    fill_texture(profile, expected, rules);
}

int read_profile(const Images *images, const StripeLine *line, const Lens *lens, const EndRules *rules,
                 Profile *profile) {
    int laid = lay_line(line, lens, rules, images->width, profile);
    if (laid < 1) return laid;
    ptrdiff_t first = profile->face_first, face = profile->face_last - first + 1;
    profile->sigma = section_sigma(images, profile->y + first, profile->first + first, face, rules->saturation);
    fill_profile(images, profile, rules);
    return 1;
}

static double full_level(const Profile *profile, ptrdiff_t i, const EndRules *rules) {
    return profile->amplitude[i] / fmax(profile->room[FULL][i], rules->least_headroom);
}

ptrdiff_t reached(const Profile *profile, ptrdiff_t near, int outward, const EndRules *rules) {
    double inside[WINDOW], run[RUN];
    size_t found = 0;
    for (ptrdiff_t step = 1; (double)step < rules->inside_columns && found < WINDOW; step++) {
        ptrdiff_t i = near - step * outward;
        if (i < 0 || i >= profile->count) break;
        inside[found++] = full_level(profile, i, rules);
    }
    double level = found ? median(inside, found) : 0;
    ptrdiff_t beyond = outward > 0 ? profile->count - 1 - near : near;
    if (!(level > 0) || beyond < RUN) return near;
    ptrdiff_t undimmed = 0;
    for (; undimmed + RUN <= beyond; undimmed++) {
        for (int k = 0; k < RUN; k++) run[k] = full_level(profile, near + outward * (undimmed + 1 + k), rules);
        if (!(median(run, RUN) > rules->undimmed_level * level)) break;
    }
    return undimmed ? near + outward * (undimmed + RUN / 2) : near;
}
