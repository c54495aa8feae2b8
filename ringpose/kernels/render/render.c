/* Radiance of a lit target in the pixels of a camera, for several placements of the target during the exposure. */
#include <string.h>

#include "arguments.h"
#include "target.h"

#define PI 3.14159265358979323846

enum { LAMPS = 4, MAX_TIMES = 64, BLOCK = 64, DISC = 64 };

/* Distance from a sheet, in sigmas of its thickness, beyond which its light is neglected: 4e-5 of the peak. */
static const double MAX_SIGMAS = 4.5;

/* A stripe is thin where a pixel covers more sigmas than this; one ray per pixel shifts a wider one by < 1e-5 px. */
static const double MAX_PIXEL_SIGMAS = 1.25;

/* Objects farther than this cast no shadow; origins of shadow rays are lifted off their surface. */
static const double FAR_M = 100, LIFT_M = 1e-7;

/* Code of a pixel: surface + 1 in the upper half, then what else changes at edges; laser k has bit k. */
enum { SUN_SHADOW = 1 << 8, EARTH_SHADOW = 1 << 9, SECOND = 1 << 10, SKY_EARTH = 1 << 11, SKY_SUN = 1 << 12 };

enum { WIDE = 1, THIN = 2 };

/* Directions are unit vectors towards the light, in the camera frame. */
typedef struct {
    double ambient; /* irradiance by a laboratory, W/m2 */
    double sun, sun_x, sun_y, sun_z, sun_radius; /* irradiance across the rays, angular radius */
    double earth, earth_x, earth_y, earth_z, earth_radius;
    double lit_x, lit_y, lit_z;  /* the middle of the Earth's lit part */
    double earth_radiance;       /* where the sun is in the zenith */
    double power, sigma, divergence, fan; /* of each laser */
    double angle_per_px;
} Light;

typedef struct {
    Vector direction;
    double sharpness, share;
} Lamp;

typedef struct {
    Vector normal;
    double distance;
    Vector projector, axis;
    double on;
} Laser;

/* The light in the target frame at one time of the exposure. */
typedef struct {
    double rotation[9]; /* camera_from_target */
    Vector eye, sun, earth, lit, lamp[LAMPS];
    Vector on_sun[DISC], on_earth[DISC]; /* directions all over the discs; any neighbours in the list are far apart */
    Laser laser[MAX_LASERS];
} Stand;

/* Some of the parts. */
typedef struct {
    int count, part[MAX_PARTS];
} Choice;

typedef struct {
    Target target;
    Light light;
    Lamp lamp[LAMPS];
    Stand stand[MAX_TIMES];
    Choice all;
    int times, lasers, dark;
    double baseline; /* largest distance of a projector from the camera */
    double relief;   /* largest displacement of a hit by a relief, for rays up to 60 degrees from the normal */
} Scene;

/* What varies from sample to sample: the time, and the places on the discs of sun and Earth. */
typedef struct {
    int time, sun, earth;
} Draw;

static double fraction(double value) { return value - (double)whole(value); }

/* Directions towards places on a disc of light, by a low-discrepancy sequence. */
static void fill_disc(Vector middle, double radius, Vector place[DISC]) {
    const Vector aside = fabs(middle.x) < 0.8 ? (Vector){1, 0, 0} : (Vector){0, 1, 0};
    const Vector first = unit(cross(middle, aside)), second = cross(middle, first);
    for (int i = 0; i < DISC; i++) {
        const double r = tan(radius) * sqrt((i * 37 % DISC + 0.5) / DISC), angle = 2 * PI * fraction(0.6180339887 * i);
        place[i] = unit(plus(middle, plus(times(r * cos(angle), first), times(r * sin(angle), second))));
    }
}

