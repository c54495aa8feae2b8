/* Ray casting of a target made of parts: tables as NumPy passes them, and what the sources share.

   Points and directions are in the target frame, in metres, unless a name states otherwise. */
#ifndef RINGPOSE_RENDER_TARGET_H
#define RINGPOSE_RENDER_TARGET_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "kernels.h"

enum { BOX, REVOLUTION };
enum { EMPTY = -1 };
enum { WIDE = 1, THIN = 2 }; /* bits of a pixel near a stripe */
enum { FORM_ORDERS = 3, FIRST_ORDER = 2, RELIEF_TEXELS = 512, MAX_POINTS = 64, MAX_PARTS = 128, MAX_LASERS = 8, BATCH = 64 };

/* Minimum roughness: a smoother surface would reflect a projector as a point. */
#define MIN_ROUGHNESS 0.02f

typedef struct {
    double x, y, z;
} Vector;

/* A row of the table of parts; every entry is a double, also the indices. */
typedef struct {
    double kind;
    double rotation[9]; /* part_from_target */
    Vector origin;      /* of the part frame */
    Vector low, high; /* corners of a box; of a surface of revolution, bounds (radius, z of the profile, z) with its form */
    double first_surface;
    double first_point, points; /* of the profile of a surface of revolution */
    double first_gap, gaps;
    double form;   /* row of the table of forms, or -1 */
    double relief; /* row of the table of reliefs, on the faces of a box, or -1 */
    Vector center; /* of the bounding sphere */
    double radius;
} Part;

/* A slot of parallel walls across a ring: cut above `floor` where |across| < half_width, on the side of
   (cosine, sine). */
typedef struct {
    double cosine, sine, half_width, floor;
} Gap;

/* Fourier coefficients (order, cosine and sine) of the deviations of inner edge, outer edge and face. */
typedef struct {
    double inner[FORM_ORDERS][2], outer[FORM_ORDERS][2], axial[FORM_ORDERS][2];
    double radius_inner, radius_outer;
} Form;

/* Lambert's law plus one GGX lobe; `cell` and `line`: a grid of lines of the second coating; `printed`: the board. */
typedef struct {
    double diffuse, specular, roughness;
} Coating;

typedef struct {
    Coating coating, second;
    double cell_x, cell_y, line; /* cell_x = 0: no grid */
    double printed;
} Material;

typedef struct {
    const Part *part;
    int parts;
    const double (*point)[2]; /* radius, height */
    const Gap *gap;
    const Form *form;
    const int32_t *material_of; /* of each surface */
    const Material *material;
    const double *print_x, *print_y; /* lines at which the print changes */
    int columns, rows;
    const uint8_t *print; /* 1 where the second coating is */
    const double (*texel)[2]; /* of the reliefs: side of a texel, and the largest height */
    const float *height; /* of the reliefs, row by row */
    const float *slope;  /* pairs (along u, along v) */
} Target;

/* Rays in the target frame, in arrays, so that loops over them become vector instructions. */
typedef struct {
    int count;
    double ox[BATCH], oy[BATCH], oz[BATCH], dx[BATCH], dy[BATCH], dz[BATCH];
    double least[BATCH]; /* smallest parameter of an intersection that counts */
    double best[BATCH];  /* largest one that counts; then that of the nearest intersection */
    double face[BATCH];
    int32_t part[BATCH]; /* with the nearest intersection, or EMPTY */
    int32_t own[BATCH];  /* convex part that the ray leaves, or EMPTY */
} Rays;

/* Some of the parts, by the distance at which rays can meet them first; no ray's direction is longer than `length`. */
typedef struct {
    int count, part[MAX_PARTS];
    double enter[MAX_PARTS], length;
} Choice;

/* Rays: at a distance t from a point along the axis, up to `reach`, they are within radius + t slope of the axis, and
   they begin within the radius of the point. */
typedef struct {
    Vector middle, axis;
    double radius, slope, reach;
} Bundle;

/* Where rays hit surfaces, sorted by surface. */
typedef struct {
    int count;
    int32_t ray[BATCH + 1]; /* its number in the rays; one more is written */
    double ox[BATCH], oy[BATCH], oz[BATCH], dx[BATCH], dy[BATCH], dz[BATCH]; /* the ray */
    double best[BATCH];                                                      /* where it meets the flat surface */
    int32_t part[BATCH], surface[BATCH], second[BATCH]; /* second: where the print has the second coating */
    double parameter[BATCH];                            /* on the relief */
    double x[BATCH], y[BATCH], z[BATCH], u[BATCH], v[BATCH]; /* point, and its place on the face of a box */
    double below[BATCH];                                     /* depth under the surface without its relief */
    double nx[BATCH], ny[BATCH], nz[BATCH];                  /* normal towards the viewer */
    double fx[BATCH], fy[BATCH], fz[BATCH];                  /* normal without the relief */
    float diffuse[BATCH], specular[BATCH], roughness[BATCH];
} Hits;

