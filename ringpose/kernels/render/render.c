/* Radiance of a lit target in the pixels of a camera, for several placements of the target during the exposure. */
#include <string.h>

#include "arguments.h"
#include "target.h"

#define PI 3.14159265358979323846

enum { LAMPS = 4, MAX_TIMES = 64, DISC = 64 };

/* Distance from a sheet, in sigmas of its thickness, beyond which its light is neglected: 4e-5 of the peak. */
static const double MAX_SIGMAS = 4.5;

/* A stripe is thin where a pixel covers more sigmas than this; one ray per pixel shifts a wider one by < 1e-5 px. */
static const double MAX_PIXEL_SIGMAS = 1.25;

/* Objects farther than this cast no shadow; origins of shadow rays are lifted off their surface. */
static const double FAR_M = 100, LIFT_M = 1e-7;

/* Reach of the rays of the camera. */
static const double EVERYWHERE_M = 1e9;

/* Smallest distance of an intersection that casts a shadow. */
static const double MIN_DISTANCE_M = 1e-9;

/* Code of a pixel: surface + 1 in the upper half, then what else changes at edges; laser k has bit k. */
enum { SUN_SHADOW = 1 << 8, EARTH_SHADOW = 1 << 9, SECOND = 1 << 10, SKY_EARTH = 1 << 11, SKY_SUN = 1 << 12 };

/* Surfaces in a pixel whose light is averaged one by one; the others share the last entry. */
enum { ENTRIES = 6 };

/* Directions are unit vectors towards the light, in the camera frame. */
#define SCENE_LIGHT(REAL, COUNT)                                                                                    \
    REAL(ambient_w_m2, NOT_NEGATIVE) /* irradiance by a laboratory */                                               \
    REAL(sun_w_m2, NOT_NEGATIVE)     /* irradiance across the rays */                                               \
    REAL(sun_x, FINITE) REAL(sun_y, FINITE) REAL(sun_z, FINITE)                                                     \
    REAL(sun_radius_rad, NOT_NEGATIVE) /* angular radius */                                                         \
    REAL(earth_w_m2, NOT_NEGATIVE)                                                                                  \
    REAL(earth_x, FINITE) REAL(earth_y, FINITE) REAL(earth_z, FINITE)                                               \
    REAL(earth_radius_rad, NOT_NEGATIVE)                                                                            \
    REAL(lit_x, FINITE) REAL(lit_y, FINITE) REAL(lit_z, FINITE) /* the middle of the Earth's lit part */            \
    REAL(earth_radiance, NOT_NEGATIVE) /* where the sun is in the zenith */                                         \
    REAL(power_w, FINITE) REAL(sigma_m, FINITE) REAL(divergence_rad, FINITE) REAL(fan_rad, FINITE) /* of a laser */ \
    REAL(angle_per_px, FINITE)
RECORD_STRUCT(SceneLight, SCENE_LIGHT);
RECORD(SceneLight, SCENE_LIGHT);

typedef struct {
    Vector direction;
    double sharpness, share;
} Lamp;

typedef struct {
    Vector normal;
    double distance;
    Vector projector, axis;
    double on, bow; /* bow: elevation of the rays over the plane by the square of their angle in it */
} Laser;

/* The light in the target frame at one time of the exposure. */
typedef struct {
    double rotation[9]; /* camera_from_target */
    Vector eye, sun, earth, lit, lamp[LAMPS];
    Vector on_sun[DISC], on_earth[DISC]; /* directions all over the discs; any neighbours in the list are far apart */
    Vector projector[MAX_LASERS];
} Stand;

typedef struct {
    Target target;
    SceneLight light;
    Lamp lamp[LAMPS];
    Laser laser[MAX_LASERS]; /* in the camera frame */
    Stand stand[MAX_TIMES];
    int times, lasers, dark;
    double moved;    /* largest motion of the eye or a projector in the target frame */
    double baseline; /* largest distance of a projector from the camera */
    double bend;     /* largest elevation of a ray over its light plane, as a slope */
    double relief;   /* largest displacement of a hit by a relief, for rays up to 60 degrees from the normal */
} Scene;

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

static void place(const Scene *scene, Stand *stand, const double pose[12]) {
    const SceneLight *light = &scene->light;
    const Vector translation = {pose[9], pose[10], pose[11]};
    memcpy(stand->rotation, pose, sizeof stand->rotation);
    stand->eye = times(-1, rotated_back(pose, translation));
    stand->sun = rotated_back(pose, (Vector){light->sun_x, light->sun_y, light->sun_z});
    stand->earth = rotated_back(pose, (Vector){light->earth_x, light->earth_y, light->earth_z});
    stand->lit = rotated_back(pose, (Vector){light->lit_x, light->lit_y, light->lit_z});
    if (light->sun_w_m2 > 0) fill_disc(stand->sun, light->sun_radius_rad, stand->on_sun);
    if (light->earth_w_m2 > 0) fill_disc(stand->earth, light->earth_radius_rad, stand->on_earth);
    for (int i = 0; i < LAMPS; i++) stand->lamp[i] = rotated_back(pose, scene->lamp[i].direction);
    for (int i = 0; i < scene->lasers; i++)
        stand->projector[i] = rotated_back(pose, minus(scene->laser[i].projector, translation));
}