static void place(Scene *scene, Stand *stand, const double pose[12], const Laser *laser) {
    const Light *light = &scene->light;
    const Vector translation = {pose[9], pose[10], pose[11]};
    memcpy(stand->rotation, pose, sizeof stand->rotation);
    stand->eye = times(-1, rotated_back(pose, translation));
    stand->sun = rotated_back(pose, (Vector){light->sun_x, light->sun_y, light->sun_z});
    stand->earth = rotated_back(pose, (Vector){light->earth_x, light->earth_y, light->earth_z});
    stand->lit = rotated_back(pose, (Vector){light->lit_x, light->lit_y, light->lit_z});
    if (light->sun > 0) fill_disc(stand->sun, light->sun_radius, stand->on_sun);
    if (light->earth > 0) fill_disc(stand->earth, light->earth_radius, stand->on_earth);
    for (int i = 0; i < LAMPS; i++) stand->lamp[i] = rotated_back(pose, scene->lamp[i].direction);
    for (int i = 0; i < scene->lasers; i++) {
        stand->laser[i].normal = rotated_back(pose, laser[i].normal);
        stand->laser[i].axis = rotated_back(pose, laser[i].axis);
        stand->laser[i].projector = rotated_back(pose, minus(laser[i].projector, translation));
        stand->laser[i].distance = laser[i].distance - dot(laser[i].normal, translation);
        stand->laser[i].on = laser[i].on;
        scene->baseline = greater(scene->baseline, sqrt(dot(laser[i].projector, laser[i].projector)));
    }
}

/* Whether one of the parts shadows the point of a hit from a light in this direction, at the distance `reach`. */
static int shadowed(const Scene *scene, const Choice *parts, const Hit *hit, Vector towards, double reach) {
    const double below = greater(0, dot(minus(hit->flat, hit->point), hit->flat_normal));
    const Vector start = plus(hit->point, times(below + LIFT_M, hit->flat_normal));
    const int own = scene->target.part[hit->part].kind == BOX ? hit->part : EMPTY;
    return blocked(&scene->target, parts->part, parts->count, own, start, times(reach, towards));
}

static double lit_by(Coating coating, const Hit *hit, Vector to_light, Vector to_eye) {
    return dot(hit->normal, to_light) * reflectance(coating, hit->normal, to_light, to_eye);
}

/* Lamps are lobes exp(k (cos - 1)) of light, which the roughness widens in reflection; the walls are uniformly grey. */
static double laboratory(const Scene *scene, const Stand *stand, Coating coating, Vector normal, Vector to_eye) {
    const double cosine = dot(normal, to_eye), n_eye = lesser(greater(cosine, 0), 1);
    const Vector mirrored = minus(times(2 * cosine, normal), to_eye);
    double matt = 1, glossy = 1;
    for (int i = 0; i < LAMPS; i++) {
        const double share = scene->lamp[i].share;
        matt += share * (greater(dot(stand->lamp[i], normal), 0) - 1);
        glossy -= share;
    }
    if (coating.specular <= 0) return coating.diffuse * matt / PI;
    for (int i = 0; i < LAMPS; i++) {
        const double k = 1 / (1 / scene->lamp[i].sharpness + coating.roughness * coating.roughness);
        glossy += scene->lamp[i].share * k / 2 * exp(k * (lesser(greater(dot(stand->lamp[i], mirrored), -1), 1) - 1));
    }
    const double rest = 1 - n_eye, rest2 = rest * rest;
    return (coating.diffuse * matt + (coating.specular + (1 - coating.specular) * rest2 * rest2 * rest) * glossy) / PI;
}

/* Parts that may shadow the hits of a block from sun and Earth. */
typedef struct {
    Choice sun, earth;
} Shades;

