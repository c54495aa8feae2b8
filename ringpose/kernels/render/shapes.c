/* Intersections of rays with boxes and surfaces of revolution, in closed form. */
#include "target.h"

/* Least ray parameter of an intersection times the length of the direction, in metres. */
static const double NEAREST_M = 1e-9;

enum { FORM_STEPS = 4, RELIEF_STEPS = 2 };

static int is_aligned(const Part *part) {
    return part->rotation[0] == 1 && part->rotation[4] == 1 && part->rotation[8] == 1;
}

int near_ray(const Part *part, Vector origin, Vector direction, double limit) {
    const Vector to = minus(part->center, origin);
    const double square = dot(direction, direction), along = dot(to, direction), radius2 = part->radius * part->radius;
    const double distance2 = dot(to, to);
    if (distance2 * square - along * along > radius2 * square) return 0;
    if (distance2 <= radius2) return 1; /* the origin is inside */
    const double beyond = along - limit * square;
    return along > 0 && (beyond < 0 || beyond * beyond < radius2 * square);
}

/* Ray against the box between two corners; 0 without overlap, else the interval of the parameter and its first axis. */
static int slab(Vector low, Vector high, Vector o, Vector d, double *enter, double *leave, int *axis) {
    const double origin[3] = {o.x, o.y, o.z}, direction[3] = {d.x, d.y, d.z};
    const double first[3] = {low.x, low.y, low.z}, last[3] = {high.x, high.y, high.z};
    *enter = -INFINITY;
    *leave = INFINITY;
    *axis = 2;
    for (int i = 0; i < 3; i++) {
        if (direction[i] == 0) {
            if (origin[i] < first[i] || origin[i] > last[i]) return 0;
            continue;
        }
        const double inverse = 1 / direction[i];
        double one = (first[i] - origin[i]) * inverse, other = (last[i] - origin[i]) * inverse;
        if (one > other) {
            const double swap = one;
            one = other;
            other = swap;
        }
        if (one > *enter) {
            *enter = one;
            *axis = i;
        }
        if (other < *leave) *leave = other;
    }
    return *enter <= *leave;
}

