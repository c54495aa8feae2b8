/* Intersections of rays with boxes and surfaces of revolution, in closed form, and points and normals there. */
#include "target.h"

enum { FORM_STEPS = 4, RELIEF_STEPS = 2 };

/* Instead of 0 as a component of a direction: its reciprocal is finite. */
static const double TINY = 1e-300;

static int is_aligned(const Part *part) {
    return part->rotation[0] == 1 && part->rotation[4] == 1 && part->rotation[8] == 1;
}

/* Narrows the distances at which rays may be between two planes, for coordinates o +- radius and d +- spread. */
static void clip(double low, double high, double o, double d, double radius, double spread, double *enter, double *leave) {
    const double to_low = low - radius - o, to_high = high + radius - o, least = d - spread, most = d + spread;
    if (to_low > 0) {
        *enter = most > 0 ? greater(*enter, to_low / most) : INFINITY;
        if (least > 0) *leave = lesser(*leave, to_high / least);
    } else if (to_high < 0) {
        *enter = least < 0 ? greater(*enter, to_high / least) : INFINITY;
        if (most < 0) *leave = lesser(*leave, to_low / most);
    } else {
        if (least > 0) *leave = lesser(*leave, to_high / least);
        if (most < 0) *leave = lesser(*leave, to_low / most);
    }
}

double bundle_enters(const Part *part, const Bundle *bundle) {
    const double radius = bundle->radius, slope = bundle->slope, both = part->radius + radius;
    const Vector to = minus(part->center, bundle->middle);
    const double along = dot(to, bundle->axis), aside2 = dot(to, to) - along * along;
    const double within = both + greater(along + both, 0) * slope;
    if (along < -both || along - both > bundle->reach || aside2 > within * within) return INFINITY;
    const Vector o = rotated(part->rotation, minus(bundle->middle, part->origin)), d = rotated(part->rotation, bundle->axis);
    const int round = part->kind == REVOLUTION;
    const double least = round ? -part->high.x : part->low.y, most = round ? part->high.x : part->high.y;
    double enter = 0, leave = bundle->reach;
    clip(part->low.z, part->high.z, o.z, d.z, radius, slope, &enter, &leave);
    clip(round ? least : part->low.x, part->high.x, o.x, d.x, radius, slope, &enter, &leave);
    clip(least, most, o.y, d.y, radius, slope, &enter, &leave);
    if (enter > leave) return INFINITY;
    if (round) { /* through the hole: the farthest point of the axis is at one of the ends */
        const double room = part->low.x - radius - leave * slope, near_x = o.x + enter * d.x, near_y = o.y + enter * d.y;
        const double far_x = o.x + leave * d.x, far_y = o.y + leave * d.y;
        if (room > 0 && greater(near_x * near_x + near_y * near_y, far_x * far_x + far_y * far_y) < room * room)
            return INFINITY;
    }
    return greater(enter - radius, 0);
}

/* Rays in the frame of a part; `ray` is the number of each in the rays of the target. */
typedef struct {
    int count;
    int32_t ray[BATCH];
    double ox[BATCH], oy[BATCH], oz[BATCH], dx[BATCH], dy[BATCH], dz[BATCH], least[BATCH], best[BATCH], face[BATCH];
} Near;

VECTOR_LOOP static void copy_rays(const Part *restrict part, const Rays *restrict rays, Near *restrict near) {
    const Part moved = *part;
    const double *m = moved.rotation;
    const int count = near->count = rays->count;
    for (int i = 0; i < count; i++) {
        const double ox = rays->ox[i] - moved.origin.x, oy = rays->oy[i] - moved.origin.y;
        const double oz = rays->oz[i] - moved.origin.z, dx = rays->dx[i], dy = rays->dy[i], dz = rays->dz[i];
        const double ax = m[0] * dx + m[1] * dy + m[2] * dz, ay = m[3] * dx + m[4] * dy + m[5] * dz;
        const double az = m[6] * dx + m[7] * dy + m[8] * dz;
        near->ray[i] = i;
        near->ox[i] = m[0] * ox + m[1] * oy + m[2] * oz;
        near->oy[i] = m[3] * ox + m[4] * oy + m[5] * oz;
        near->oz[i] = m[6] * ox + m[7] * oy + m[8] * oz;
        near->dx[i] = ax == 0 ? TINY : ax;
        near->dy[i] = ay == 0 ? TINY : ay;
        near->dz[i] = az == 0 ? TINY : az;
        near->least[i] = rays->least[i];
        near->best[i] = rays->best[i];
        near->face[i] = EMPTY;
    }
}