static double ambient_light(const Scene *scene, const Stand *stand, const Shades *shades, Coating coating,
                            const Hit *hit, Vector to_eye, const Draw *draw, uint32_t *code) {
    const Light *light = &scene->light;
    double sum = 0;
    int sunlit = 0;
    if (light->ambient > 0) sum += light->ambient * laboratory(scene, stand, coating, hit->normal, to_eye);
    if (light->sun > 0 && dot(hit->flat_normal, stand->sun) > 0) {
        const int behind = shadowed(scene, &shades->sun, hit, stand->on_sun[draw->sun], FAR_M);
        sunlit = !behind;
        if (behind) *code |= SUN_SHADOW;
        if (sunlit && dot(hit->normal, stand->sun) > 0) sum += light->sun * lit_by(coating, hit, stand->sun, to_eye);
    }
    if (light->earth > 0 && dot(hit->flat_normal, stand->lit) > 0 && dot(hit->normal, stand->lit) > 0) {
        if (shadowed(scene, &shades->earth, hit, stand->on_earth[draw->earth], FAR_M)) {
            if (!sunlit) *code |= EARTH_SHADOW;
            return sum;
        }
        Coating wide = coating; /* the Earth's disc widens reflections by its own width */
        wide.roughness = sqrt(coating.roughness * coating.roughness + light->earth_radius * light->earth_radius / 4);
        sum += light->earth * lit_by(wide, hit, stand->lit, to_eye);
    }
    return sum;
}

static double laser_light(const Scene *scene, const Laser *laser, Coating coating, const Hit *hit, Vector to_eye,
                          double footprint, uint32_t bit, uint32_t *code, uint8_t *stripe) {
    const Light *light = &scene->light;
    const double off = dot(laser->normal, hit->point) - laser->distance;
    const Vector to_projector = minus(laser->projector, hit->point);
    const double range = sqrt(dot(to_projector, to_projector)), spread = light->divergence * range;
    const double sigma = sqrt(light->sigma * light->sigma + spread * spread);
    if (fabs(off) >= MAX_SIGMAS * sigma + footprint) return 0;
    *stripe |= footprint > MAX_PIXEL_SIGMAS * sigma ? THIN : WIDE;
    if (fabs(off) >= MAX_SIGMAS * sigma) return 0;
    const Vector direction = times(1 / range, to_projector);
    if (shadowed(scene, &scene->all, hit, direction, range)) {
        *code |= bit;
        return 0;
    }
    const double along = -dot(laser->axis, to_projector), aside = -dot(cross(laser->normal, laser->axis), to_projector);
    if (dot(hit->normal, direction) <= 0 || dot(hit->flat_normal, direction) <= 0) return 0;
    if (fabs(atan2(aside, along)) > light->fan / 2) return 0;
    const double across = exp(-0.5 * off * off / (sigma * sigma)) / (sqrt(2 * PI) * sigma);
    return light->power / (light->fan * range) * across * lit_by(coating, hit, direction, to_eye);
}

/* Black sky, with the discs of Earth and sun. */
static double sky(const Scene *scene, const Stand *stand, Vector direction, uint32_t *code) {
    const Light *light = &scene->light;
    const Vector view = unit(direction);
    if (light->earth > 0) {
        const double sine = sin(light->earth_radius), cosine = dot(view, stand->earth);
        const double under = sine * sine - (1 - cosine * cosine);
        if (cosine > 0 && under > 0) { /* in units of the Earth's distance */
            const Vector zenith = times(1 / sine, minus(times(cosine - sqrt(under), view), stand->earth));
            *code |= SKY_EARTH;
            return light->earth_radiance * greater(0, dot(zenith, stand->sun));
        }
    }
    if (light->sun > 0 && dot(view, stand->sun) > cos(light->sun_radius)) {
        *code |= SKY_SUN;
        return light->sun / (PI * light->sun_radius * light->sun_radius);
    }
    return 0;
}

typedef struct {
    Vector direction;
    Hit hit;
    Draw draw;
} Ray;

