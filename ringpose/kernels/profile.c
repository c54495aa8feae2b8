/* The brightness of a stripe along its line, column by column. Twin: reference_profile.py. */
#include "profile.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "sections.h"
#include "select.h"

enum { CURVE_POINTS = 64, WINDOW = 64, RUN = 5 };

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
    profile->y = malloc(5 * (size_t)n * sizeof(double));
    profile->saturated = malloc((size_t)n);
    if (!profile->y || !profile->saturated) return -1;
    profile->amplitude = profile->y + n;
    profile->headroom = profile->y + 2 * n;
    profile->texture = profile->y + 3 * n;
    profile->scratch = profile->y + 4 * n;
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

/* Variance of the peaks by what a section leaves unexplained beyond noise, and beyond its share on the face; what it
   leaves comes in `texture`. What leaves four times the usual is none of the stripe's own grains: it lies beneath. */
static void fill_texture(Profile *profile, double gain, double expected, const EndRules *rules) {
    size_t n = (size_t)profile->count, face = (size_t)(profile->face_last - profile->face_first + 1);
    memcpy(profile->scratch, profile->texture, n * sizeof(double));
    double white = kth(profile->scratch, n, (n - 1) / 4);
    for (size_t k = 0; k < face; k++) {
        double peak = fmax(profile->amplitude[(size_t)profile->face_first + k], 1);
        double rough = profile->texture[(size_t)profile->face_first + k];
        profile->scratch[k] = fmax(rough - white, 0) / (peak * peak);
    }
    double share = median(profile->scratch, face), factor = rules->texture_factor * rules->texture_factor;
    for (size_t i = 0; i < n; i++) {
        double peak = profile->amplitude[i];
        profile->texture[i] = factor * fmax(profile->texture[i] - 2 * (white + share * peak * peak), 0);
    }
    profile->beneath = 0;
    for (size_t k = 0; k < face; k++) {
        double peak = profile->amplitude[(size_t)profile->face_first + k];
        double own = 2 * factor * share * peak * peak;
        profile->beneath += fmax(profile->texture[(size_t)profile->face_first + k] - own, 0);
    }
    profile->beneath /= (double)face * expected * expected;
    profile->noise = sqrt(white * gain);
}

/* The room that saturation leaves a stripe of the expected peak, by column. */
static void fill_headroom(const Images *images, Profile *profile, int reach, const Parts *parts, double expected,
                          const EndRules *rules) {
    Section section;
    double room[MOST_ROWS];
    for (ptrdiff_t i = 0; i < profile->count; i++) {
        read_section(images, profile->y[i], profile->first + i, reach, &section);
        shape_section(images, profile->y[i], profile->sigma, reach, &section);
        for (int k = 0; k < section.rows; k++)
            room[k] = fmin(expected * section.shape[k], fmax(rules->saturation - section.ambient[k], 0));
        profile->headroom[i] = fitted_peak(&section, room, parts).value / expected;
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

/* Peak and what its section leaves unexplained in every column; returns the first one's gain. */
static double fill_peaks(const Images *images, Profile *profile, int reach, const Parts *parts) {
    double gain = 0;
    Peak peak[TOGETHER];
    for (ptrdiff_t i = 0, found; i < profile->count; i += found) {
        found = next_peaks(images, profile, i, reach, parts, peak);
        if (i == 0) gain = peak[0].gain;
        for (ptrdiff_t k = 0; k < found; k++) {
            profile->amplitude[i + k] = peak[k].value;
            profile->texture[i + k] = peak[k].rough;
        }
    }
    return gain;
}

/* Notes saturation in a column; returns its brightest ambient light. */
static double note_column(const Images *images, Profile *profile, ptrdiff_t i, int reach, const EndRules *rules) {
    double most = 0, middle = rint(profile->y[i]), brightest = 0;
    ptrdiff_t column = profile->first + i, row = (ptrdiff_t)middle - reach;
    profile->headroom[i] = 1;
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
    double gain = fill_peaks(images, profile, reach, &parts);
    memcpy(profile->scratch, profile->amplitude + profile->face_first, face * sizeof(double));
    double expected = fmax(median(profile->scratch, face), 1);
    if (expected + brightest > rules->saturation) fill_headroom(images, profile, reach, &parts, expected, rules);
    fill_texture(profile, gain, expected, rules);
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
    return profile->amplitude[i] / fmax(profile->headroom[i], rules->least_headroom);
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
