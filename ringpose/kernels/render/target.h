/* Ray casting of a target made of parts: tables as NumPy passes them, and what the sources share.

   Points and directions are in the target frame, in metres, unless a name says otherwise. */
#ifndef RINGPOSE_RENDER_TARGET_H
#define RINGPOSE_RENDER_TARGET_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

enum { BOX, REVOLUTION };
enum { EMPTY = -1 };
enum { FORM_ORDERS = 3, FIRST_ORDER = 2, RELIEF_TEXELS = 512, MAX_POINTS = 64, MAX_PARTS = 128, MAX_LASERS = 8 };

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

/* A slot of parallel walls across a ring: cut above `floor` where |across| < half_width, on the side of (cosine, sine). */
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
    const double *texel;
    const float *height; /* of the reliefs, row by row */
    const float *slope;  /* pairs (along u, along v) */
} Target;

typedef struct {
    double parameter;
    int part, face, surface;
    Vector point, flat; /* on the relief, and on the surface without it */
    Vector normal, flat_normal; /* towards the viewer */
    double u, v;                /* on the face of a box */
} Hit;

/* As fmin, fmax and floor for numbers that are no NaN, without a call. */
static inline double lesser(double a, double b) { return a < b ? a : b; }
static inline double greater(double a, double b) { return a > b ? a : b; }
static inline int64_t whole(double a) {
    const int64_t truncated = (int64_t)a;
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

/* Whether the bounding sphere of a part meets the ray between 0 and `limit`. */
int near_ray(const Part *part, Vector origin, Vector direction, double limit);

/* The nearest intersection of a ray with the chosen parts; 0 if there is none. The part chosen[guess], which the ray
   probably hits, is tried first; `guess` may be count. */
int first_hit(const Target *target, const int *chosen, int count, int guess, Vector origin, Vector direction, Hit *hit);

/* Completes a hit: points, normals and coordinates on the surface. */
void complete_hit(const Target *target, Vector origin, Vector direction, Hit *hit);

/* Whether one of the chosen parts intersects the segment from `point` to `point` + `towards`; `own`: a convex part to
   leave out, or EMPTY. */
int blocked(const Target *target, const int *chosen, int count, int own, Vector point, Vector towards);

/* Radiance per irradiance of a coating: BRDF times cosine is left to the caller. */
double reflectance(Coating coating, Vector normal, Vector to_light, Vector to_eye);

/* The coating at a hit, averaged over a square of the width `footprint`; sets `second` where the print has the second. */
Coating coating_at(const Target *target, const Hit *hit, double footprint, int *second);

#endif