/* Adds the radiance of one ray, by source: ambient light first, then each laser. `size` is that of a sample in pixels. */
static void shade(const Scene *scene, const Shades *shades, const Ray *ray, double size, double *sum, uint32_t *code,
                  uint8_t *stripe) {
    const Stand *stand = scene->stand + ray->draw.time;
    const Vector direction = ray->direction;
    Hit hit = ray->hit;
    int second;
    *code = 0;
    *stripe = 0;
    if (hit.part == EMPTY) {
        if (!scene->dark) sum[0] += sky(scene, stand, direction, code);
        return;
    }
    *code = (uint32_t)(hit.surface + 1) << 16;
    const double footprint = scene->light.angle_per_px * hit.parameter, length = sqrt(dot(direction, direction));
    const double range = hit.parameter * length + scene->baseline;
    const double limit = MAX_SIGMAS * (scene->light.sigma + scene->light.divergence * range) + footprint + scene->relief;
    const Vector flat = plus(stand->eye, times(hit.parameter, direction));
    uint32_t near = 0;
    for (int i = 0; i < scene->lasers; i++)
        if (stand->laser[i].on > 0 && fabs(dot(stand->laser[i].normal, flat) - stand->laser[i].distance) < limit)
            near |= 1u << i;
    if (scene->dark && !near) return;
    complete_hit(&scene->target, stand->eye, direction, &hit);
    const Vector to_eye = times(-1 / length, direction);
    const double oblique = greater(fabs(dot(hit.flat_normal, to_eye)), 0.05);
    const Coating coating = coating_at(&scene->target, &hit, footprint * size / oblique, &second);
    if (second) *code |= SECOND;
    if (!scene->dark) sum[0] += ambient_light(scene, stand, shades, coating, &hit, to_eye, &ray->draw, code);
    for (int i = 0; i < scene->lasers; i++)
        if (near >> i & 1)
            sum[1 + i] += laser_light(scene, stand->laser + i, coating, &hit, to_eye, footprint, 1u << i, code, stripe);
}

/* Parts of which a light at infinity may cast a shadow on a sphere; the light's disc and its motion have this radius. */
static void may_shade(const Scene *scene, Vector middle, double radius, Vector to_light, double light_radius,
                      Choice *choice) {
    choice->count = 0;
    for (int i = 0; i < scene->target.parts; i++) {
        const Part *part = scene->target.part + i;
        const Vector to = minus(part->center, middle);
        const double along = dot(to, to_light), aside2 = dot(to, to) - along * along, both = part->radius + radius;
        const double reach = both + greater(along + both, 0) * light_radius;
        if (along > -both && aside2 < reach * reach) choice->part[choice->count++] = i;
    }
}

static void find_shades(const Scene *scene, const Ray *ray, int count, Shades *shades) {
    Vector low = {INFINITY, INFINITY, INFINITY}, high = times(-1, low);
    for (int i = 0; i < count; i++) {
        if (ray[i].hit.part == EMPTY) continue;
        const Vector at = plus(scene->stand[ray[i].draw.time].eye, times(ray[i].hit.parameter, ray[i].direction));
        low = (Vector){lesser(low.x, at.x), lesser(low.y, at.y), lesser(low.z, at.z)};
        high = (Vector){greater(high.x, at.x), greater(high.y, at.y), greater(high.z, at.z)};
    }
    if (low.x > high.x) return;
    const Stand *first = scene->stand, *last = scene->stand + scene->times - 1, *stand = scene->stand + scene->times / 2;
    const Vector middle = times(0.5, plus(low, high)), across = minus(high, low), turned = minus(last->sun, first->sun);
    const double radius = sqrt(dot(across, across)) / 2 + scene->relief + LIFT_M, moved = sqrt(dot(turned, turned));
    if (scene->light.sun > 0)
        may_shade(scene, middle, radius, stand->sun, 1.1 * tan(scene->light.sun_radius) + moved, &shades->sun);
    if (scene->light.earth > 0)
        may_shade(scene, middle, radius, stand->earth, 1.1 * tan(scene->light.earth_radius) + moved, &shades->earth);
}

typedef struct {
    const double *x, *y;           /* ray (x, y, 1) of each pixel */
    const double *per_px[2][2];    /* its derivatives along the row and the column */
    size_t pixels;
    int width;
} Rays;