/* The rays of a block of neighbouring pixels, one sample of each. */
typedef struct {
    int64_t pixel[BATCH];
    double middle_x[BATCH], middle_y[BATCH]; /* ray (x, y, 1) through the middle of each pixel in the camera frame */
    double per_px[2][2][BATCH];              /* its derivatives along the row and the column */
    double x[BATCH], y[BATCH];               /* ray of the sample */
    double turn[BATCH], other[BATCH];        /* shifts of the samples of each pixel */
    int32_t time[BATCH], sun[BATCH], earth[BATCH]; /* of the sample: time, and places on the discs of sun and Earth */
    Rays rays;
    Hits hits;
    float nx[BATCH], ny[BATCH], nz[BATCH]; /* normals of the hits, rounded */
    float ex[BATCH], ey[BATCH], ez[BATCH]; /* unit vectors to the eye */
    double depth[BATCH], cx[BATCH], cy[BATCH], footprint[BATCH]; /* of the hits; rays in the camera frame; per pixel */
    uint32_t code[BATCH];
    uint8_t stripe[BATCH];
    int32_t row[BATCH], column[BATCH], entry[BATCH];                        /* entry: of the ray's surface */
    int32_t surface[ENTRIES][BATCH], count[ENTRIES][BATCH], shaded[ENTRIES][BATCH]; /* of each pixel */
    double sum[ENTRIES][1 + MAX_LASERS][BATCH];                             /* radiance of the shaded samples, by source */
    uint32_t sources;                                                       /* that some ray shows, as bits */
} Block;

/* Adds light of a source to that of the surface that a ray shows. */
static inline void add(Block *block, int source, int ray, double radiance) {
    block->sum[block->entry[ray]][source][ray] += radiance;
}

/* Light that falls on the hits of a block from a point or a distant source. */
typedef struct {
    uint8_t on[BATCH], shadowed[BATCH]; /* on: hits that are within the light */
    double x[BATCH], y[BATCH], z[BATCH]; /* unit vectors towards the light */
    double reach[BATCH];                 /* and its distance */
} Beam;

/* Parts that may cast a shadow on the hits that are `on`: those near the bundle from their bounding sphere
   towards the light; not a box on which all of them are. `slope` is the change of radius of the bundle with the
   distance. */
static void may_shade(const Scene *scene, const Hits *hits, const uint8_t *on, Vector towards, double slope, double reach,
                      Choice *choice) {
    Vector low = {INFINITY, INFINITY, INFINITY}, high = times(-1, low);
    int own = EMPTY, mixed = 0;
    choice->count = 0;
    choice->length = reach;
    for (int i = 0; i < hits->count; i++) {
        if (!on[i]) continue;
        low = (Vector){lesser(low.x, hits->x[i]), lesser(low.y, hits->y[i]), lesser(low.z, hits->z[i])};
        high = (Vector){greater(high.x, hits->x[i]), greater(high.y, hits->y[i]), greater(high.z, hits->z[i])};
        mixed |= own != EMPTY && own != hits->part[i];
        own = hits->part[i];
    }
    if (own == EMPTY) return;
    const Vector across = minus(high, low), axis = unit(towards);
    const double radius = sqrt(dot(across, across)) / 2 + scene->relief + scene->moved + LIFT_M;
    const Bundle bundle = {minus(times(0.5, plus(low, high)), times(radius, axis)), axis, (1 + 2 * slope) * radius, slope,
                           reach + 2 * radius};
    for (int i = 0; i < scene->target.parts; i++) {
        if (i == own && !mixed && scene->target.part[i].kind == BOX) continue;
        const double enter = bundle_enters(scene->target.part + i, &bundle);
        if (enter < INFINITY) choose(choice, i, greater(enter - 2 * radius, 0));
    }
}

/* Finds which hits within a beam are in the shadow of one of the chosen parts. */
static void find_shadows(const Scene *scene, const Hits *hits, const Choice *choice, Beam *beam) {
    Rays rays;
    int32_t hit[BATCH];
    memset(beam->shadowed, 0, sizeof beam->shadowed);
    rays.count = 0;
    for (int i = 0; i < hits->count; i++) {
        if (!beam->on[i]) continue;
        const double lift = hits->below[i] + LIFT_M, reach = beam->reach[i];
        const int at = rays.count++;
        hit[at] = i;
        rays.ox[at] = hits->x[i] + lift * hits->fx[i];
        rays.oy[at] = hits->y[i] + lift * hits->fy[i];
        rays.oz[at] = hits->z[i] + lift * hits->fz[i];
        rays.dx[at] = reach * beam->x[i], rays.dy[at] = reach * beam->y[i], rays.dz[at] = reach * beam->z[i];
        rays.least[at] = MIN_DISTANCE_M / reach;
        rays.best[at] = 1;
        rays.own[at] = scene->target.part[hits->part[i]].kind == BOX ? hits->part[i] : EMPTY;
    }
    intersect(&scene->target, choice, &rays);
    for (int i = 0; i < rays.count; i++) beam->shadowed[hit[i]] = rays.part[i] != EMPTY;
}

/* exp(x) for x from -87 to 0, relative error 2e-7: 2^n times a polynomial of the rest. */
static inline float exponential(float x) {
    const float scaled = x * 1.44269504f;
    const int32_t whole_part = (int32_t)(scaled - 0.5f), bits = (whole_part + 127) << 23;
    const float r = (scaled - (float)whole_part) * 0.69314718f;
    float power;
    memcpy(&power, &bits, sizeof power);
    return power * (1 + r * (1 + r * (0.5f + r * (0.166666667f + r * (0.0416666667f + r * (8.3333e-3f + r * 1.3889e-3f))))));
}

/* Light of a laboratory. Lamps are lobes exp(k (cos - 1)) of light, which the roughness widens in reflection; the walls
   are uniformly grey. The lamps stand as in the middle of the exposure: they are wide. */
