/* Where stripes end: the brightness along each line, and the edge that fits it best. Twin: reference_ends.py. */
#include "ends.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "normal_cdf.h"
#include "select.h"

enum { CURVE_POINTS = 64, SECTION_ROWS = 6, MOST_REACH = 14, WINDOW = 64, RUN = 5 };

/* Whole columns first, first + 1, ... and what the stripe looks like in them. */
typedef struct {
    ptrdiff_t first, count, face_first, face_last; /* face: indices, inclusive */
    double *y, *amplitude, *headroom, *half_width, *scratch;
    unsigned char *saturated;
} Profile;

static double pixel(const Images *images, const void *data, ptrdiff_t row, ptrdiff_t column) {
    ptrdiff_t at = row * images->width + column;
    return images->wide ? (double)((const uint16_t *)data)[at] : (double)((const uint8_t *)data)[at];
}

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

/* The y of the profile at any x. */
static double line_y(const Profile *profile, double x) {
    double at = x - (double)profile->first;
    if (at <= 0) return profile->y[0];
    if (at >= (double)(profile->count - 1)) return profile->y[profile->count - 1];
    ptrdiff_t low = (ptrdiff_t)at;
    return profile->y[low] + (profile->y[low + 1] - profile->y[low]) * (at - (double)low);
}