/* Faces of a box: 0 z+, 1 x-, 2 x+, 3 y-, 4 y+, 5 z-. */
VECTOR_LOOP static void hit_box(const Part *restrict part, Near *restrict near) {
    const Vector low = part->low, high = part->high;
    for (int i = 0; i < near->count; i++) {
        const double by_x = 1 / near->dx[i], by_y = 1 / near->dy[i], by_z = 1 / near->dz[i];
        const double x_1 = (low.x - near->ox[i]) * by_x, x_2 = (high.x - near->ox[i]) * by_x;
        const double y_1 = (low.y - near->oy[i]) * by_y, y_2 = (high.y - near->oy[i]) * by_y;
        const double z_1 = (low.z - near->oz[i]) * by_z, z_2 = (high.z - near->oz[i]) * by_z;
        const double x_in = lesser(x_1, x_2), y_in = lesser(y_1, y_2), z_in = lesser(z_1, z_2);
        const double leave = lesser(lesser(greater(x_1, x_2), greater(y_1, y_2)), greater(z_1, z_2));
        const double enter = greater(greater(x_in, y_in), z_in);
        const double face_x = by_x < 0 ? 2 : 1, face_y = by_y < 0 ? 4 : 3, face_z = by_z > 0 ? 5 : 0;
        const double face = enter == x_in ? face_x : enter == y_in ? face_y : face_z;
        const int hit = (enter <= leave) & (enter >= near->least[i]) & (enter < near->best[i]);
        near->best[i] = hit ? enter : near->best[i];
        near->face[i] = hit ? face : near->face[i];
    }
}

static double wave(const double order[FORM_ORDERS][2], double angle) {
    double sum = 0;
    for (int i = 0; i < FORM_ORDERS; i++)
        sum += order[i][0] * cos((FIRST_ORDER + i) * angle) + order[i][1] * sin((FIRST_ORDER + i) * angle);
    return sum;
}

static int in_gap(const Target *target, const Part *part, double x, double y, double z) {
    const Gap *gap = target->gap + (int)part->first_gap;
    for (int i = 0; i < (int)part->gaps; i++, gap++)
        if (z > gap->floor && x * gap->cosine + y * gap->sine > 0 &&
            fabs(y * gap->cosine - x * gap->sine) < gap->half_width)
            return 1;
    return 0;
}

/* Where rays hit a piece of a profile (an annulus), or a cylinder or a cone twice; INFINITY where they do not. */
VECTOR_LOOP static void meet_annulus(const double first[2], const double second[2], const Near *restrict near,
                                     double *restrict one) {
    const double z = first[1], inner = lesser(first[0], second[0]), outer = greater(first[0], second[0]);
    const double inner2 = inner * inner, outer2 = outer * outer;
    for (int i = 0; i < near->count; i++) {
        const double t = (z - near->oz[i]) / near->dz[i];
        const double x = near->ox[i] + t * near->dx[i], y = near->oy[i] + t * near->dy[i], square = x * x + y * y;
        one[i] = (square >= inner2) & (square <= outer2) ? t : INFINITY;
    }
}