/* As fmin, fmax and floor for numbers that are no NaN, without a call. */
static inline double lesser(double a, double b) { return a < b ? a : b; }
static inline double greater(double a, double b) { return a > b ? a : b; }
static inline int32_t whole(double a) {
    const int32_t truncated = (int32_t)a;
    return truncated - (a < (double)truncated);
}

static inline Vector plus(Vector a, Vector b) { return (Vector){a.x + b.x, a.y + b.y, a.z + b.z}; }
static inline Vector minus(Vector a, Vector b) { return (Vector){a.x - b.x, a.y - b.y, a.z - b.z}; }
static inline Vector times(double s, Vector a) { return (Vector){s * a.x, s * a.y, s * a.z}; }
static inline double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline Vector cross(Vector a, Vector b) {
    return (Vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
static inline Vector unit(Vector a) { return times(1 / sqrt(dot(a, a)), a); }
static inline Vector rotated(const double m[9], Vector a) {
    return (Vector){m[0] * a.x + m[1] * a.y + m[2] * a.z, m[3] * a.x + m[4] * a.y + m[5] * a.z,
                    m[6] * a.x + m[7] * a.y + m[8] * a.z};
}
static inline Vector rotated_back(const double m[9], Vector a) {
    return (Vector){m[0] * a.x + m[3] * a.y + m[6] * a.z, m[1] * a.x + m[4] * a.y + m[7] * a.z,
                    m[2] * a.x + m[5] * a.y + m[8] * a.z};
}

/* Lower bound of the distance at which a ray of a bundle can meet a part, from its bounds; INFINITY if none can. */
double bundle_enters(const Part *part, const Bundle *bundle);

/* Inserts a part where it belongs in the order of distances. */
void choose(Choice *choice, int part, double enter);

/* Nearest intersections of the rays with the chosen parts; parts that no ray can hit cost little. */
void intersect(const Target *target, const Choice *choice, Rays *rays);

/* Points and normals of the rays that have hit a part, and of which `wanted` is not 0 (NULL: of all). */
void complete_hits(const Target *target, const Rays *rays, const uint8_t *wanted, Hits *hits);

/* The coatings at the hits, averaged over squares of the given widths. */
void find_coatings(const Target *target, const double width[BATCH], Hits *hits);

/* A coating's BRDF for the sine squared and the cosine of the angle between its normal and the bisector of light and
   eye, and the cosines of the angles of the light with its normal, of the eye with its normal and with the bisector.
   Lambert plus GGX with Smith shadowing and the Fresnel term of Schlick. */
static inline float reflectance(float diffuse, float specular, float roughness, float sine2, float n_light, float n_eye,
                                float half_eye) {
    const float pi = 3.14159265f, rough = roughness > MIN_ROUGHNESS ? roughness : MIN_ROUGHNESS;
    const float light = n_light > 1e-4f ? n_light : 1e-4f, eye = n_eye > 1e-4f ? n_eye : 1e-4f;
    const float alpha2 = rough * rough, lobe = sine2 + (1 - sine2) * alpha2;
    const float grazing = 1 - (half_eye > 0 ? half_eye < 1 ? half_eye : 1 : 0), grazing2 = grazing * grazing;
    const float fresnel = specular + (1 - specular) * grazing2 * grazing2 * grazing;
    const float smith = (light + sqrtf(alpha2 + (1 - alpha2) * light * light)) *
                        (eye + sqrtf(alpha2 + (1 - alpha2) * eye * eye));
    const float glossy = alpha2 * fresnel / (pi * lobe * lobe * smith);
    return diffuse / pi + (specular > 0 ? glossy : 0);
}

/* A coating's BRDF for unit vectors: normal, towards the light, towards the eye. */
static inline float brdf(float diffuse, float specular, float roughness, float nx, float ny, float nz, float lx, float ly,
                         float lz, float ex, float ey, float ez) {
    const float sx = lx + ex, sy = ly + ey, sz = lz + ez, square = sx * sx + sy * sy + sz * sz;
    const float scale = 1 / sqrtf(square > 1e-18f ? square : 1e-18f), hx = scale * sx, hy = scale * sy, hz = scale * sz;
    const float ax = nx - hx, ay = ny - hy, az = nz - hz, apart = ax * ax + ay * ay + az * az; /* 2 (1 - cosine) */
    const float behind = nx * hx + ny * hy + nz * hz < 1e-4f;
    return reflectance(diffuse, specular, roughness, behind ? 1 : apart * (1 - apart / 4), nx * lx + ny * ly + nz * lz,
                       nx * ex + ny * ey + nz * ez, hx * ex + hy * ey + hz * ez);
}

#endif