VECTOR_LOOP static void add_laboratory(const Scene *restrict scene, const Block *restrict block,
                                       float *restrict radiance) {
    const int count = block->hits.count;
    const Hits *hits = &block->hits;
    const Stand *stand = scene->stand + scene->times / 2;
    const float irradiance = (float)(scene->light.ambient_w_m2 / PI);
    float mx[BATCH], my[BATCH], mz[BATCH], matt[BATCH], glossy[BATCH], walls = 1;
    for (int k = 0; k < LAMPS; k++) walls -= (float)scene->lamp[k].share;
    for (int i = 0; i < count; i++) { /* the directions that the eye sees mirrored */
        const float nx = block->nx[i], ny = block->ny[i], nz = block->nz[i];
        const float ex = block->ex[i], ey = block->ey[i], ez = block->ez[i], twice = 2 * (nx * ex + ny * ey + nz * ez);
        mx[i] = twice * nx - ex, my[i] = twice * ny - ey, mz[i] = twice * nz - ez;
        matt[i] = glossy[i] = walls;
    }
    for (int k = 0; k < LAMPS; k++) {
        const float x = (float)stand->lamp[k].x, y = (float)stand->lamp[k].y, z = (float)stand->lamp[k].z;
        const float share = (float)scene->lamp[k].share, width = (float)(1 / scene->lamp[k].sharpness);
        for (int i = 0; i < count; i++) {
            const float facing = x * block->nx[i] + y * block->ny[i] + z * block->nz[i];
            const float sharpness = 1 / (width + hits->roughness[i] * hits->roughness[i]);
            const float off = x * mx[i] + y * my[i] + z * mz[i] - 1;
            matt[i] += share / 2 * (facing + fabsf(facing)); /* of the facing side alone */
            glossy[i] += share * sharpness / 2 * exponential(sharpness / 2 * (off - fabsf(off)));
        }
    }
    for (int i = 0; i < count; i++) {
        const float cosine = block->nx[i] * block->ex[i] + block->ny[i] * block->ey[i] + block->nz[i] * block->ez[i];
        const float rest = 1 - (cosine < 0 ? 0 : cosine < 1 ? cosine : 1), rest2 = rest * rest;
        const float specular = hits->specular[i], fresnel = specular + (1 - specular) * rest2 * rest2 * rest;
        radiance[i] = irradiance * (hits->diffuse[i] * matt[i] + fresnel * glossy[i] * (float)(specular > 0));
    }
}

/* The BRDF times the cosine for each hit in the light of a beam; `widening` is added to the roughness in quadrature. */
VECTOR_LOOP static void reflect(const Block *restrict block, const Beam *restrict beam, float widening,
                                float *restrict reflected) {
    const Hits *hits = &block->hits;
    const int count = hits->count;
    for (int i = 0; i < count; i++) {
        const float nx = block->nx[i], ny = block->ny[i], nz = block->nz[i];
        const float lx = (float)beam->x[i], ly = (float)beam->y[i], lz = (float)beam->z[i];
        const float roughness = sqrtf(hits->roughness[i] * hits->roughness[i] + widening * widening);
        const float cosine = nx * lx + ny * ly + nz * lz;
        const float value = brdf(hits->diffuse[i], hits->specular[i], roughness, nx, ny, nz, lx, ly, lz, block->ex[i],
                                 block->ey[i], block->ez[i]);
        const float lit = (float)(beam->on[i] & (beam->shadowed[i] ^ 1));
        reflected[i] = lit * (cosine > 0 ? cosine : 0) * value;
    }
}

/* Light from a disc in the sky, whose direction may change with the time, on the hits whose flat surface faces it; it
   is shadowed if a part hides the place on the disc that was drawn. */
static void find_disc(const Scene *scene, const Block *block, int is_sun, double radius, Beam *beam) {
    const Hits *hits = &block->hits;
    const Stand *middle = scene->stand + scene->times / 2;
    const Vector turned = minus(scene->stand[scene->times - 1].sun, scene->stand[0].sun);
    Choice choice;
    for (int i = 0; i < hits->count; i++) {
        const Stand *stand = scene->stand + block->time[hits->ray[i]];
        const Vector light = is_sun ? stand->sun : stand->lit;
        beam->x[i] = light.x, beam->y[i] = light.y, beam->z[i] = light.z;
        beam->on[i] = hits->fx[i] * light.x + hits->fy[i] * light.y + hits->fz[i] * light.z > 0;
        beam->shadowed[i] = 0;
    }
    may_shade(scene, hits, beam->on, is_sun ? middle->sun : middle->earth, 1.1 * tan(radius) + sqrt(dot(turned, turned)),
              FAR_M, &choice);
    if (choice.count == 0) return;
    Beam drawn;
    for (int i = 0; i < hits->count; i++) {
        const Stand *stand = scene->stand + block->time[hits->ray[i]];
        const Vector place = is_sun ? stand->on_sun[block->sun[hits->ray[i]]] : stand->on_earth[block->earth[hits->ray[i]]];
        drawn.x[i] = place.x, drawn.y[i] = place.y, drawn.z[i] = place.z;
        drawn.reach[i] = FAR_M;
        drawn.on[i] = beam->on[i];
    }
    find_shadows(scene, hits, &choice, &drawn);
    memcpy(beam->shadowed, drawn.shadowed, sizeof beam->shadowed);
}

static void add_ambient(const Scene *scene, Block *block) {
    const SceneLight *light = &scene->light;
    const Hits *hits = &block->hits;
    float radiance[BATCH] = {0}, reflected[BATCH];
    uint8_t sunlit[BATCH] = {0};
    Beam beam;
    if (light->ambient_w_m2 > 0) add_laboratory(scene, block, radiance);
    if (light->sun_w_m2 > 0) {
        find_disc(scene, block, 1, light->sun_radius_rad, &beam);
        reflect(block, &beam, 0, reflected);
        for (int i = 0; i < hits->count; i++) {
            sunlit[i] = beam.on[i] && !beam.shadowed[i];
            if (beam.shadowed[i]) block->code[hits->ray[i]] |= SUN_SHADOW;
            radiance[i] += (float)light->sun_w_m2 * reflected[i];
        }
    }
    if (light->earth_w_m2 > 0) { /* its disc widens reflections by its own width */
        find_disc(scene, block, 0, light->earth_radius_rad, &beam);
        reflect(block, &beam, (float)light->earth_radius_rad / 2, reflected);
        for (int i = 0; i < hits->count; i++) {
            if (beam.shadowed[i] && !sunlit[i]) block->code[hits->ray[i]] |= EARTH_SHADOW;
            radiance[i] += (float)light->earth_w_m2 * reflected[i];
        }
    }
    for (int i = 0; i < hits->count; i++) add(block, 0, hits->ray[i], radiance[i]);
}