/* Parts whose bounding sphere a cone around the rays may meet, at the first, the middle or the last time. */
static void parts_near(const Scene *scene, const Rays *rays, const int64_t *pixel, int count, Choice *choice) {
    double left = INFINITY, right = -INFINITY, top = INFINITY, bottom = -INFINITY, cosine = 1;
    choice->count = 0;
    for (int i = 0; i < count; i++) {
        const double x = rays->x[pixel[i]], y = rays->y[pixel[i]];
        left = lesser(left, x), right = greater(right, x), top = lesser(top, y), bottom = greater(bottom, y);
    }
    const Vector axis = unit((Vector){(left + right) / 2, (top + bottom) / 2, 1});
    for (int i = 0; i < 4; i++)
        cosine = lesser(cosine, dot(axis, unit((Vector){i % 2 ? left : right, i / 2 ? top : bottom, 1})));
    const double half = acos(cosine) + scene->light.angle_per_px, cos_half = cos(half), sin_half = sin(half);
    for (int i = 0; i < scene->target.parts; i++) {
        const Part *part = scene->target.part + i;
        for (int k = 0; k < 3; k++) {
            const Stand *stand = scene->stand + k * (scene->times - 1) / 2;
            const Vector to = rotated(stand->rotation, minus(part->center, stand->eye));
            const double distance = sqrt(dot(to, to)), ahead = dot(to, axis);
            const double aside = sqrt(greater(distance * distance - ahead * ahead, 0));
            /* distance of the centre from the cone's mantle */
            const double off = aside * cos_half - ahead * sin_half;
            if (distance <= part->radius || (off <= part->radius && ahead > -part->radius)) {
                choice->part[choice->count++] = i;
                break;
            }
            if (scene->times == 1) break;
        }
    }
}

static double reversed(int number, int base) {
    double share = 1, sum = 0;
    for (; number; number /= base) sum += (share /= base) * (number % base);
    return sum;
}

/* Samples of a pixel: a Hammersley set. Rows are the same in all pixels, so that the profile of a stripe is integrated
   by the midpoint rule; everything else is shifted cyclically from pixel to pixel, so that edges show no banding. */
static void draw_sample(const Scene *scene, int sample, int samples, uint32_t column, uint32_t row, double shift_px[2],
                        Draw *draw) {
    const double turn = fraction(0.7548776662 * (double)column + 0.5698402910 * (double)row);
    const int first = (int)(turn * DISC);
    draw->sun = (first + sample) % DISC;
    draw->earth = (7 * first + 5 * sample + 3) % DISC;
    shift_px[0] = shift_px[1] = 0;
    draw->time = scene->times / 2;
    if (samples == 1) return;
    const double other = fraction(0.8191725134 * (double)column + 0.6710436067 * (double)row);
    shift_px[0] = fraction((double)sample / samples + turn) - 0.5;
    shift_px[1] = reversed(sample, 2) + 0.5 / samples - 0.5;
    if (scene->times > 1) draw->time = (int)(fraction(reversed(sample, 3) + other) * scene->times);
}

/* One sample of each pixel of a block. */
static void cast_block(const Scene *scene, const Rays *rays, const Choice *parts, const int64_t *pixel, int count,
                       int sample, int samples, Ray *ray) {
    int guess = 0;
    for (int i = 0; i < count; i++) {
        const int64_t at = pixel[i];
        double shift_px[2], x = rays->x[at], y = rays->y[at];
        draw_sample(scene, sample, samples, (uint32_t)at % (uint32_t)rays->width, (uint32_t)at / (uint32_t)rays->width,
                    shift_px, &ray[i].draw);
        if (samples > 1) {
            x += shift_px[0] * rays->per_px[0][0][at] + shift_px[1] * rays->per_px[1][0][at];
            y += shift_px[0] * rays->per_px[0][1][at] + shift_px[1] * rays->per_px[1][1][at];
        }
        const Stand *stand = scene->stand + ray[i].draw.time;
        ray[i].direction = rotated_back(stand->rotation, (Vector){x, y, 1});
        if (first_hit(&scene->target, parts->part, parts->count, guess, stand->eye, ray[i].direction, &ray[i].hit))
            for (guess = 0; parts->part[guess] != ray[i].hit.part;) guess++;
    }
}