/* Roots of |xy|^2 = radius(z)^2 without cancellation. */
VECTOR_LOOP static void meet_cone(const double first[2], const double second[2], const Near *restrict near,
                                  double *restrict one, double *restrict other) {
    const double slope = (second[0] - first[0]) / (second[1] - first[1]), radius_1 = first[0], z_1 = first[1];
    const double low = lesser(first[1], second[1]), high = greater(first[1], second[1]);
    for (int i = 0; i < near->count; i++) {
        const double ox = near->ox[i], oy = near->oy[i], oz = near->oz[i];
        const double dx = near->dx[i], dy = near->dy[i], dz = near->dz[i], radius = radius_1 + slope * (oz - z_1);
        const double a = dx * dx + dy * dy - slope * slope * dz * dz, b = ox * dx + oy * dy - slope * dz * radius;
        const double c = ox * ox + oy * oy - radius * radius, under = b * b - a * c, size = sqrt(greater(under, 0));
        const double root = -(b + (b < 0 ? -size : size)), t = root / a, s = c / root;
        const double z_t = oz + t * dz, z_s = oz + s * dz;
        one[i] = (under >= 0) & (z_t >= low) & (z_t <= high) & (radius + slope * t * dz >= 0) ? t : INFINITY;
        other[i] = (under >= 0) & (z_s >= low) & (z_s <= high) & (radius + slope * s * dz >= 0) ? s : INFINITY;
    }
}

VECTOR_LOOP static void accept_all(const double *restrict parameter, int piece, Near *restrict near) {
    for (int i = 0; i < near->count; i++) {
        const int nearer = (parameter[i] > near->least[i]) & (parameter[i] < near->best[i]);
        near->best[i] = nearer ? parameter[i] : near->best[i];
        near->face[i] = nearer ? piece : near->face[i];
    }
}

static void accept(const Target *target, const Part *part, const double *parameter, int piece, Near *near) {
    if (part->gaps == 0) {
        accept_all(parameter, piece, near);
        return;
    }
    for (int i = 0; i < near->count; i++) {
        const double t = parameter[i];
        if (!(t > near->least[i] && t < near->best[i]) ||
            in_gap(target, part, near->ox[i] + t * near->dx[i], near->oy[i] + t * near->dy[i],
                   near->oz[i] + t * near->dz[i]))
            continue;
        near->best[i] = t;
        near->face[i] = piece;
    }
}

static void hit_profile(const Target *target, const Part *part, const double (*point)[2], Near *near) {
    double one[BATCH], other[BATCH];
    for (int piece = 0; piece + 1 < (int)part->points; piece++) {
        const double *first = point[piece], *second = point[piece + 1];
        if (first[1] == second[1]) {
            meet_annulus(first, second, near, one);
        } else {
            meet_cone(first, second, near, one, other);
            accept(target, part, other, piece, near);
        }
        accept(target, part, one, piece, near);
    }
}

/* Walls and floors of the gaps; they are the surface after the pieces of the profile. */
static void hit_gaps(const Target *target, const Part *part, Near *near, int i) {
    const double(*point)[2] = target->point + (int)part->first_point;
    const Gap *gap = target->gap + (int)part->first_gap;
    const int piece = (int)part->points - 1;
    double inner = INFINITY, outer = 0;
    for (int k = 0; k <= piece; k++) {
        inner = lesser(inner, point[k][0]);
        outer = greater(outer, point[k][0]);
    }
    const Vector o = {near->ox[i], near->oy[i], near->oz[i]}, d = {near->dx[i], near->dy[i], near->dz[i]};
    const double low = (part->low.y - o.z) / d.z, high = (part->high.y - o.z) / d.z; /* where it enters and leaves */
    const Vector enter = plus(o, times(low, d)), leave = plus(o, times(high, d));
    for (int k = 0; k < (int)part->gaps; k++, gap++) {
        const double one = enter.y * gap->cosine - enter.x * gap->sine;
        const double other = leave.y * gap->cosine - leave.x * gap->sine;
        if (lesser(one, other) > gap->half_width || greater(one, other) < -gap->half_width) continue;
        if (lesser(enter.x * gap->cosine + enter.y * gap->sine, leave.x * gap->cosine + leave.y * gap->sine) > outer)
            continue;
        const double across = o.y * gap->cosine - o.x * gap->sine, by_t = d.y * gap->cosine - d.x * gap->sine;
        for (int side = -1; side <= 2; side++) { /* the two walls, then the floor */
            const double t = side <= 1 ? (side * gap->half_width - across) / by_t : (gap->floor - o.z) / d.z;
            const int is_open = side == 2 && gap->floor <= part->low.y; /* through the whole ring */
            if (side == 0 || is_open || !(t > near->least[i] && t < near->best[i])) continue;
            const double x = o.x + t * d.x, y = o.y + t * d.y, z = o.z + t * d.z, square = x * x + y * y;
            const int within = side <= 1 ? z > greater(gap->floor, part->low.y) && z < part->high.y
                                         : fabs(y * gap->cosine - x * gap->sine) < gap->half_width;
            if (within && square > inner * inner && square < outer * outer && x * gap->cosine + y * gap->sine > 0) {
                near->best[i] = t;
                near->face[i] = piece;
            }
        }
    }
}