/* Distances of the hits from a sheet of light, and its thickness there, in the camera frame. */
VECTOR_LOOP static void find_sheet(const Scene *scene, const Laser *laser, const Block *block, double off[BATCH],
                                   double sigma[BATCH], double range[BATCH]) {
    const double least2 = scene->light.sigma_m * scene->light.sigma_m, divergence = scene->light.divergence_rad;
    const Vector normal = laser->normal, projector = laser->projector;
    for (int i = 0; i < block->hits.count; i++) {
        const double z = block->depth[i], x = z * block->cx[i], y = z * block->cy[i];
        const double px = projector.x - x, py = projector.y - y, pz = projector.z - z;
        range[i] = sqrt(px * px + py * py + pz * pz);
        sigma[i] = sqrt(least2 + divergence * range[i] * divergence * range[i]);
        off[i] = normal.x * x + normal.y * y + normal.z * z - laser->distance;
    }
}

/* Angles in the plane of a sheet, from the middle of its fan, at which the hits are seen from the projector. */
static double fan_angle(const Laser *laser, const Block *block, int i) {
    const double z = block->depth[i];
    const Vector from = minus((Vector){z * block->cx[i], z * block->cy[i], z}, laser->projector);
    return atan2(dot(cross(laser->normal, laser->axis), from), dot(laser->axis, from));
}

static void add_laser(const Scene *scene, int number, Block *block) {
    const SceneLight *light = &scene->light;
    const Laser *laser = scene->laser + number;
    const Hits *hits = &block->hits;
    double off[BATCH], sigma[BATCH], range[BATCH];
    float reflected[BATCH];
    double reach = 0;
    Vector towards = {0, 0, 0};
    Beam beam;
    Choice choice;
    find_sheet(scene, laser, block, off, sigma, range);
    for (int i = 0; i < hits->count && laser->bow != 0; i++) {
        const double angle = fan_angle(laser, block, i);
        off[i] -= laser->bow * angle * angle * range[i];
    }
    for (int i = 0; i < hits->count; i++) {
        const Vector projector = scene->stand[block->time[hits->ray[i]]].projector[number];
        beam.on[i] = fabs(off[i]) < MAX_SIGMAS * sigma[i];
        beam.x[i] = (projector.x - hits->x[i]) / range[i];
        beam.y[i] = (projector.y - hits->y[i]) / range[i];
        beam.z[i] = (projector.z - hits->z[i]) / range[i];
        beam.reach[i] = range[i];
        if (beam.on[i]) {
            reach = greater(reach, range[i]);
            towards = plus(towards, (Vector){beam.x[i], beam.y[i], beam.z[i]});
        }
        if (fabs(off[i]) < MAX_SIGMAS * sigma[i] + block->footprint[i])
            block->stripe[hits->ray[i]] |= block->footprint[i] > MAX_PIXEL_SIGMAS * sigma[i] ? THIN : WIDE;
    }
    if (reach == 0) return;
    may_shade(scene, hits, beam.on, towards, 0, reach, &choice);
    find_shadows(scene, hits, &choice, &beam);
    reflect(block, &beam, 0, reflected);
    for (int i = 0; i < hits->count; i++) {
        if (beam.shadowed[i]) block->code[hits->ray[i]] |= 1u << number;
        if (reflected[i] <= 0 || hits->fx[i] * beam.x[i] + hits->fy[i] * beam.y[i] + hits->fz[i] * beam.z[i] <= 0) continue;
        if (fabs(fan_angle(laser, block, i)) > light->fan_rad / 2) continue;
        const double across = exp(-0.5 * off[i] * off[i] / (sigma[i] * sigma[i])) / (sqrt(2 * PI) * sigma[i]);
        add(block, 1 + number, hits->ray[i], light->power_w / (light->fan_rad * range[i]) * across * reflected[i]);
    }
}

/* Black sky, with the discs of Earth and sun. */
static double sky(const Scene *scene, const Stand *stand, Vector direction, uint32_t *code) {
    const SceneLight *light = &scene->light;
    const Vector view = unit(direction);
    if (light->earth_w_m2 > 0) {
        const double sine = sin(light->earth_radius_rad), cosine = dot(view, stand->earth);
        const double under = sine * sine - (1 - cosine * cosine);
        if (cosine > 0 && under > 0) { /* in units of the Earth's distance */
            const Vector zenith = times(1 / sine, minus(times(cosine - sqrt(under), view), stand->earth));
            *code |= SKY_EARTH;
            return light->earth_radiance * greater(0, dot(zenith, stand->sun));
        }
    }
    if (light->sun_w_m2 > 0 && dot(view, stand->sun) > cos(light->sun_radius_rad)) {
        *code |= SKY_SUN;
        return light->sun_w_m2 / (PI * light->sun_radius_rad * light->sun_radius_rad);
    }
    return 0;
}

/* Lasers that are on and whose sheets pass near some ray's hit, as bits; `wanted`: which rays' hits are near one. */
VECTOR_LOOP static uint32_t find_stripes(const Scene *restrict scene, const Block *restrict block,
                                         uint8_t *restrict wanted) {
    const Rays *rays = &block->rays;
    const int count = rays->count;
    const double slope = MAX_SIGMAS * scene->light.divergence_rad + scene->bend, per_px = scene->light.angle_per_px;
    const double least = MAX_SIGMAS * scene->light.sigma_m + slope * scene->baseline + scene->relief;
    double limit[BATCH];
    uint32_t lasers = 0;
    memset(wanted, 0, BATCH);
    for (int i = 0; i < count; i++) {
        const double x = block->x[i], y = block->y[i];
        limit[i] = least + rays->best[i] * (slope * sqrt(x * x + y * y + 1) + per_px);
    }
    for (int k = 0; k < scene->lasers; k++) {
        const Laser *laser = scene->laser + k;
        const double nx = laser->normal.x, ny = laser->normal.y, nz = laser->normal.z, distance = laser->distance;
        int any = 0;
        if (laser->on <= 0) continue;
        for (int i = 0; i < count; i++) {
            const double off = rays->best[i] * (nx * block->x[i] + ny * block->y[i] + nz) - distance;
            const int near = (rays->part[i] != EMPTY) & (fabs(off) < limit[i]);
            wanted[i] |= (uint8_t)near;
            any |= near;
        }
        lasers |= (uint32_t)any << k;
    }
    return lasers;
}