static void render_all(const Scene *scene, const Rays *rays, const int64_t *chosen_pixel, size_t count, int samples,
                       float *radiance, uint32_t *code, uint8_t *stripe) {
    uint32_t unused_code;
    uint8_t unused_stripe;
    Ray ray[BLOCK];
    Choice parts;
    Shades shades;
    for (size_t start = 0; start < count; start += BLOCK) {
        int64_t pixel[BLOCK];
        double sum[BLOCK][1 + MAX_LASERS] = {{0}};
        const int entries = (int)(count - start < BLOCK ? count - start : BLOCK);
        for (int i = 0; i < entries; i++) pixel[i] = chosen_pixel ? chosen_pixel[start + i] : (int64_t)(start + i);
        parts_near(scene, rays, pixel, entries, &parts);
        for (int sample = 0; sample < samples; sample++) {
            cast_block(scene, rays, &parts, pixel, entries, sample, samples, ray);
            if (!scene->dark) find_shades(scene, ray, entries, &shades);
            for (int i = 0; i < entries; i++)
                shade(scene, &shades, ray + i, 1 / sqrt(samples), sum[i], code ? code + pixel[i] : &unused_code,
                      stripe ? stripe + pixel[i] : &unused_stripe);
        }
        for (int i = 0; i < entries; i++)
            for (int k = 0; k <= scene->lasers; k++)
                radiance[(size_t)k * rays->pixels + (size_t)pixel[i]] = (float)(sum[i][k] / samples);
    }
}

/* The arguments that describe a target; those of a function follow. */
#define TARGET \
    {"parts", 'd', {ANY, NUMBERS(Part)}}, {"points", 'd', {ANY, 2}}, {"gaps", 'd', {ANY, NUMBERS(Gap)}}, \
        {"forms", 'd', {ANY, NUMBERS(Form)}}, {"material_of", 'i', {ANY}}, \
        {"materials", 'd', {ANY, NUMBERS(Material)}}, {"print_x", 'd', {ANY}}, {"print_y", 'd', {ANY}}, \
        {"print", 'B', {ANY, ANY}}, {"texels", 'd', {K}}, {"heights", 'f', {K, RELIEF_TEXELS, RELIEF_TEXELS}}, \
        {"slopes", 'f', {K, RELIEF_TEXELS, RELIEF_TEXELS, 2}}
enum { AFTER_TARGET = 12 };

static int open_target(const Arguments *arguments, Target *target) {
    const Py_buffer *view = arguments->view;
    *target = (Target){view[0].buf, (int)view[0].shape[0], view[1].buf, view[2].buf, view[3].buf, view[4].buf,
                       view[5].buf, view[6].buf, view[7].buf, (int)view[8].shape[1], (int)view[8].shape[0], view[8].buf,
                       view[9].buf, view[10].buf, view[11].buf};
    int fits = view[0].shape[0] <= MAX_PARTS && view[6].shape[0] == view[8].shape[1] - 1 &&
               view[7].shape[0] == view[8].shape[0] - 1;
    for (int i = 0; i < target->parts; i++) {
        const Part *part = target->part + i;
        const double surfaces = part->kind == BOX ? 6 : part->points;
        fits = fits && part->points <= MAX_POINTS && part->first_point + part->points <= (double)view[1].shape[0] &&
               part->first_gap + part->gaps <= (double)view[2].shape[0] && part->form < (double)view[3].shape[0] &&
               part->first_surface + surfaces <= (double)view[4].shape[0] && part->relief < (double)view[9].shape[0];
    }
    for (Py_ssize_t i = 0; i < view[4].shape[0]; i++)
        fits = fits && target->material_of[i] >= 0 && target->material_of[i] < view[5].shape[0];
    return require(fits, "the tables of the target do not fit each other");
}