/* A ring that is out of round and warped: the profile is displaced by the deviations at the angle of the hit. */
static void hit_form(const Target *target, const Part *part, const double (*point)[2], Near *near, int i) {
    const Form *form = target->form + (int)part->form;
    double moved[MAX_POINTS][2], t = (part->high.y - near->oz[i]) / near->dz[i];
    Near one = {.count = 1, .ox = {near->ox[i]}, .oy = {near->oy[i]}, .oz = {near->oz[i]}, .dx = {near->dx[i]},
                .dy = {near->dy[i]}, .dz = {near->dz[i]}, .least = {near->least[i]}};
    for (int step = 0; step < FORM_STEPS; step++) {
        const double angle = atan2(one.oy[0] + t * one.dy[0], one.ox[0] + t * one.dx[0]);
        const double inner = wave(form->inner, angle), outer = wave(form->outer, angle), axial = wave(form->axial, angle);
        const double scale = form->radius_outer - form->radius_inner;
        for (int k = 0; k < (int)part->points; k++) {
            const double share = lesser(greater((point[k][0] - form->radius_inner) / scale, 0), 1);
            moved[k][0] = point[k][0] + inner + share * (outer - inner);
            moved[k][1] = point[k][1] + axial;
        }
        one.best[0] = near->best[i];
        one.face[0] = EMPTY;
        hit_profile(target, part, (const double(*)[2])moved, &one);
        if (one.face[0] == EMPTY) return;
        t = one.best[0];
    }
    near->best[i] = one.best[0];
    near->face[i] = one.face[0];
}

/* Which rays pass between the least and the greatest radius within the heights of a surface of revolution. */
VECTOR_LOOP static void find_passing(const Part *part, const Near *restrict near, int32_t *restrict passes) {
    const int count = near->count;
    const double least2 = part->low.x * part->low.x * (1 - 1e-12), greatest2 = part->high.x * part->high.x * (1 + 1e-12);
    const double low = part->low.z, high = part->high.z;
    for (int i = 0; i < count; i++) {
        const double ox = near->ox[i], oy = near->oy[i], dx = near->dx[i], dy = near->dy[i], by_z = 1 / near->dz[i];
        const double one = (low - near->oz[i]) * by_z, other = (high - near->oz[i]) * by_z;
        const double enter = greater(lesser(one, other), 0), leave = lesser(greater(one, other), 1e30);
        const double a = dx * dx + dy * dy, b = ox * dx + oy * dy, c = ox * ox + oy * oy;
        const double nearest = lesser(greater(-b / a, enter), leave), at_nearest = c + nearest * (2 * b + nearest * a);
        const double farthest = greater(c + enter * (2 * b + enter * a), c + leave * (2 * b + leave * a));
        const double within = lesser(greatest2 - at_nearest, farthest - least2);
        passes[i] = lesser(lesser(leave, near->best[i] - enter), within) >= 0; /* all of them */
    }
}

static void hit_revolution(const Target *target, const Part *part, Near *near) {
    const double(*point)[2] = target->point + (int)part->first_point;
    int32_t passes[BATCH];
    find_passing(part, near, passes);
    int count = 0;
    for (int i = 0; i < near->count; i++) {
        if (!passes[i]) continue;
        near->ray[count] = near->ray[i];
        near->ox[count] = near->ox[i], near->oy[count] = near->oy[i], near->oz[count] = near->oz[i];
        near->dx[count] = near->dx[i], near->dy[count] = near->dy[i], near->dz[count] = near->dz[i];
        near->least[count] = near->least[i], near->best[count] = near->best[i], near->face[count] = EMPTY;
        count++;
    }
    near->count = count;
    if (count == 0) return;
    if (part->form >= 0)
        for (int i = 0; i < count; i++) hit_form(target, part, point, near, i);
    else
        hit_profile(target, part, point, near);
    for (int i = 0; part->gaps > 0 && i < count; i++) hit_gaps(target, part, near, i);
}