/* Counts the samples of each surface in each pixel, and chooses those that are shaded: the first, and then one in
   `step`. */
static void choose_shaded(Block *block, int step, uint8_t chosen[BATCH]) {
    if (step == 1) { /* all of them, into one entry */
        memset(chosen, 1, BATCH);
        memset(block->entry, 0, sizeof block->entry);
        for (int i = 0; i < block->rays.count; i++) block->count[0][i] = 1;
        return;
    }
    for (int i = 0; i < block->rays.count; i++) {
        const int32_t surface = (int32_t)(block->code[i] >> 16);
        int entry = 0;
        while (entry < ENTRIES - 1 && block->count[entry][i] > 0 && block->surface[entry][i] != surface) entry++;
        block->surface[entry][i] = surface;
        chosen[i] = entry == ENTRIES - 1 || block->count[entry][i] % step == 0;
        block->count[entry][i]++;
        block->shaded[entry][i] += chosen[i];
        block->entry[i] = entry;
    }
}

/* What the shading of the hits needs from their rays. */
VECTOR_LOOP static void find_views(double angle_per_px, double size, Block *restrict block, double *restrict width) {
    const Hits *hits = &block->hits;
    const int count = hits->count;
    for (int i = 0; i < count; i++) {
        const double dx = hits->dx[i], dy = hits->dy[i], dz = hits->dz[i], scale = -1 / sqrt(dx * dx + dy * dy + dz * dz);
        const double ex = scale * dx, ey = scale * dy, ez = scale * dz, footprint = angle_per_px * hits->best[i];
        const double oblique = greater(fabs(hits->fx[i] * ex + hits->fy[i] * ey + hits->fz[i] * ez), 0.05);
        block->nx[i] = (float)hits->nx[i], block->ny[i] = (float)hits->ny[i], block->nz[i] = (float)hits->nz[i];
        block->ex[i] = (float)ex, block->ey[i] = (float)ey, block->ez[i] = (float)ez;
        block->footprint[i] = footprint;
        width[i] = footprint * size / oblique;
    }
}

/* Adds the radiance of the rays, by source: ambient light first, then each laser. `size` is that of a sample in pixels;
   of the samples of a surface in a pixel, one in `step` is shaded. */
static void shade(const Scene *scene, double size, int step, Block *block) {
    const Rays *rays = &block->rays;
    Hits *hits = &block->hits;
    uint8_t near[BATCH], wanted[BATCH];
    double width[BATCH];
    const uint32_t lasers = find_stripes(scene, block, near);
    for (int i = 0; i < rays->count; i++) {
        block->stripe[i] = 0;
        block->code[i] = 0;
        if (rays->part[i] != EMPTY)
            block->code[i] = (uint32_t)((int)scene->target.part[rays->part[i]].first_surface + (int)rays->face[i] + 1) << 16;
    }
    choose_shaded(block, step, wanted);
    for (int i = 0; i < rays->count; i++) {
        if (scene->dark) wanted[i] &= near[i];
        if (rays->part[i] == EMPTY && wanted[i] && !scene->dark)
            add(block, 0, i, sky(scene, scene->stand + block->time[i], (Vector){rays->dx[i], rays->dy[i], rays->dz[i]},
                                 block->code + i));
    }
    if (scene->dark && !lasers) return;
    complete_hits(&scene->target, rays, wanted, hits);
    find_views(scene->light.angle_per_px, size, block, width);
    find_coatings(&scene->target, width, hits);
    for (int i = 0; i < hits->count; i++)
        if (hits->second[i]) block->code[hits->ray[i]] |= SECOND;
    if (!scene->dark) add_ambient(scene, block);
    if (!lasers) return;
    block->sources |= lasers << 1;
    for (int i = 0; i < hits->count; i++) {
        block->cx[i] = block->x[hits->ray[i]], block->cy[i] = block->y[hits->ray[i]];
        block->depth[i] = hits->parameter[i];
    }
    for (int k = 0; k < scene->lasers; k++)
        if (lasers >> k & 1) add_laser(scene, k, block);
}

typedef struct {
    const double *x, *y;           /* ray (x, y, 1) of each pixel */
    const double *per_px[2][2];    /* its derivatives along the row and the column */
    size_t pixels;
    int width;
} PixelRays;

/* Parts that a cone around the rays may meet, as far as their bounds show, at the first, the middle or the last
   time. */
static void parts_near(const Scene *scene, const Block *block, Choice *choice) {
    double left = INFINITY, right = -INFINITY, top = INFINITY, bottom = -INFINITY, cosine = 1, length2 = 1;
    choice->count = 0;
    for (int i = 0; i < block->rays.count; i++) {
        const double x = block->middle_x[i], y = block->middle_y[i];
        left = lesser(left, x), right = greater(right, x), top = lesser(top, y), bottom = greater(bottom, y);
    }
    const Vector axis = unit((Vector){(left + right) / 2, (top + bottom) / 2, 1});
    for (int i = 0; i < 4; i++) {
        const Vector corner = {i % 2 ? left : right, i / 2 ? top : bottom, 1};
        cosine = lesser(cosine, dot(axis, unit(corner)));
        length2 = greater(length2, dot(corner, corner));
    }
    const double slope = sqrt(greater(1 - cosine * cosine, 0)) / cosine + scene->light.angle_per_px;
    Bundle bundle[3];
    const int times = scene->times == 1 ? 1 : 3;
    for (int k = 0; k < times; k++) {
        const Stand *stand = scene->stand + k * (scene->times - 1) / 2;
        bundle[k] = (Bundle){stand->eye, rotated_back(stand->rotation, axis), 0, slope, EVERYWHERE_M};
    }
    choice->length = sqrt(length2) + scene->light.angle_per_px;
    for (int i = 0; i < scene->target.parts; i++) {
        double enter = INFINITY;
        for (int k = 0; k < times; k++) enter = lesser(enter, bundle_enters(scene->target.part + i, bundle + k));
        if (enter < INFINITY) choose(choice, i, greater(enter - scene->moved, 0));
    }
}