PyObject *call_render(PyObject *module, PyObject *tuple) {
    static const Parameter parameter[] = {
        TARGET,
        {"poses", 'd', {ANY, 12}}, {"lamps", 'd', {LAMPS, NUMBERS(Lamp)}}, {"lasers", 'd', {ANY, NUMBERS(Laser)}},
        {"light", 'T', {NUMBERS(Light)}}, {"xy", 'd', {2, N}}, {"?per_px", 'd', {2, 2, N}}, {"width", 'L', {1, 1 << 30}},
        {"?pixels", 'q', {ANY}}, {"samples", 'L', {1, 1 << 16}}, {">radiance", 'f', {ANY, N}}, {">?code", 'i', {N}},
        {">?stripe", 'B', {N}}};
    Arguments arguments;
    (void)module;
    if (!OPEN(tuple, parameter, &arguments)) return NULL;
    const Py_buffer *view = arguments.view + AFTER_TARGET;
    const double(*number)[MAX_NUMBERS] = arguments.number + AFTER_TARGET;
    Scene *scene = calloc(1, sizeof *scene);
    if (!scene) return close_arguments(&arguments, PyErr_NoMemory());
    const size_t pixels = (size_t)view[4].shape[1];
    int fits = open_target(&arguments, &scene->target) &&
               require(view[0].shape[0] >= 1 && view[0].shape[0] <= MAX_TIMES && view[2].shape[0] <= MAX_LASERS &&
                           view[9].shape[0] == view[2].shape[0] + 1 && (view[5].obj || number[8][0] == 1),
                       "poses, lasers and radiance do not fit each other");
    const int64_t *chosen = view[7].obj ? view[7].buf : NULL;
    const size_t count = chosen ? (size_t)view[7].shape[0] : pixels;
    for (size_t i = 0; fits && chosen && i < count; i++)
        fits = require(chosen[i] >= 0 && (size_t)chosen[i] < pixels, "a pixel is outside the image");
    if (fits) {
        const double *xy = view[4].buf, *per_px = view[5].obj ? view[5].buf : NULL;
        Rays rays = {xy, xy + pixels, {{NULL, NULL}, {NULL, NULL}}, pixels, (int)number[6][0]};
        for (int i = 0; per_px && i < 4; i++) rays.per_px[i / 2][i % 2] = per_px + (size_t)i * pixels;
        memcpy(&scene->light, number[3], sizeof(Light));
        memcpy(scene->lamp, view[1].buf, sizeof scene->lamp);
        scene->times = (int)view[0].shape[0];
        scene->lasers = (int)view[2].shape[0];
        for (Py_ssize_t i = 0; i < arguments.view[9].shape[0] * RELIEF_TEXELS * RELIEF_TEXELS; i++)
            scene->relief = greater(scene->relief, 2 * fabs(scene->target.height[i]));
        for (scene->all.count = 0; scene->all.count < scene->target.parts; scene->all.count++)
            scene->all.part[scene->all.count] = scene->all.count;
        scene->dark = !(scene->light.ambient > 0 || scene->light.sun > 0 || scene->light.earth > 0);
        for (int i = 0; i < scene->times; i++)
            place(scene, scene->stand + i, (const double *)view[0].buf + 12 * i, view[2].buf);
        Py_BEGIN_ALLOW_THREADS render_all(scene, &rays, chosen, count, (int)number[8][0], view[9].buf,
                                          view[10].obj ? view[10].buf : NULL, view[11].obj ? view[11].buf : NULL);
        Py_END_ALLOW_THREADS
    }
    free(scene);
    return close_arguments(&arguments, fits ? Py_NewRef(Py_None) : NULL);
}