static double farthest(const Rays *rays) {
    double best = 0;
    for (int i = 0; i < rays->count; i++) best = greater(best, rays->best[i]);
    return best;
}

void choose(Choice *choice, int part, double enter) {
    int at = choice->count++;
    for (; at > 0 && choice->enter[at - 1] > enter; at--) {
        choice->part[at] = choice->part[at - 1];
        choice->enter[at] = choice->enter[at - 1];
    }
    choice->part[at] = part;
    choice->enter[at] = enter;
}

void intersect(const Target *target, const Choice *choice, Rays *rays) {
    Near near;
    for (int i = 0; i < rays->count; i++) rays->part[i] = EMPTY;
    for (int k = 0; k < choice->count; k++) {
        const Part *part = target->part + choice->part[k];
        if (choice->enter[k] > 0 && choice->enter[k] > farthest(rays) * choice->length) break;
        copy_rays(part, rays, &near);
        if (part->kind == BOX)
            hit_box(part, &near);
        else
            hit_revolution(target, part, &near);
        for (int i = 0; i < near.count; i++) {
            const int ray = near.ray[i];
            if (near.face[i] == EMPTY || rays->own[ray] == choice->part[k]) continue;
            rays->best[ray] = near.best[i];
            rays->face[ray] = near.face[i];
            rays->part[ray] = choice->part[k];
        }
    }
}

/* The inverse of the frame of a box's face, whose w axis points out of it: u, v, w in the frame of the part. */
static Vector from_face(int face, Vector a) {
    switch (face) {
    case 0: return a;
    case 5: return (Vector){a.x, a.y, -a.z};
    case 1: return (Vector){-a.z, a.x, a.y};
    case 2: return (Vector){a.z, a.x, a.y};
    case 3: return (Vector){a.x, -a.z, a.y};
    default: return (Vector){a.x, a.z, a.y};
    }
}

static Vector in_target(const Part *part, Vector a) { return is_aligned(part) ? a : rotated_back(part->rotation, a); }

typedef struct {
    Vector origin, u, v, w; /* of the face */
    double texel;
    const float *height, *slope; /* NULL without a relief */
} Face;

static inline int texel_index(int column, int row) {
    return (row & (RELIEF_TEXELS - 1)) * RELIEF_TEXELS + (column & (RELIEF_TEXELS - 1));
}