static double reversed(int number, int base) {
    double share = 1, sum = 0;
    for (; number; number /= base) sum += (share /= base) * (number % base);
    return sum;
}

/* The rays of one sample of each pixel in the camera frame, and what is drawn for it.

   The samples are a Hammersley set. Rows are the same in all pixels, so that the profile of a stripe is integrated by
   the midpoint rule; everything else is shifted cyclically from pixel to pixel, so that edges show no banding. */
VECTOR_LOOP static void draw(int times, int sample, int samples, Block *restrict block) {
    const double column = (double)sample / samples, row_px = reversed(sample, 2) + 0.5 / samples - 0.5;
    const double when = reversed(sample, 3);
    const int count = block->rays.count;
    for (int i = 0; i < count; i++) {
        const int first = (int)(block->turn[i] * DISC);
        block->sun[i] = (first + sample) & (DISC - 1);
        block->earth[i] = (7 * first + 5 * sample + 3) & (DISC - 1);
        block->time[i] = samples > 1 ? (int)(fraction(when + block->other[i]) * times) : times / 2;
        block->x[i] = block->middle_x[i], block->y[i] = block->middle_y[i];
    }
    for (int i = 0; i < count && samples > 1; i++) {
        const double column_px = fraction(column + block->turn[i]) - 0.5;
        block->x[i] += column_px * block->per_px[0][0][i] + row_px * block->per_px[1][0][i];
        block->y[i] += column_px * block->per_px[0][1][i] + row_px * block->per_px[1][1][i];
    }
}

/* Directions of rays of one time. */
VECTOR_LOOP static void aim(const Stand *restrict stand, Block *restrict block) {
    const double *m = stand->rotation;
    const Vector eye = stand->eye;
    Rays *rays = &block->rays;
    const int count = rays->count;
    for (int i = 0; i < count; i++) {
        const double x = block->x[i], y = block->y[i];
        rays->ox[i] = eye.x, rays->oy[i] = eye.y, rays->oz[i] = eye.z;
        rays->dx[i] = m[0] * x + m[3] * y + m[6];
        rays->dy[i] = m[1] * x + m[4] * y + m[7];
        rays->dz[i] = m[2] * x + m[5] * y + m[8];
        rays->least[i] = 0, rays->best[i] = INFINITY, rays->own[i] = EMPTY;
    }
}

/* One sample of each pixel of a block: where its ray hits the target. */
static void cast_block(const Scene *scene, const Choice *parts, int sample, int samples, Block *block) {
    Rays *cast = &block->rays;
    draw(scene->times, sample, samples, block);
    aim(scene->stand + scene->times / 2, block);
    for (int i = 0; i < cast->count && samples > 1 && scene->times > 1; i++) {
        const Stand *stand = scene->stand + block->time[i];
        const Vector direction = rotated_back(stand->rotation, (Vector){block->x[i], block->y[i], 1});
        cast->ox[i] = stand->eye.x, cast->oy[i] = stand->eye.y, cast->oz[i] = stand->eye.z;
        cast->dx[i] = direction.x, cast->dy[i] = direction.y, cast->dz[i] = direction.z;
    }
    intersect(&scene->target, parts, cast);
}

/* The rays through the middle of each pixel of a block, and its shifts. */
static void begin_block(const PixelRays *rays, int samples, int entries, Block *block) {
    const int count = block->rays.count;
    for (int k = 0; k < entries; k++) {
        memset(block->sum[k], 0, sizeof block->sum[k]);
        memset(block->count[k], 0, sizeof block->count[k]);
        memset(block->shaded[k], 0, sizeof block->shaded[k]);
    }
    for (int i = 0; i < count; i++) {
        block->middle_x[i] = rays->x[block->pixel[i]], block->middle_y[i] = rays->y[block->pixel[i]];
        block->turn[i] = fraction(0.7548776662 * block->column[i] + 0.5698402910 * block->row[i]);
        block->other[i] = fraction(0.8191725134 * block->column[i] + 0.6710436067 * block->row[i]);
    }
    for (int k = 0; k < 4 && samples > 1; k++)
        for (int i = 0; i < count; i++) block->per_px[k / 2][k % 2][i] = rays->per_px[k / 2][k % 2][block->pixel[i]];
    block->sources = 1;
}

/* Writes the mean radiance of the samples. */
static void end_block(const Scene *scene, const Block *block, int samples, int step, int all, size_t pixels,
                      float *radiance, uint32_t *code, uint8_t *stripe) {
    const int count = block->rays.count;
    for (int k = 0; k <= scene->lasers; k++) {
        float *of_source = radiance + (size_t)k * pixels;
        if (all && !(block->sources >> k & 1)) continue; /* it is 0 already */
        for (int i = 0; i < count; i++) {
            double sum = block->sum[0][k][i];
            if (step > 1) sum = 0;
            for (int entry = 0; step > 1 && entry < ENTRIES && block->count[entry][i] > 0; entry++)
                sum += (double)block->count[entry][i] / block->shaded[entry][i] * block->sum[entry][k][i];
            of_source[block->pixel[i]] = (float)(sum / samples);
        }
    }
    for (int i = 0; i < count && code; i++) code[block->pixel[i]] = block->code[i];
    for (int i = 0; i < count && stripe; i++) stripe[block->pixel[i]] = block->stripe[i];
}