/* Faces of a box: 0 z+, 1 x-, 2 x+, 3 y-, 4 y+, 5 z-. */
static double hit_box(const Part *part, Vector o, Vector d, double nearest, double limit, int *face) {
    double enter, leave;
    int axis;
    if (!slab(part->low, part->high, o, d, &enter, &leave, &axis) || enter < nearest || enter >= limit) return INFINITY;
    const double towards = axis == 0 ? d.x : axis == 1 ? d.y : d.z;
    *face = axis == 2 ? (towards > 0 ? 5 : 0) : 1 + 2 * axis + (towards < 0);
    return enter;
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

typedef struct {
    const Target *target;
    const Part *part;
    Vector o, d;
    double nearest, best;
    int piece;
} Search;

static void accept(Search *search, double parameter, int piece) {
    if (!(parameter > search->nearest && parameter < search->best)) return;
    if (search->part->gaps > 0) {
        const Vector p = plus(search->o, times(parameter, search->d));
        if (in_gap(search->target, search->part, p.x, p.y, p.z)) return;
    }
    search->best = parameter;
    search->piece = piece;
}

/* A piece of the profile: an annulus, a cylinder or a cone. Roots of |xy|^2 = radius(z)^2 without cancellation. */
static void hit_piece(Search *search, const double first[2], const double second[2], int piece) {
    const Vector o = search->o, d = search->d;
    if (first[1] == second[1]) {
        const double t = (first[1] - o.z) / d.z, x = o.x + t * d.x, y = o.y + t * d.y, square = x * x + y * y;
        const double inner = lesser(first[0], second[0]), outer = greater(first[0], second[0]);
        if (square >= inner * inner && square <= outer * outer) accept(search, t, piece);
        return;
    }
    const double slope = (second[0] - first[0]) / (second[1] - first[1]), radius = first[0] + slope * (o.z - first[1]);
    const double a = d.x * d.x + d.y * d.y - slope * slope * d.z * d.z, b = o.x * d.x + o.y * d.y - slope * d.z * radius;
    const double c = o.x * o.x + o.y * o.y - radius * radius, under = b * b - a * c;
    if (under < 0) return;
    const double root = -(b + copysign(sqrt(under), b)), both[2] = {root / a, c / root};
    for (int i = 0; i < 2; i++) {
        const double z = o.z + both[i] * d.z;
        if (z >= lesser(first[1], second[1]) && z <= greater(first[1], second[1]) && radius + slope * both[i] * d.z >= 0)
            accept(search, both[i], piece);
    }
}

/* Walls and floors of the gaps; they are the surface after the pieces of the profile. */
static void hit_gaps(Search *search) {
    const Part *part = search->part;
    const double(*point)[2] = search->target->point + (int)part->first_point;
    const Gap *gap = search->target->gap + (int)part->first_gap;
    const int piece = (int)part->points - 1;
    double inner = INFINITY, outer = 0;
    for (int i = 0; i <= piece; i++) {
        inner = lesser(inner, point[i][0]);
        outer = greater(outer, point[i][0]);
    }
    const Vector o = search->o, d = search->d;
    const double low = (part->low.y - o.z) / d.z, high = (part->high.y - o.z) / d.z; /* where it enters and leaves */
    const Vector enter = plus(o, times(low, d)), leave = plus(o, times(high, d));
    for (int i = 0; i < (int)part->gaps; i++, gap++) {
        const double one = enter.y * gap->cosine - enter.x * gap->sine;
        const double other = leave.y * gap->cosine - leave.x * gap->sine;
        if (d.z != 0 && (lesser(one, other) > gap->half_width || greater(one, other) < -gap->half_width)) continue;
        if (d.z != 0 &&
            lesser(enter.x * gap->cosine + enter.y * gap->sine, leave.x * gap->cosine + leave.y * gap->sine) > outer)
            continue;
        const double across = o.y * gap->cosine - o.x * gap->sine, by_t = d.y * gap->cosine - d.x * gap->sine;
        for (int side = -1; side <= 2; side++) { /* the two walls, then the floor */
            const double t = side <= 1 ? (side * gap->half_width - across) / by_t : (gap->floor - o.z) / d.z;
            const int is_open = side == 2 && gap->floor <= part->low.y; /* through the whole ring */
            if (side == 0 || is_open || !(t > search->nearest && t < search->best)) continue;
            const double x = o.x + t * d.x, y = o.y + t * d.y, z = o.z + t * d.z, square = x * x + y * y;
            const int within = side <= 1 ? z > greater(gap->floor, part->low.y) && z < part->high.y
                                         : fabs(y * gap->cosine - x * gap->sine) < gap->half_width;
            if (within && square > inner * inner && square < outer * outer && x * gap->cosine + y * gap->sine > 0) {
                search->best = t;
                search->piece = piece;
            }
        }
    }
}

static void hit_profile(Search *search, const double (*point)[2]) {
    for (int i = 0; i + 1 < (int)search->part->points; i++) hit_piece(search, point[i], point[i + 1], i);
}

/* A ring that is out of round and warped: the profile is displaced by the deviations at the angle of the hit. */
static void hit_form(Search *search, const double (*point)[2], double face_z) {
    const Form *form = search->target->form + (int)search->part->form;
    const double limit = search->best;
    const int points = (int)search->part->points;
    double moved[MAX_POINTS][2], t = (face_z - search->o.z) / search->d.z;
    for (int step = 0; step < FORM_STEPS; step++) {
        const double angle = atan2(search->o.y + t * search->d.y, search->o.x + t * search->d.x);
        const double inner = wave(form->inner, angle), outer = wave(form->outer, angle), axial = wave(form->axial, angle);
        const double scale = form->radius_outer - form->radius_inner;
        for (int i = 0; i < points; i++) {
            const double share = lesser(greater((point[i][0] - form->radius_inner) / scale, 0), 1);
            moved[i][0] = point[i][0] + inner + share * (outer - inner);
            moved[i][1] = point[i][1] + axial;
        }
        search->best = limit;
        search->piece = EMPTY;
        hit_profile(search, (const double(*)[2])moved);
        if (search->piece == EMPTY) return;
        t = search->best;
    }
}

/* Whether the ray passes between the least and the greatest radius within the heights of the surface. */
static int passes_near(const Part *part, Vector o, Vector d, double least, double greatest) {
    double enter = 0, leave = INFINITY;
    if (d.z != 0) {
        const double one = (part->low.z - o.z) / d.z, other = (part->high.z - o.z) / d.z;
        enter = greater(lesser(one, other), 0);
        leave = greater(one, other);
        if (leave <= 0) return 0;
    } else if (o.z < part->low.z || o.z > part->high.z) {
        return 0;
    }
    const double a = d.x * d.x + d.y * d.y, b = o.x * d.x + o.y * d.y, c = o.x * o.x + o.y * o.y;
    const double nearest = a > 0 ? lesser(greater(-b / a, enter), leave) : enter;
    if (c + nearest * (2 * b + nearest * a) > greatest * greatest * (1 + 1e-12)) return 0;
    return leave == INFINITY || greater(c + enter * (2 * b + enter * a), c + leave * (2 * b + leave * a)) >=
                                    least * least * (1 - 1e-12);
}

static double hit_revolution(const Target *target, const Part *part, Vector o, Vector d, double nearest, double limit,
                             int *piece) {
    const double(*point)[2] = target->point + (int)part->first_point;
    if (!passes_near(part, o, d, part->low.x, part->high.x)) return INFINITY;
    Search search = {target, part, o, d, nearest, limit, EMPTY};
    if (part->form >= 0)
        hit_form(&search, point, part->high.y);
    else
        hit_profile(&search, point);
    if (part->gaps > 0) hit_gaps(&search);
    *piece = search.piece;
    return search.piece == EMPTY ? INFINITY : search.best;
}

static double hit_part(const Target *target, const Part *part, Vector origin, Vector direction, double nearest,
                       double limit, int *face) {
    Vector o = minus(origin, part->origin), d = direction;
    if (!is_aligned(part)) o = rotated(part->rotation, o), d = rotated(part->rotation, d);
    if (part->kind == BOX) return hit_box(part, o, d, nearest, limit, face);
    return hit_revolution(target, part, o, d, nearest, limit, face);
}

int first_hit(const Target *target, const int *chosen, int count, int guess, Vector origin, Vector direction, Hit *hit) {
    hit->parameter = INFINITY;
    hit->part = hit->surface = EMPTY;
    for (int i = guess < count ? -1 : 0; i < count; i++) {
        if (i == guess) continue;
        const int number = chosen[i < 0 ? guess : i];
        const Part *part = target->part + number;
        int face = 0;
        if (!near_ray(part, origin, direction, hit->parameter)) continue;
        const double parameter = hit_part(target, part, origin, direction, 0, hit->parameter, &face);
        if (parameter < hit->parameter) {
            hit->parameter = parameter;
            hit->part = number;
            hit->face = face;
            hit->surface = (int)part->first_surface + face;
        }
    }
    return hit->parameter < INFINITY;
}

int blocked(const Target *target, const int *chosen, int count, int own, Vector point, Vector towards) {
    const double nearest = NEAREST_M / sqrt(dot(towards, towards));
    for (int i = 0; i < count; i++) {
        const Part *part = target->part + chosen[i];
        int face;
        if (chosen[i] == own || !near_ray(part, point, towards, 1)) continue;
        if (hit_part(target, part, point, towards, nearest, 1, &face) < 1) return 1;
    }
    return 0;
}

static size_t texel_index(int64_t column, int64_t row) {
    return (size_t)((row & (RELIEF_TEXELS - 1)) * RELIEF_TEXELS + (column & (RELIEF_TEXELS - 1)));
}

/* Newton steps from the flat face to the relief's tangent planes; then its slopes, bilinear between texels. */
static void hit_relief(const Target *target, int relief, Vector o, Vector d, double *t, double slope[2]) {
    const double texel = target->texel[relief], per_texel = 1 / texel;
    const float *height = target->height + (size_t)relief * RELIEF_TEXELS * RELIEF_TEXELS;
    const float *gradient = target->slope + 2 * (size_t)relief * RELIEF_TEXELS * RELIEF_TEXELS;
    for (int step = 0; step < RELIEF_STEPS; step++) {
        const double x = o.x + *t * d.x, y = o.y + *t * d.y, z = o.z + *t * d.z;
        const int64_t column = whole(x * per_texel + 0.5), row = whole(y * per_texel + 0.5);
        const size_t at = texel_index(column, row);
        const double along_x = gradient[2 * at], along_y = gradient[2 * at + 1];
        const double off_x = x - (double)column * texel, off_y = y - (double)row * texel;
        const double tangent = height[at] + along_x * off_x + along_y * off_y;
        *t += (tangent - z) / (d.z - along_x * d.x - along_y * d.y);
    }
    const double x = (o.x + *t * d.x) * per_texel, y = (o.y + *t * d.y) * per_texel;
    const int64_t column = whole(x), row = whole(y);
    const double share_x = x - (double)column, share_y = y - (double)row;
    const float *near = gradient + 2 * texel_index(column, row), *right = gradient + 2 * texel_index(column + 1, row);
    const float *below = gradient + 2 * texel_index(column, row + 1), *far = gradient + 2 * texel_index(column + 1, row + 1);
    for (int i = 0; i < 2; i++) {
        const double top = near[i] + (right[i] - near[i]) * share_x, bottom = below[i] + (far[i] - below[i]) * share_x;
        slope[i] = top + (bottom - top) * share_y;
    }
}

/* Frame of a face of a box: u, v along it and w out of it; `level` is the face's w. */
static void face_frame(const Part *part, int face, Vector a, Vector *local, double *level) {
    switch (face) {
    case 0: *local = a, *level = part->high.z; break;
    case 5: *local = (Vector){a.x, a.y, -a.z}, *level = -part->low.z; break;
    case 1: *local = (Vector){a.y, a.z, -a.x}, *level = -part->low.x; break;
    case 2: *local = (Vector){a.y, a.z, a.x}, *level = part->high.x; break;
    case 3: *local = (Vector){a.x, a.z, -a.y}, *level = -part->low.y; break;
    default: *local = (Vector){a.x, a.z, a.y}, *level = part->high.y;
    }
}

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

static Vector box_normal(const Target *target, const Part *part, Vector o, Vector d, Hit *hit, double *parameter) {
    Vector local_o, local_d, normal = {0, 0, 1};
    double level, slope[2], unused;
    face_frame(part, hit->face, o, &local_o, &level);
    face_frame(part, hit->face, d, &local_d, &unused);
    local_o.z -= level;
    hit->flat_normal = in_target(part, from_face(hit->face, normal));
    if (part->relief >= 0) {
        hit_relief(target, (int)part->relief, local_o, local_d, parameter, slope);
        normal = unit((Vector){-slope[0], -slope[1], 1});
    }
    hit->u = local_o.x + *parameter * local_d.x;
    hit->v = local_o.y + *parameter * local_d.y;
    return part->relief >= 0 ? in_target(part, from_face(hit->face, normal)) : hit->flat_normal;
}

static Vector revolution_normal(const Target *target, const Part *part, Vector p, const Hit *hit) {
    const double(*point)[2] = target->point + (int)part->first_point;
    if (hit->face == (int)part->points - 1) { /* in a gap: a wall, or its floor */
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
    const double along = point[hit->face + 1][0] - point[hit->face][0], up = point[hit->face + 1][1] - point[hit->face][1];
    const double length = sqrt(along * along + up * up), radius = greater(sqrt(p.x * p.x + p.y * p.y), 1e-300);
    return (Vector){up / length * p.x / radius, up / length * p.y / radius, -along / length};
}

void complete_hit(const Target *target, Vector origin, Vector direction, Hit *hit) {
    const Part *part = target->part + hit->part;
    Vector o = minus(origin, part->origin), d = direction;
    if (!is_aligned(part)) o = rotated(part->rotation, o), d = rotated(part->rotation, d);
    double parameter = hit->parameter;
    hit->flat = plus(origin, times(parameter, direction));
    hit->u = hit->v = 0;
    if (part->kind == BOX) {
        hit->normal = box_normal(target, part, o, d, hit, &parameter);
    } else {
        const Vector normal = revolution_normal(target, part, plus(o, times(parameter, d)), hit);
        hit->normal = in_target(part, normal);
        if (dot(hit->normal, direction) > 0) hit->normal = times(-1, hit->normal);
        hit->flat_normal = hit->normal;
    }
    hit->point = plus(origin, times(parameter, direction));
}