/* Newton steps from the flat face to the relief's tangent planes; then its slopes, bilinear between texels. */
VECTOR_LOOP static void complete_relief(const Face *restrict face, int first, int last, Hits *restrict hits) {
    const double texel = face->texel, per_texel = 1 / texel;
    const float *restrict height = face->height, *restrict slope = face->slope;
    const Vector u = face->u, v = face->v, w = face->w, at = face->origin;
    for (int i = first; i < last; i++) {
        const double rx = hits->ox[i] - at.x, ry = hits->oy[i] - at.y, rz = hits->oz[i] - at.z;
        const double dx = hits->dx[i], dy = hits->dy[i], dz = hits->dz[i], flat = hits->best[i];
        const double o_u = rx * u.x + ry * u.y + rz * u.z, d_u = dx * u.x + dy * u.y + dz * u.z;
        const double o_v = rx * v.x + ry * v.y + rz * v.z, d_v = dx * v.x + dy * v.y + dz * v.z;
        const double o_w = rx * w.x + ry * w.y + rz * w.z, d_w = dx * w.x + dy * w.y + dz * w.z;
        double t = flat;
        for (int step = 0; step < RELIEF_STEPS; step++) {
            const double a = o_u + t * d_u, b = o_v + t * d_v, c = o_w + t * d_w;
            const int column = (int)floor(a * per_texel + 0.5), row = (int)floor(b * per_texel + 0.5);
            const int texel_at = texel_index(column, row);
            const double by_a = slope[2 * texel_at], by_b = slope[2 * texel_at + 1];
            const double tangent = height[texel_at] + by_a * (a - column * texel) + by_b * (b - row * texel);
            t += (tangent - c) / (d_w - by_a * d_u - by_b * d_v);
        }
        const double a = o_u + t * d_u, b = o_v + t * d_v;
        const int column = (int)floor(a * per_texel), row = (int)floor(b * per_texel);
        const float share_a = (float)(a * per_texel - column), share_b = (float)(b * per_texel - row);
        const int near = 2 * texel_index(column, row), right = 2 * texel_index(column + 1, row);
        const int below = 2 * texel_index(column, row + 1), far = 2 * texel_index(column + 1, row + 1);
        const float top_a = slope[near] + (slope[right] - slope[near]) * share_a;
        const float end_a = slope[below] + (slope[far] - slope[below]) * share_a;
        const float top_b = slope[near + 1] + (slope[right + 1] - slope[near + 1]) * share_a;
        const float end_b = slope[below + 1] + (slope[far + 1] - slope[below + 1]) * share_a;
        const double by_a = top_a + (end_a - top_a) * share_b, by_b = top_b + (end_b - top_b) * share_b;
        const double scale = 1 / sqrt(1 + by_a * by_a + by_b * by_b);
        hits->u[i] = a;
        hits->v[i] = b;
        hits->parameter[i] = t;
        hits->below[i] = greater((flat - t) * d_w, 0);
        hits->nx[i] = scale * (w.x - by_a * u.x - by_b * v.x);
        hits->ny[i] = scale * (w.y - by_a * u.y - by_b * v.y);
        hits->nz[i] = scale * (w.z - by_a * u.z - by_b * v.z);
    }
}

VECTOR_LOOP static void complete_flat(const Face *restrict face, int first, int last, Hits *restrict hits) {
    const Vector u = face->u, v = face->v, w = face->w, at = face->origin;
    for (int i = first; i < last; i++) {
        const double t = hits->best[i], x = hits->ox[i] + t * hits->dx[i] - at.x;
        const double y = hits->oy[i] + t * hits->dy[i] - at.y, z = hits->oz[i] + t * hits->dz[i] - at.z;
        hits->u[i] = x * u.x + y * u.y + z * u.z;
        hits->v[i] = x * v.x + y * v.y + z * v.z;
        hits->parameter[i] = t;
        hits->below[i] = 0;
        hits->nx[i] = w.x, hits->ny[i] = w.y, hits->nz[i] = w.z;
    }
}

static void complete_box(const Target *target, const Part *part, int number, int first, int last, Hits *hits) {
    Face face = {.u = in_target(part, from_face(number, (Vector){1, 0, 0})),
                 .v = in_target(part, from_face(number, (Vector){0, 1, 0})),
                 .w = in_target(part, from_face(number, (Vector){0, 0, 1}))};
    const Vector low = part->low, high = part->high;
    const double level = number == 0   ? high.z
                         : number == 5 ? -low.z
                         : number == 1 ? -low.x
                         : number == 2 ? high.x
                         : number == 3 ? -low.y
                                       : high.y;
    face.origin = plus(part->origin, times(level, face.w));
    if (part->relief >= 0) {
        const size_t texels = (size_t)RELIEF_TEXELS * RELIEF_TEXELS * (size_t)part->relief;
        face.texel = target->texel[(int)part->relief][0];
        face.height = target->height + texels;
        face.slope = target->slope + 2 * texels;
        complete_relief(&face, first, last, hits);
    } else {
        complete_flat(&face, first, last, hits);
    }
    for (int i = first; i < last; i++) hits->fx[i] = face.w.x, hits->fy[i] = face.w.y, hits->fz[i] = face.w.z;
}