/* The next pixels of an image, or of those chosen, as a block. */
static int next_pixels(const PixelRays *rays, const int64_t *chosen, size_t count, size_t *next, Block *block) {
    const uint32_t width = (uint32_t)rays->width;
    int entries = 0;
    for (; *next < count && entries < BATCH; ++*next, ++entries) {
        const uint32_t at = chosen ? (uint32_t)chosen[*next] : (uint32_t)*next;
        block->pixel[entries] = at;
        block->row[entries] = (int32_t)(at / width);
        block->column[entries] = (int32_t)(at % width);
    }
    return entries;
}

__attribute__((noinline)) /* inlined, gcc's warnings of its loops are false */
static void render_all(const Scene *scene, const PixelRays *rays, const int64_t *chosen, size_t count, int samples,
                       int step, float *radiance, uint32_t *code, uint8_t *stripe) {
    Block block;
    Choice parts;
    for (size_t next = 0; (block.rays.count = next_pixels(rays, chosen, count, &next, &block)) > 0;) {
        begin_block(rays, samples, step == 1 ? 1 : ENTRIES, &block);
        parts_near(scene, &block, &parts);
        for (int sample = 0; sample < samples; sample++) {
            cast_block(scene, &parts, sample, samples, &block);
            shade(scene, 1 / sqrt(samples), step, &block);
        }
        end_block(scene, &block, samples, step, !chosen, rays->pixels, radiance, code, stripe);
    }
}

/* The arguments that describe a target; those of a function follow. */
#define TARGET \
    {"parts", FLOAT64, {ANY, NUMBERS(Part)}}, {"points", FLOAT64, {ANY, 2}}, {"gaps", FLOAT64, {ANY, NUMBERS(Gap)}}, \
        {"forms", FLOAT64, {ANY, NUMBERS(Form)}}, {"material_of", INT32, {ANY}}, \
        {"materials", FLOAT64, {ANY, NUMBERS(Material)}}, {"print_x", FLOAT64, {ANY}}, {"print_y", FLOAT64, {ANY}}, \
        {"print", UINT8, {ANY, ANY}}, {"texels", FLOAT64, {K, 2}}, {"heights", FLOAT32, {K, RELIEF_TEXELS, RELIEF_TEXELS}}, \
        {"slopes", FLOAT32, {K, RELIEF_TEXELS, RELIEF_TEXELS, 2}}
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

/* The arguments that describe light, placements and rays; they follow those of the target. */
#define VIEW \
    {"poses", FLOAT64, {ANY, 12}}, {"lamps", FLOAT64, {LAMPS, NUMBERS(Lamp)}}, {"lasers", FLOAT64, {ANY, NUMBERS(Laser)}}, \
        {"light", &SceneLight_record, {0}}, {"xy", FLOAT64, {2, N}}, {"?per_px", FLOAT64, {2, 2, N}}, \
        {"width", WHOLE, {1, 1 << 30}}, {"?pixels", INT64, {ANY}}
enum { AFTER_VIEW = AFTER_TARGET + 8 };

typedef struct {
    PixelRays rays;
    const int64_t *chosen; /* NULL: all pixels */
    size_t count;
} Pixels;

/* The scene and the chosen pixels; NULL and an exception if the arguments do not fit each other. */
static Scene *open_scene(const Arguments *arguments, Pixels *pixels) {
    const Py_buffer *view = arguments->view + AFTER_TARGET;
    const Number(*number)[MAX_NUMBERS] = arguments->number + AFTER_TARGET;
    const size_t all = (size_t)view[4].shape[1];
    const double *xy = view[4].buf, *per_px = view[5].obj ? view[5].buf : NULL;
    Scene *scene = calloc(1, sizeof *scene);
    if (!scene) return (Scene *)PyErr_NoMemory();
    *pixels = (Pixels){{xy, xy + all, {{NULL, NULL}, {NULL, NULL}}, all, (int)number[6][0].whole},
                       view[7].obj ? view[7].buf : NULL, view[7].obj ? (size_t)view[7].shape[0] : all};
    int fits = open_target(arguments, &scene->target) &&
               require(view[0].shape[0] >= 1 && view[0].shape[0] <= MAX_TIMES && view[2].shape[0] <= MAX_LASERS,
                       "there are too many poses or lasers");
    for (size_t i = 0; fits && pixels->chosen && i < pixels->count; i++)
        fits = require(pixels->chosen[i] >= 0 && (size_t)pixels->chosen[i] < all, "a pixel is outside the image");
    if (!fits) {
        free(scene);
        return NULL;
    }
    for (int i = 0; per_px && i < 4; i++) pixels->rays.per_px[i / 2][i % 2] = per_px + (size_t)i * all;
    memcpy(&scene->light, number[3], sizeof(SceneLight));
    memcpy(scene->lamp, view[1].buf, sizeof scene->lamp);
    scene->times = (int)view[0].shape[0];
    scene->lasers = (int)view[2].shape[0];
    for (Py_ssize_t i = 0; i < arguments->view[9].shape[0]; i++)
        scene->relief = greater(scene->relief, 2 * scene->target.texel[i][1]);
    memcpy(scene->laser, view[2].buf, (size_t)scene->lasers * sizeof(Laser));
    for (int i = 0; i < scene->lasers; i++)
        scene->bend = greater(scene->bend, fabs(scene->laser[i].bow) * pow(scene->light.fan_rad / 2, 2));
    for (int i = 0; i < scene->lasers; i++)
        scene->baseline = greater(scene->baseline, sqrt(dot(scene->laser[i].projector, scene->laser[i].projector)));
    scene->dark = !(scene->light.ambient_w_m2 > 0 || scene->light.sun_w_m2 > 0 || scene->light.earth_w_m2 > 0);
    for (int i = 0; i < scene->times; i++) place(scene, scene->stand + i, (const double *)view[0].buf + 12 * i);
    const Stand *begin = scene->stand, *end = scene->stand + scene->times - 1;
    const Vector eye = minus(end->eye, begin->eye);
    scene->moved = sqrt(dot(eye, eye));
    for (int i = 0; i < scene->lasers; i++) {
        const Vector moved = minus(end->projector[i], begin->projector[i]);
        scene->moved = greater(scene->moved, sqrt(dot(moved, moved)));
    }
    return scene;
}