static void free_profile(Profile *profile) {
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
    profile->half_width = profile->y + 3 * n;
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

/* Sigma of the stripe's cross-section over all columns of the face whose section lies in the image. */
static int section_sigma(const Images *images, const Profile *profile, double *sigma) {
    ptrdiff_t face = profile->face_last - profile->face_first + 1;
    double *background = malloc((size_t)face * (2 * SECTION_ROWS + 1) * sizeof *background);
    if (!background) return 0;
    size_t found = 0, columns = 0;
    double sum = 0, moment = 0, level = 0;
    for (int pass = 0; pass < 2; pass++) { /* the background first, then what stands out of it */
        for (ptrdiff_t i = profile->face_first; i <= profile->face_last; i++) {
            ptrdiff_t row = (ptrdiff_t)rint(profile->y[i]), column = profile->first + i;
            if (row - SECTION_ROWS < 0 || row + SECTION_ROWS >= images->height) continue;
            columns++;
            for (ptrdiff_t k = -SECTION_ROWS; k <= SECTION_ROWS; k++) {
                double offset = (double)(row + k) - profile->y[i];
                int middle = fabs(offset) < SECTION_ROWS - 1.5;
                if (middle == (pass == 0)) continue;
                double value = pixel(images, images->lit, row + k, column);
                if (images->dark) value -= pixel(images, images->dark, row + k, column);
                if (pass == 0)
                    background[found++] = value;
                else if (value > level) {
                    sum += value - level;
                    moment += (value - level) * offset * offset;
                }
            }
        }
        if (pass == 0 && found) level = median(background, found);
    }
    free(background);
    *sigma = columns ? fmin(fmax(sqrt(moment / fmax(sum, 1e-9)), 0.7), 4.0) : 1.5;
    return 1;
}

static int ascending(const void *first, const void *second) {
    double a = *(const double *)first, b = *(const double *)second;
    return (a > b) - (a < b);
}

static ptrdiff_t clipped_row(ptrdiff_t row, ptrdiff_t height) {
    return row < 0 ? 0 : row >= height ? height - 1 : row;
}

/* One column's window: offsets from the line, brightness, ambient light. */
typedef struct {
    int rows;
    double offset[2 * MOST_REACH + 1], shape[2 * MOST_REACH + 1], bright[2 * MOST_REACH + 1],
        ambient[2 * MOST_REACH + 1];
} Section;

static void read_section(const Images *images, const Profile *profile, ptrdiff_t i, int reach, double sigma,
                         Section *section) {
    ptrdiff_t row = (ptrdiff_t)rint(profile->y[i]), column = profile->first + i;
    section->rows = 2 * reach + 1;
    /* The Gaussian from row to row: exp(-(o + 1)^2 / 2s^2) = exp(-o^2 / 2s^2) exp(-(2o + 1) / 2s^2). */
    double start = (double)(row - reach) - profile->y[i], square = sigma * sigma;
    double shape = exp(-0.5 * start * start / square), ratio = exp(-(2 * start + 1) / (2 * square));
    double step = exp(-1 / square);
    for (int k = 0; k < section->rows; k++) {
        ptrdiff_t at = clipped_row(row - reach + k, images->height);
        double offset = (double)at - profile->y[i];
        section->offset[k] = fabs(offset);
        section->shape[k] = at == row - reach + k ? shape : exp(-0.5 * offset * offset / square);
        shape *= ratio;
        ratio *= step;
        section->bright[k] = pixel(images, images->lit, at, column);
        if (images->dark) section->ambient[k] = pixel(images, images->dark, at, column);
    }
    double darker = fmin(section->bright[0], section->bright[section->rows - 1]);
    for (int k = 0; !images->dark && k < section->rows; k++) section->ambient[k] = darker;
}

/* Distance from the line up to which the stripe is saturated in most columns; -1 if it hardly is. */
static double clipped_to(Profile *profile, double sigma, const EndRules *rules) {
    ptrdiff_t face = profile->face_last - profile->face_first + 1;
    memcpy(profile->scratch, profile->half_width + profile->face_first, (size_t)face * sizeof(double));
    qsort(profile->scratch, (size_t)face, sizeof(double), ascending);
    double widest = profile->scratch[(ptrdiff_t)((1 - rules->flanks_share) * (double)(face - 1))];
    return widest > 0 ? fmin(widest + 0.5, rules->flank_sigmas * sigma - 1) : -1;
}

/* Whether a column has a saturated pixel, and how far from the line the stripe itself is saturated. */
static void note_saturation(Profile *profile, ptrdiff_t i, const Section *section, const EndRules *rules) {
    double widest = 0;
    profile->saturated[i] = 0;
    for (int k = 0; k < section->rows; k++)
        if (section->bright[k] >= rules->saturation) {
            profile->saturated[i] = 1;
            if (section->ambient[k] < rules->saturation / 2) widest = fmax(widest, section->offset[k]);
        }
    profile->half_width[i] = widest;
}

/* Peak of the Gaussian section that fits a column best, from the rows beyond `inner`; or, for `expected` > 0, the
   share of a stripe of that peak that saturation would leave. */
static double fitted_peak(const Section *section, double inner, double expected, double saturation) {
    double norm = 0, sum = 0;
    for (int k = 0; k < section->rows; k++) {
        if (!(section->offset[k] > inner)) continue;
        double shape = section->shape[k];
        double value = section->bright[k] - section->ambient[k];
        if (expected > 0) value = fmin(shape, fmax(saturation - section->ambient[k], 0) / expected);
        norm += shape * shape;
        sum += shape * value;
    }
    return sum / fmax(norm, 1e-9);
}

/* Brightness of the stripe in every column, and what room saturation leaves it. */
static void fill_profile(const Images *images, Profile *profile, double sigma, const EndRules *rules) {
    int reach = (int)ceil(rules->flank_sigmas * sigma) + 1;
    if (reach > MOST_REACH) reach = MOST_REACH;
    Section section;
    double brightest = 0;
    for (ptrdiff_t i = 0; i < profile->count; i++) {
        read_section(images, profile, i, reach, sigma, &section);
        note_saturation(profile, i, &section, rules);
        for (int k = 0; k < section.rows; k++) brightest = fmax(brightest, section.ambient[k]);
        profile->amplitude[i] = fitted_peak(&section, -1, 0, rules->saturation);
        profile->headroom[i] = 1;
    }
    double inner = clipped_to(profile, sigma, rules);
    for (ptrdiff_t i = 0; inner >= 0 && i < profile->count; i++) {
        read_section(images, profile, i, reach, sigma, &section);
        profile->amplitude[i] = fitted_peak(&section, inner, 0, rules->saturation);
    }
    size_t face = (size_t)(profile->face_last - profile->face_first + 1);
    memcpy(profile->scratch, profile->amplitude + profile->face_first, face * sizeof(double));
    double expected = fmax(median(profile->scratch, face), 1);
    if (expected + brightest <= rules->saturation) return; /* room everywhere */
    for (ptrdiff_t i = 0; i < profile->count; i++) {
        read_section(images, profile, i, reach, sigma, &section);
        profile->headroom[i] = fitted_peak(&section, inner, expected, rules->saturation);
    }
}

static double full_level(const Profile *profile, ptrdiff_t i, const EndRules *rules) {
    return profile->amplitude[i] / fmax(profile->headroom[i], rules->least_headroom);
}

/* The last column, as an index, to which the stripe goes on undimmed beyond index `near`. */
static ptrdiff_t reached(const Profile *profile, ptrdiff_t near, int outward, const EndRules *rules) {
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

typedef struct {
    int count;
    double along[WINDOW], amplitude[WINDOW], headroom[WINDOW];
    double level, contrast, noise;
} Columns;

/* Level, spread and noise of the columns about an end; 0 if they are too few or dark. */
static int measure_spread(Columns *columns, const EndRules *rules) {
    double full[WINDOW], beyond[WINDOW];
    size_t inner = 0, outer = 0;
    for (int i = 0; i < columns->count; i++) {
        if (columns->along[i] < -2)
            full[inner++] = columns->amplitude[i] / fmax(columns->headroom[i], rules->least_headroom);
        if (columns->along[i] > 2) beyond[outer++] = columns->amplitude[i];
    }
    columns->level = median(full, inner);
    for (size_t i = 0; i < inner; i++) full[i] = fabs(full[i] - columns->level);
    columns->contrast = fmax(1.4826 * median(full, inner) / fmax(columns->level, 1e-9), 0.01);
    double noise = 0;
    if (outer) {
        double middle = median(beyond, outer);
        for (size_t i = 0; i < outer; i++) beyond[i] = fabs(beyond[i] - middle);
        noise = 1.4826 * median(beyond, outer);
    }
    columns->noise = fmax(noise, 0.01 * columns->level);
    return columns->level > 0;
}

/* What the columns add to the equations for the two levels, and to the likelihood. */
typedef struct {
    double inside, both, outside, in_value, out_value, square, logarithm;
} Sums;

/* Sums over the columns up to each one, if all lay inside the edge, and if all lay outside. */
typedef struct {
    Sums in[WINDOW + 1], out[WINDOW + 1];
} Running;

static void add(Sums *sums, double in, double out, double value, double variance) {
    double weight = 1 / variance;
    sums->inside += in * in * weight;
    sums->both += in * out * weight;
    sums->outside += out * out * weight;
    sums->in_value += in * value * weight;
    sums->out_value += out * value * weight;
    sums->square += value * value * weight;
}

static void add_range(Sums *sums, const Sums *from, const Sums *to) {
    sums->inside += to->inside - from->inside;
    sums->outside += to->outside - from->outside;
    sums->in_value += to->in_value - from->in_value;
    sums->out_value += to->out_value - from->out_value;
    sums->square += to->square - from->square;
    sums->logarithm += to->logarithm - from->logarithm;
}

static double variance_of(const Columns *columns, double in) {
    double spread = columns->contrast * columns->level * in;
    return columns->noise * columns->noise + spread * spread;
}

static void run(const Columns *columns, Running *running) {
    memset(running, 0, sizeof *running);
    for (int i = 0; i < columns->count; i++) {
        double head = columns->headroom[i], value = columns->amplitude[i];
        running->in[i + 1] = running->in[i];
        running->out[i + 1] = running->out[i];
        add(&running->in[i + 1], head, 0, value, variance_of(columns, head));
        add(&running->out[i + 1], 0, 1, value, variance_of(columns, 0));
        running->in[i + 1].logarithm += log(variance_of(columns, head));
        running->out[i + 1].logarithm += log(variance_of(columns, 0));
    }
}

/* Minus log likelihood of an edge with its best levels, and the outside level's share of the inside. Columns ascend
   in `along`; more than four widths from the edge they lie wholly on one side. */
static double edge_cost(const Columns *columns, const Running *running, double position, double width,
                        double *outside) {
    Sums sums = {0};
    double variances = 1;
    int first = 0, last, count = columns->count;
    while (first < count && (position - columns->along[first]) / width >= 4) first++;
    add_range(&sums, &running->in[0], &running->in[first]);
    for (last = first; last < count && (position - columns->along[last]) / width > -4; last++) {
        double edge = normal_cdf((position - columns->along[last]) / width), in = edge * columns->headroom[last];
        double variance = variance_of(columns, in);
        add(&sums, in, 1 - edge, columns->amplitude[last], variance);
        variances *= variance;
        if (!(variances > 1e-150 && variances < 1e150)) {
            sums.logarithm += log(variances);
            variances = 1;
        }
    }
    add_range(&sums, &running->out[last], &running->out[count]);
    double determinant = fmax(sums.inside * sums.outside - sums.both * sums.both, 1e-30);
    double within = fmax((sums.outside * sums.in_value - sums.both * sums.out_value) / determinant, 1e-6);
    double beyond = (sums.inside * sums.out_value - sums.both * sums.in_value) / determinant;
    beyond = fmin(fmax(beyond, 0), within);
    *outside = beyond / within;
    double square = sums.square - 2 * within * sums.in_value - 2 * beyond * sums.out_value +
                    within * within * sums.inside + 2 * within * beyond * sums.both + beyond * beyond * sums.outside;
    return 0.5 * (square + sums.logarithm + log(variances));
}

/* A coarse search at one width, then all widths around what it found, then a parabola. */
static void best_edge(const Columns *columns, double sigma, double *position, double *width, double *outside) {
    static const double share[] = {0.45, 0.6, 0.8, 1.0};
    Running running;
    run(columns, &running);
    double least = INFINITY, start = 0, ignored;
    for (int k = -12; k <= 12; k++) {
        double cost = edge_cost(columns, &running, 0.5 * k, 0.8 * sigma, &ignored);
        if (cost < least) {
            least = cost;
            start = 0.5 * k;
        }
    }
    least = INFINITY;
    *position = 0;
    *width = sigma;
    *outside = 0;
    for (int s = 0; s < 4; s++) {
        double cost[15], level[15];
        int k = 0;
        for (int j = 0; j < 15; j++) {
            cost[j] = edge_cost(columns, &running, start + (j - 7) * 0.1, share[s] * sigma, &level[j]);
            if (cost[j] < cost[k]) k = j;
        }
        if (!(cost[k] < least)) continue;
        double shift = 0;
        if (k > 0 && k < 14) {
            double bend = cost[k - 1] - 2 * cost[k] + cost[k + 1];
            if (bend > 0) shift = fmin(fmax(0.5 * (cost[k - 1] - cost[k + 1]) / bend, -1), 1);
        }
        least = cost[k];
        *position = start + (k - 7 + shift) * 0.1;
        *width = share[s] * sigma;
        *outside = level[k];
    }
}

static double end_sigma(const Columns *columns, double position, double width, double outside, double saturated,
                        const EndRules *rules) {
    double information = 0, spread = columns->contrast * columns->level;
    for (int i = 0; i < columns->count; i++) {
        double t = (position - columns->along[i]) / width, head = columns->headroom[i];
        double slope = columns->level * exp(-0.5 * t * t) / (width * 2.5066282746310002) * head * (1 - outside);
        double edge = spread * head * normal_cdf(t);
        information += slope * slope / (columns->noise * columns->noise + edge * edge);
    }
    double ratio = columns->noise / columns->level;
    double speckle = sqrt(fmax(columns->contrast * columns->contrast - ratio * ratio, 0));
    double share = speckle / columns->contrast;
    information /= 1 + (rules->speckle_columns - 1) * share * share;
    if (!(information > 0)) return NAN;
    if (saturated > rules->saturated_share) speckle = fmax(speckle, rules->hidden_speckle);
    double grain = rules->grain_factor * speckle * width;
    return sqrt(1 / information + grain * grain + rules->shape_sigma * rules->shape_sigma);
}

static StripeEnd find_end(const Profile *profile, ptrdiff_t near, int outward, double sigma, const EndRules *rules) {
    StripeEnd end = {NAN, NAN, NAN, NAN, NAN, NAN, NAN, sigma};
    Columns columns = {.count = 0};
    ptrdiff_t at[WINDOW];
    int inner = 0, outer = 0;
    for (double along = 1 - rules->inside_columns; along < rules->outside_columns && columns.count < WINDOW; along++) {
        ptrdiff_t i = near + outward * (ptrdiff_t)along;
        if (i < 0 || i >= profile->count) continue;
        inner += along < -2;
        outer += along > 1;
        at[columns.count] = i;
        columns.along[columns.count] = along;
        columns.amplitude[columns.count] = profile->amplitude[i];
        columns.headroom[columns.count++] = profile->headroom[i];
    }
    if (inner < 4 || outer < 3 || !measure_spread(&columns, rules)) return end;

    double position, width, outside, last = 0, saturated = 0;
    best_edge(&columns, sigma, &position, &width, &outside);
    for (int i = 0; i < columns.count; i++)
        if (columns.along[i] > position - 6 && columns.along[i] < position) {
            last += 1;
            saturated += profile->saturated[at[i]];
        }
    saturated = last > 0 ? saturated / last : 0;
    double along_sigma = end_sigma(&columns, position, width, outside, saturated, rules);
    if (!isfinite(along_sigma)) return end;
    double x = (double)(profile->first + near) + outward * position;
    return (StripeEnd){x,       line_y(profile, x), line_y(profile, x + 0.5) - line_y(profile, x - 0.5), along_sigma,
                       outside, saturated,          width,                                               sigma};
}

int stripe_ends(const Images *images, const StripeLine *line, size_t lines, const Lens *lens, const EndRules *rules,
                StripeEnd *end) {
    for (size_t i = 0; i < lines; i++) {
        Profile profile = {0};
        double sigma = NAN;
        int laid = lay_line(&line[i], lens, rules, images->width, &profile);
        int done = laid >= 0 && (laid == 0 || section_sigma(images, &profile, &sigma));
        for (int side = 0; side < 2; side++)
            end[2 * i + (size_t)side] = (StripeEnd){NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN};
        if (done && laid) {
            fill_profile(images, &profile, sigma, rules);
            ptrdiff_t left = reached(&profile, profile.face_first, -1, rules);
            ptrdiff_t right = reached(&profile, profile.face_last, 1, rules);
            end[2 * i] = find_end(&profile, left, -1, sigma, rules);
            end[2 * i + 1] = find_end(&profile, right, 1, sigma, rules);
        }
        free_profile(&profile);
        if (!done) return 0;
    }
    return 1;
}