/* The normal of a wall or of the floor of a gap. */
static Vector gap_normal(const Target *target, const Part *part, Vector p) {
    const Gap *gap = target->gap + (int)part->first_gap, *in = gap;
    double off = INFINITY;
    for (int i = 0; i < (int)part->gaps; i++, gap++) {
        const double wall = fabs(fabs(p.y * gap->cosine - p.x * gap->sine) - gap->half_width);
        if (p.x * gap->cosine + p.y * gap->sine > 0 && lesser(wall, fabs(p.z - gap->floor)) < off) {
            off = lesser(wall, fabs(p.z - gap->floor));
            in = gap;
        }
    }
    const double wall = fabs(fabs(p.y * in->cosine - p.x * in->sine) - in->half_width);
    return wall < fabs(p.z - in->floor) ? (Vector){-in->sine, in->cosine, 0} : (Vector){0, 0, 1};
}

static void complete_revolution(const Target *target, const Part *part, int piece, int first, int last, Hits *hits) {
    const double(*point)[2] = target->point + (int)part->first_point;
    const int is_gap = piece == (int)part->points - 1;
    double outward = 0, upward = 0;
    if (!is_gap) {
        const double along = point[piece + 1][0] - point[piece][0], up = point[piece + 1][1] - point[piece][1];
        const double length = sqrt(along * along + up * up);
        outward = up / length, upward = -along / length;
    }
    for (int i = first; i < last; i++) {
        const double t = hits->best[i];
        const Vector d = {hits->dx[i], hits->dy[i], hits->dz[i]};
        Vector p = {hits->ox[i] + t * d.x - part->origin.x, hits->oy[i] + t * d.y - part->origin.y,
                    hits->oz[i] + t * d.z - part->origin.z};
        if (!is_aligned(part)) p = rotated(part->rotation, p);
        const double scale = outward / greater(sqrt(p.x * p.x + p.y * p.y), 1e-300);
        Vector normal = is_gap ? gap_normal(target, part, p) : (Vector){scale * p.x, scale * p.y, upward};
        normal = in_target(part, normal);
        if (dot(normal, d) > 0) normal = times(-1, normal);
        hits->u[i] = hits->v[i] = hits->below[i] = 0;
        hits->parameter[i] = t;
        hits->nx[i] = hits->fx[i] = normal.x, hits->ny[i] = hits->fy[i] = normal.y, hits->nz[i] = hits->fz[i] = normal.z;
    }
}

/* Copies the rays of the hits from `first` on. */
VECTOR_LOOP static void copy_hits(const Rays *restrict rays, int first, Hits *restrict hits) {
    const int count = hits->count;
    for (int i = first; i < count; i++) {
        const int k = hits->ray[i];
        hits->ox[i] = rays->ox[k], hits->oy[i] = rays->oy[k], hits->oz[i] = rays->oz[k];
        hits->dx[i] = rays->dx[k], hits->dy[i] = rays->dy[k], hits->dz[i] = rays->dz[k];
        hits->best[i] = rays->best[k];
    }
}

void complete_hits(const Target *target, const Rays *rays, const uint8_t *wanted, Hits *hits) {
    uint8_t rest[BATCH];
    hits->count = 0;
    for (int i = 0; i < rays->count; i++) rest[i] = rays->part[i] != EMPTY && (!wanted || wanted[i]);
    for (int i = 0; i < rays->count; i++) {
        if (!rest[i]) continue;
        const int number = rays->part[i], face = (int)rays->face[i], first = hits->count;
        const Part *part = target->part + number;
        for (int k = i; k < rays->count; k++) {
            hits->ray[hits->count] = k;
            const int same = rest[k] & (rays->part[k] == number) & (rays->face[k] == face);
            rest[k] &= !same;
            hits->count += same;
        }
        copy_hits(rays, first, hits);
        for (int k = first; k < hits->count; k++) {
            hits->part[k] = number;
            hits->surface[k] = (int)part->first_surface + face;
        }
        if (part->kind == BOX)
            complete_box(target, part, face, first, hits->count, hits);
        else
            complete_revolution(target, part, face, first, hits->count, hits);
    }
    for (int i = 0; i < hits->count; i++) {
        hits->x[i] = hits->ox[i] + hits->parameter[i] * hits->dx[i];
        hits->y[i] = hits->oy[i] + hits->parameter[i] * hits->dy[i];
        hits->z[i] = hits->oz[i] + hits->parameter[i] * hits->dz[i];
    }
}