PyObject *call_hits(PyObject *module, PyObject *tuple) {
    static const Parameter parameter[] = {TARGET,
                                          {"origin", 'd', {3}},
                                          {"direction", 'd', {3, N}},
                                          {">parameter", 'd', {N}},
                                          {">surface", 'i', {N}},
                                          {">point", 'd', {3, N}},
                                          {">normal", 'd', {3, N}}};
    Arguments arguments;
    Target target;
    (void)module;
    if (!OPEN(tuple, parameter, &arguments)) return NULL;
    if (!open_target(&arguments, &target)) return close_arguments(&arguments, NULL);
    const Py_buffer *view = arguments.view + AFTER_TARGET;
    const size_t n = (size_t)view[1].shape[1];
    const double *origin = view[0].buf, *direction = view[1].buf;
    double *parameters = view[2].buf, *point = view[4].buf, *normal = view[5].buf;
    int32_t *surface = view[3].buf;
    int all[MAX_PARTS];
    for (int i = 0; i < target.parts; i++) all[i] = i;
    for (size_t i = 0; i < n; i++) {
        const Vector eye = {origin[0], origin[1], origin[2]};
        const Vector ray = {direction[i], direction[n + i], direction[2 * n + i]};
        Hit hit = {.surface = EMPTY, .point = {NAN, NAN, NAN}, .normal = {NAN, NAN, NAN}};
        if (first_hit(&target, all, target.parts, target.parts, eye, ray, &hit)) complete_hit(&target, eye, ray, &hit);
        parameters[i] = hit.parameter;
        surface[i] = hit.surface;
        point[i] = hit.point.x, point[n + i] = hit.point.y, point[2 * n + i] = hit.point.z;
        normal[i] = hit.normal.x, normal[n + i] = hit.normal.y, normal[2 * n + i] = hit.normal.z;
    }
    return close_arguments(&arguments, Py_NewRef(Py_None));
}

PyObject *call_blocked(PyObject *module, PyObject *tuple) {
    static const Parameter parameter[] = {
        TARGET, {"point", 'd', {3, N}}, {"towards", 'd', {3, N}}, {">blocked", '?', {N}}};
    Arguments arguments;
    Target target;
    (void)module;
    if (!OPEN(tuple, parameter, &arguments)) return NULL;
    if (!open_target(&arguments, &target)) return close_arguments(&arguments, NULL);
    const Py_buffer *view = arguments.view + AFTER_TARGET;
    const size_t n = (size_t)view[0].shape[1];
    const double *point = view[0].buf, *towards = view[1].buf;
    uint8_t *result = view[2].buf;
    int all[MAX_PARTS];
    for (int i = 0; i < target.parts; i++) all[i] = i;
    for (size_t i = 0; i < n; i++)
        result[i] = (uint8_t)blocked(&target, all, target.parts, EMPTY, (Vector){point[i], point[n + i], point[2 * n + i]},
                                     (Vector){towards[i], towards[n + i], towards[2 * n + i]});
    return close_arguments(&arguments, Py_NewRef(Py_None));
}

PyObject *call_reflectances(PyObject *module, PyObject *tuple) {
    static const Parameter parameter[] = {{"coating", 'T', {NUMBERS(Coating)}},
                                          {"normal", 'd', {3, N}},
                                          {"to_light", 'd', {3, N}},
                                          {"to_eye", 'd', {3, N}},
                                          {">reflectance", 'd', {N}}};
    Arguments arguments;
    (void)module;
    if (!OPEN(tuple, parameter, &arguments)) return NULL;
    const Py_buffer *view = arguments.view;
    const size_t n = (size_t)view[1].shape[1];
    const double *normal = view[1].buf, *light = view[2].buf, *eye = view[3].buf;
    double *result = view[4].buf;
    const Coating coating = {arguments.number[0][0], arguments.number[0][1], arguments.number[0][2]};
    for (size_t i = 0; i < n; i++)
        result[i] = reflectance(coating, (Vector){normal[i], normal[n + i], normal[2 * n + i]},
                                (Vector){light[i], light[n + i], light[2 * n + i]},
                                (Vector){eye[i], eye[n + i], eye[2 * n + i]});
    return close_arguments(&arguments, Py_NewRef(Py_None));
}