PyObject *call_render(PyObject *module, PyObject *tuple) {
    static const Parameter parameter[] = {
        TARGET, VIEW, {"samples", WHOLE, {1, 1 << 16}}, {"step", WHOLE, {1, 1 << 16}}, {">radiance", FLOAT32, {ANY, N}},
        {">?code", INT32, {N}}, {">?stripe", UINT8, {N}}};
    Arguments arguments;
    Pixels pixels;
    (void)module;
    if (!OPEN(tuple, parameter, &arguments)) return NULL;
    const Py_buffer *view = arguments.view + AFTER_VIEW;
    const int samples = (int)arguments.number[AFTER_VIEW][0].whole;
    const int step = (int)arguments.number[AFTER_VIEW + 1][0].whole;
    Scene *scene = open_scene(&arguments, &pixels);
    const int fits = scene && require(view[2].shape[0] == scene->lasers + 1 && (pixels.rays.per_px[0][0] || samples == 1),
                                      "lasers, samples and radiance do not fit each other");
    if (fits) {
        const int is_printed = scene->target.columns * scene->target.rows > 1; /* then shade all: there are its edges */
        Py_BEGIN_ALLOW_THREADS render_all(scene, &pixels.rays, pixels.chosen, pixels.count, samples,
                                          is_printed ? 1 : step, view[2].buf, view[3].obj ? view[3].buf : NULL,
                                          view[4].obj ? view[4].buf : NULL);
        Py_END_ALLOW_THREADS
    }
    free(scene);
    return close_arguments(&arguments, fits ? Py_NewRef(Py_None) : NULL);
}

PyObject *call_hits(PyObject *module, PyObject *tuple) {
    static const Parameter parameter[] = {TARGET,
                                          {"origin", FLOAT64, {3, N}},
                                          {"direction", FLOAT64, {3, N}},
                                          {">parameter", FLOAT64, {N}},
                                          {">surface", INT32, {N}},
                                          {">point", FLOAT64, {3, N}},
                                          {">normal", FLOAT64, {3, N}}};
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
    Rays rays;
    Hits hits;
    Choice all = {.length = INFINITY};
    for (int i = 0; i < target.parts; i++) choose(&all, i, 0);
    for (size_t start = 0; start < n; start += BATCH) {
        rays.count = (int)(n - start < BATCH ? n - start : BATCH);
        for (int i = 0; i < rays.count; i++) {
            const size_t at = start + (size_t)i;
            const Vector to = {direction[at], direction[n + at], direction[2 * n + at]};
            rays.ox[i] = origin[at], rays.oy[i] = origin[n + at], rays.oz[i] = origin[2 * n + at];
            rays.dx[i] = to.x, rays.dy[i] = to.y, rays.dz[i] = to.z;
            rays.least[i] = MIN_DISTANCE_M / sqrt(dot(to, to)), rays.best[i] = INFINITY, rays.own[i] = EMPTY;
            surface[at] = EMPTY;
            for (size_t k = 0; k < 3; k++) point[k * n + at] = normal[k * n + at] = NAN;
        }
        intersect(&target, &all, &rays);
        complete_hits(&target, &rays, NULL, &hits);
        for (int i = 0; i < rays.count; i++) parameters[start + (size_t)i] = rays.best[i];
        for (int i = 0; i < hits.count; i++) {
            const size_t at = start + (size_t)hits.ray[i];
            surface[at] = hits.surface[i];
            point[at] = hits.x[i], point[n + at] = hits.y[i], point[2 * n + at] = hits.z[i];
            normal[at] = hits.nx[i], normal[n + at] = hits.ny[i], normal[2 * n + at] = hits.nz[i];
        }
    }
    return close_arguments(&arguments, Py_NewRef(Py_None));
}

/* Bits by which codes differ from those of the eight neighbours of each pixel; `code` has a border of one pixel. */
VECTOR_LOOP static void find_changes(const int32_t *restrict code, Py_ssize_t width, int32_t shadows,
                                     uint8_t *restrict edge) {
    const int32_t *above = code - width - 2, *below = code + width + 2;
    for (Py_ssize_t i = 0; i < width; i++) {
        const int32_t own = code[i];
        const int32_t changes = (own ^ code[i - 1]) | (own ^ code[i + 1]) | (own ^ above[i - 1]) | (own ^ above[i]) |
                                (own ^ above[i + 1]) | (own ^ below[i - 1]) | (own ^ below[i]) | (own ^ below[i + 1]);
        edge[i] = (uint8_t)((changes != 0) + ((changes & ~shadows) != 0));
    }
}

PyObject *call_code_edges(PyObject *module, PyObject *tuple) {
    static const Parameter parameter[] = {{"code", INT32, {ANY, ANY}}, {">edge", UINT8, {N, M}}};
    Arguments arguments;
    (void)module;
    if (!OPEN(tuple, parameter, &arguments)) return NULL;
    const Py_buffer *view = arguments.view;
    const Py_ssize_t height = view[1].shape[0], width = view[1].shape[1];
    if (!require(view[0].shape[0] == height + 2 && view[0].shape[1] == width + 2, "the codes have no border"))
        return close_arguments(&arguments, NULL);
    for (Py_ssize_t i = 0; i < height; i++)
        find_changes((const int32_t *)view[0].buf + (i + 1) * (width + 2) + 1, width, SUN_SHADOW | EARTH_SHADOW,
                     (uint8_t *)view[1].buf + i * width);
    return close_arguments(&arguments, Py_NewRef(Py_None));
}
