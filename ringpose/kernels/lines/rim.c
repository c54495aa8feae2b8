/* Which segments lie on the rim of one planar ring. Collinear segments are merged (pieces of a stripe that speckle, a glint
   or a bracket interrupts), candidates are ranked for each laser, and every group of one candidate for each of up to three
   lasers is scored: merits less the costs of a common plane, two concentric circles, missing stripes and tilt.

   Where both arcs of a ring are in view, a stripe crosses the face in two pieces, or in one with two outer ends where it
   passes beside the hole (method(7), section 14): chords, which are searched in the same way. */
#include "arguments.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <stdint.h>

#include "arcs.h"
#include "kernels.h"
#include "stripe_segments.h"

#define UNION_PARAMS(REAL, COUNT)                                                                                   \
    COUNT(min_beyond_ends, 0, INT32_MAX)                                                                            \
    REAL(max_gap, NOT_NEGATIVE)                                                                                     \
    REAL(separation_px, NOT_NEGATIVE)                                                                               \
    REAL(separation_sigmas, NOT_NEGATIVE)                                                                           \
    REAL(max_separation_px, NOT_NEGATIVE)                                                                           \
    COUNT(rounds, 0, 10)                                                                                            \
    REAL(fit_dof, NOT_NEGATIVE)                                                                                     \
    REAL(min_columns, POSITIVE)
RECORD_STRUCT(UnionParams, UNION_PARAMS);
RECORD(UnionParams, UNION_PARAMS);

#define CANDIDATE_PARAMS(REAL, COUNT)                                                                               \
    REAL(min_depth_m, POSITIVE)                                                                                     \
    REAL(max_depth_m, POSITIVE)                                                                                     \
    REAL(typical_scatter_px, POSITIVE)                                                                              \
    COUNT(max_counted_columns, 1, INT32_MAX)                                                                        \
    REAL(spill_penalty, FINITE)                                                                                     \
    REAL(adjacent_px, NOT_NEGATIVE)                                                                                 \
    COUNT(max_candidates, 1, 1000)
RECORD_STRUCT(CandidateParams, CANDIDATE_PARAMS);
RECORD(CandidateParams, CANDIDATE_PARAMS);

#define RING_PARAMS(REAL, COUNT)                                                                                    \
    REAL(focal_x, POSITIVE)                                                                                         \
    REAL(focal_y, POSITIVE)                                                                                         \
    REAL(principal_x, FINITE)                                                                                       \
    REAL(principal_y, FINITE)                                                                                       \
    REAL(along_sigma_px, POSITIVE)                                                                                  \
    REAL(oblique_sigma_px, POSITIVE)                                                                                \
    REAL(across_sigma_px, POSITIVE)                                                                                 \
    REAL(max_tilt_rad, FINITE)                                                                                      \
    COUNT(min_chord_ends, 5, 12)                                                                                    \
    REAL(agreement, NOT_NEGATIVE)                                                                                   \
    REAL(left_x, -INFINITY, INFINITY)                                                                               \
    REAL(right_x, -INFINITY, INFINITY)                                                                              \
    REAL(top_y, -INFINITY, INFINITY)                                                                                \
    REAL(bottom_y, -INFINITY, INFINITY)
RECORD_STRUCT(RingParams, RING_PARAMS);
RECORD(RingParams, RING_PARAMS);

enum { INNER, OUTER };

/* A segment, or two on one line, with a hypothetical laser. */
typedef struct {
    int32_t segment[2], laser; /* the second one is -1 if there is none */
    int ends;                  /* two for each segment */
    int edge[4];               /* the edge on which each end of a chord lies; of a piece 0 for its start, 1 for its end */
    double x[4], y[4];         /* normalised image coordinates of start and end */
    double inverse_depth[4];   /* 1/z there, 1/m */
    int own[4];                /* whether the stripe itself ends there: neither at the border nor at something that hides it */
    int may_be_hidden;         /* whether light of an unknown laser, if it is of this one, hides what is beyond one of the ends */
    double merit;
    double coincidence_bonus; /* what a group of three adds to the merit */
    double normal_matrix[6], right_side[3], square; /* of the weighted plane equations: upper triangle, sums */
} Candidate;

/* How a sheet of light is bent over its plane, Eq. (6.1). */
typedef struct {
    double ratio; /* bow over the plane's distance, 1/m/rad */
    double projector[3], axis[3], aside[3];
} Bend;

typedef struct {
    int lasers;
    uint32_t unlabelled;      /* mask of the lasers that unlabelled segments may belong to */
    const double (*plane)[3]; /* m / d of each light plane: 1/z = (m / d) . (x, y, 1) */
    const Bend *bend;         /* of each sheet of light; NULL if all are flat */
    const UnionParams *unions;
    const CandidateParams *candidates;
    const RingParams *ring;
    const Segment *segment; /* those that are not merged */
    size_t segments;
} Scene;

enum { MAX_MEMBERS = 3 };

typedef struct {
    int32_t index[MAX_MEMBERS];
    double score, runner_up; /* runner_up: best score of the same segments with other lasers; minus infinity if none */
    double gained;           /* of chords: the score, and what is gained by the ends that agree */
    int covered[MAX_MEMBERS]; /* of each segment, see `covered_ends` */
} Best;

static double beyond_ends(const Segment *segment) { return segment->before_start + segment->after_end; }

/* True if two segments may be on one line at this place. */
static int meet_at(double x, const Segment *first, const Segment *second, const UnionParams *params) {
    double separation = fabs(line_y(first, x) - line_y(second, x));
    if (!(separation < params->max_separation_px)) return 0;
    double sigma = hypot(line_sigma(first, x, middle_sigma(first, params->fit_dof, params->min_columns)),
                         line_sigma(second, x, middle_sigma(second, params->fit_dof, params->min_columns)));
    return separation < params->separation_px + params->separation_sigmas * sigma;
}

/* True if the second segment, to the right, may lie on the line of the first. */
static int on_one_line(const Segment *first, const Segment *second, const UnionParams *params) {
    double gap = second->x_start - first->x_end;
    return first->laser == second->laser && gap > 0 && meet_at(first->x_end + gap / 2, first, second, params);
}

/* True if, in addition, the gap between them is short. */
static int may_continue(const Segment *first, const Segment *second, const UnionParams *params) {
    double lengths = first->x_end - first->x_start + second->x_end - second->x_start;
    return second->x_start - first->x_end <= params->max_gap * lengths && on_one_line(first, second, params);
}

/* The merged segment: line and scatter of all centres together, from the moments of both. */
static Segment united(const Segment *first, const Segment *second) {
    const Segment *part[2] = {first, second};
    double count = first->centers + second->centers, xx = 0, xy = 0, yy = 0;
    double middle_x = (first->centers * first->middle_x + second->centers * second->middle_x) / count;
    double middle_y = (first->centers * first->middle_y + second->centers * second->middle_y) / count;
    for (int i = 0; i < 2; i++) {
        const Segment *p = part[i];
        double dx = p->middle_x - middle_x, dy = p->middle_y - middle_y, length = fmax(p->x_end - p->x_start, 1);
        double own = length * length / 12;
        xx += p->centers * (own + dx * dx);
        xy += p->centers * (own * p->slope + dx * dy);
        yy += p->centers * (own * p->slope * p->slope + p->scatter * p->scatter + dy * dy);
    }
    Segment both = *first;
    both.centers = count;
    both.x_end = second->x_end;
    both.middle_x = middle_x;
    both.middle_y = middle_y;
    both.slope = xy / xx;
    both.scatter = sqrt(fmax(yy - both.slope * xy, 0) / count);
    both.correlation = fmax(first->correlation, second->correlation);
    both.after_end = second->after_end; /* what lies between them interrupts the stripe */
    return both;
}

static int add(List *list, const Segment *segment) {
    if (!reserve(list, 1)) return 0;
    ((Segment *)list->data)[list->used++] = *segment;
    return 1;
}

/* Merges one segment with each of those that continue it. */
static int unite(Segment left, const List *pieces, const UnionParams *params, List *unions) {
    const Segment *piece = pieces->data;
    for (size_t j = 0; j < pieces->used; j++) {
        if (!may_continue(&left, &piece[j], params)) continue;
        Segment both = united(&left, &piece[j]);
        if (!add(unions, &both)) return 0;
    }
    return 1;
}

/* Appends merged segments, two by two in several rounds, to the list. 0 if there is no memory. */
static int unite_collinear(const Segment *segment, size_t count, const UnionParams *params, List *unions) {
    List pieces = {NULL, 0, 0, sizeof *segment};
    size_t first = unions->used;
    int done = 1;
    for (size_t i = 0; done && i < count; i++)
        if (beyond_ends(&segment[i]) >= params->min_beyond_ends && !segment[i].clipped) done = add(&pieces, &segment[i]);
    const Segment *piece = pieces.data;
    for (size_t i = 0; done && i < pieces.used; i++) done = unite(piece[i], &pieces, params, unions);
    for (size_t round = 1; done && round < (size_t)params->rounds; round++) {
        size_t last = unions->used;
        for (; done && first < last; first++) done = unite(((Segment *)unions->data)[first], &pieces, params, unions);
    }
    release(&pieces);
    return done;
}

/* The ends in normalised image coordinates. */
static void place(const Segment *all, const RingParams *ring, Candidate *candidate) {
    for (int e = 0; e < candidate->ends; e++) {
        const Segment *segment = &all[candidate->segment[e / 2]];
        double end = e % 2 ? segment->x_end : segment->x_start;
        candidate->x[e] = (end - ring->principal_x) / ring->focal_x;
        candidate->y[e] = (line_y(segment, end) - ring->principal_y) / ring->focal_y;
    }
}

/* True where the image shows whether a stripe ends. */
static int in_view(double x, double y, const RingParams *ring) {
    return !(x < ring->left_x || x > ring->right_x || y < ring->top_y || y > ring->bottom_y);
}

enum { BEND_STEPS = 6 }; /* corrections of a plane by its bend, as in geometry/sheets */

/* 1/z where a ray (x, y, 1) meets the sheet of a laser: (m / d) . (x, y, 1) on its plane. */
static double inverse_depth(const Scene *scene, int laser, double x, double y) {
    const double *light = scene->plane[laser];
    const double flat = light[0] * x + light[1] * y + light[2];
    if (scene->bend == NULL || !(flat > 0)) return flat;
    const Bend *bend = &scene->bend[laser];
    double w = flat;
    for (int step = 0; step < BEND_STEPS; step++) {
        double along = 0, aside = 0, point[3] = {x / w, y / w, 1 / w};
        for (int k = 0; k < 3; k++) {
            along += bend->axis[k] * (point[k] - bend->projector[k]);
            aside += bend->aside[k] * (point[k] - bend->projector[k]);
        }
        double angle = atan2(aside, along);
        w = flat / (1 + bend->ratio * hypot(along, aside) * angle * angle);
    }
    return w;
}

/* True if all ends, on the sheet of the laser, are within the depth range; fills in the inverse depths. */
static int possible(const Scene *scene, Candidate *candidate) {
    const CandidateParams *params = scene->candidates;
    for (int e = 0; e < candidate->ends; e++) {
        double w = inverse_depth(scene, candidate->laser, candidate->x[e], candidate->y[e]);
        if (!(w > 1 / params->max_depth_m && w < 1 / params->min_depth_m)) return 0;
        candidate->inverse_depth[e] = w;
    }
    return 1;
}

/* True if centres on an unlabelled segment's line may be another laser's stripe on the body behind: light planes are nearly
   parallel, so that one face in five has another laser's stripe on its line. */
static int may_be_other_laser(const Segment *segment, const Candidate *candidate, const Scene *scene) {
    double x = (candidate->x[0] + candidate->x[1]) / 2, y = (candidate->y[0] + candidate->y[1]) / 2;
    double nearest = 1 / scene->candidates->max_depth_m, own = (candidate->inverse_depth[0] + candidate->inverse_depth[1]) / 2;
    for (int laser = 0; segment->laser < 0 && laser < scene->lasers; laser++) {
        double other = inverse_depth(scene, laser, x, y);
        if (laser != candidate->laser && scene->unlabelled >> laser & 1 && other > nearest && other < own) return 1;
    }
    return 0;
}

/* Merit of a segment: long, little scatter, no centres on its line beyond its ends. If those may be another laser's, a
   group of three gets back what exceeds the loss by such a coincidence. */
static void rate(const Segment *segment, int is_union, const Scene *scene, Candidate *candidate) {
    const CandidateParams *params = scene->candidates;
    double share = beyond_ends(segment) / (beyond_ends(segment) + segment->centers);
    double scatter = segment->scatter / params->typical_scatter_px;
    double straight = 2 * log(fmin(segment->centers, params->max_counted_columns)) - 0.5 * scatter * scatter;
    double spill = params->spill_penalty * share, excess = spill - scene->ring->agreement;
    candidate->merit = straight - spill - scene->ring->agreement * is_union;
    candidate->coincidence_bonus = excess > 0 && may_be_other_laser(segment, candidate, scene) ? excess : 0;
}

/* Contribution of the ends to the normal equations of a plane, 1/z = p . (x, y, 1); the weight is the inverse variance
   of the inverse depth, propagated from a pixel error across the segment. */
static void complete(const double light[3], const RingParams *ring, Candidate *candidate) {
    double sigma = fmax(ring->across_sigma_px * fabs(light[1]) / ring->focal_y, 1e-12), weight = 1 / (sigma * sigma);
    for (int e = 0; e < candidate->ends; e++) {
        double x = candidate->x[e], y = candidate->y[e], w = candidate->inverse_depth[e];
        double product[6] = {x * x, x * y, x, y * y, y, 1};
        for (int k = 0; k < 6; k++) candidate->normal_matrix[k] += weight * product[k];
        candidate->right_side[0] += weight * x * w;
        candidate->right_side[1] += weight * y * w;
        candidate->right_side[2] += weight * w;
        candidate->square += weight * w * w;
    }
}

/* Inserts a candidate into the list of its laser, sorted by merit, of at most `maximum`; returns the new length. */
static int rank(const Candidate *candidate, Candidate *own, int count, int maximum) {
    int at = count < maximum ? count : maximum;
    double at_best = candidate->merit + candidate->coincidence_bonus;
    for (; at > 0 && at_best > own[at - 1].merit + own[at - 1].coincidence_bonus; at--)
        if (at < maximum) own[at] = own[at - 1];
    if (at < maximum) own[at] = *candidate;
    return count < maximum ? count + 1 : maximum;
}

/* True if `rank` would insert a candidate. */
static int ranks(const Candidate *candidate, const Candidate *own, int count, int maximum) {
    return count < maximum || candidate->merit + candidate->coincidence_bonus > own[maximum - 1].merit + own[maximum - 1].coincidence_bonus;
}

/* True if another piece of the same laser, on a nearer surface more than `min_rows` beside it, hides what is beyond that end:
   the segment reaches from the edge of that surface, or of its shadow, to the foot of a wall below that edge, which has the
   same lateral position. */
static int hidden_beyond(const Segment *segment, int side, const Segment *other, double min_rows, const Scene *scene,
                         int laser) {
    const RingParams *ring = scene->ring;
    double adjacent = scene->candidates->adjacent_px, sign = side ? 1 : -1;
    double end = side ? segment->x_end : segment->x_start, near = side ? other->x_start : other->x_end;
    double far = side ? other->x_end : other->x_start, depth[2];
    if (!(sign * (near - end) > -adjacent && sign * (far - end) > 0)) return 0;
    if (!(fabs(end - near) < other->x_end - other->x_start)) return 0;
    double at[2] = {line_y(segment, near), line_y(other, near)};
    for (int i = 0; i < 2; i++)
        depth[i] = 1 / inverse_depth(scene, laser, (near - ring->principal_x) / ring->focal_x,
                                     (at[i] - ring->principal_y) / ring->focal_y);
    if (!(depth[1] > 0 && depth[1] < depth[0] && fabs(at[1] - at[0]) > min_rows)) return 0;
    double foot = ring->principal_x + (near - ring->principal_x) * depth[1] / depth[0];
    return end > fmin(near, foot) - adjacent && end < fmax(near, foot) + adjacent;
}

/* Which ends are the stripe's own; returns the penalty of the others, infinite if the image's border cuts both off. */
static double judge_ends(const Segment *all, size_t pieces, const Scene *scene, Candidate *candidate) {
    const CandidateParams *params = scene->candidates;
    int cut = 0, covered = 0;
    for (int e = 0; e < candidate->ends; e++) {
        const Segment *segment = &all[candidate->segment[e / 2]];
        candidate->own[e] = in_view(candidate->x[e], candidate->y[e], scene->ring);
        if (candidate->x[e] < scene->ring->left_x || candidate->x[e] > scene->ring->right_x)
            cut++; /* not above or below, where the stripe leaves the image along its whole length */
        for (size_t i = 0; candidate->own[e] && !(segment->laser < 0 && candidate->may_be_hidden) && i < pieces; i++)
            if (all[i].laser == segment->laser &&
                hidden_beyond(segment, e % 2, &all[i], params->adjacent_px, scene, candidate->laser)) {
                candidate->may_be_hidden |= segment->laser < 0;
                if (segment->laser < 0) continue;
                candidate->own[e] = 0;
                covered++;
            }
    }
    return cut < 2 ? scene->ring->agreement * (cut + covered) : INFINITY;
}

/* True if a segment is of that laser, or may be. */
static int is_of(const Segment *segment, int laser, const Scene *scene) {
    return segment->laser < 0 ? scene->unlabelled >> laser & 1 : segment->laser == laser;
}

/* The best segments for each laser, sorted by laser; `all` has room for the largest number of each. Returns how many. */
static int find_candidates(const Segment *segment, size_t count, size_t unions, const Scene *scene, Candidate *all) {
    int found = 0;
    for (int laser = 0; laser < scene->lasers; laser++) {
        int own = 0;
        for (size_t i = 0; i < count; i++) {
            Candidate candidate = {.segment = {(int32_t)i, -1}, .laser = laser, .ends = 2, .edge = {0, 1}};
            if (!is_of(&segment[i], laser, scene)) continue;
            place(segment, scene->ring, &candidate);
            if (!possible(scene, &candidate)) continue;
            rate(&segment[i], i >= count - unions, scene, &candidate);
            if (!ranks(&candidate, all + found, own, (int)scene->candidates->max_candidates)) continue; /* nor less a penalty */
            candidate.merit -= judge_ends(segment, count - unions, scene, &candidate);
            if (candidate.merit == -INFINITY) continue;
            own = rank(&candidate, all + found, own, (int)scene->candidates->max_candidates);
        }
        for (int i = 0; i < own; i++) complete(scene->plane[laser], scene->ring, &all[found + i]);
        found += own;
    }
    return found;
}

/* Solves the symmetric 3 x 3 system a x = b; 0 if a is singular. */
static int solve3(const double a[6], const double b[3], double x[3]) {
    double c00 = a[3] * a[5] - a[4] * a[4], c01 = a[2] * a[4] - a[1] * a[5], c02 = a[1] * a[4] - a[2] * a[3];
    double determinant = a[0] * c00 + a[1] * c01 + a[2] * c02;
    if (!(fabs(determinant) > 1e-14 * a[0] * a[3] * a[5])) return 0;
    double c11 = a[0] * a[5] - a[2] * a[2], c12 = a[1] * a[2] - a[0] * a[4], c22 = a[0] * a[3] - a[1] * a[1];
    x[0] = (c00 * b[0] + c01 * b[1] + c02 * b[2]) / determinant;
    x[1] = (c01 * b[0] + c11 * b[1] + c12 * b[2]) / determinant;
    x[2] = (c02 * b[0] + c12 * b[1] + c22 * b[2]) / determinant;
    return 1;
}

/* Half the chi-square of the best plane 1/z = p . (x, y, 1) through the segments' ends; for a single segment the plane that
   faces the camera. */
static double plane_cost(const Candidate *const member[], int size, double plane[3]) {
    double a[6] = {0}, b[3] = {0}, square = 0;
    for (int i = 0; i < size; i++) {
        for (int k = 0; k < 6; k++) a[k] += member[i]->normal_matrix[k];
        for (int k = 0; k < 3; k++) b[k] += member[i]->right_side[k];
        square += member[i]->square;
    }
    if (size == 1) {
        plane[0] = plane[1] = 0;
        plane[2] = 0.5 * (member[0]->inverse_depth[0] + member[0]->inverse_depth[1]);
        return 0;
    }
    if (!solve3(a, b, plane)) return INFINITY;
    double cost = 0.5 * (square - plane[0] * b[0] - plane[1] * b[1] - plane[2] * b[2]);
    return cost > 0 ? cost : 0;
}

/* True if light of that laser, in a frame that shows no other one, is seen in a column and leaves a plane there to the group:
   on what stands on it, or through a gap. A nearer stripe as long as those of the group may be the face. */
static int is_seen_elsewhere(int laser, double x, const double plane[3], double min_columns, const Scene *scene) {
    const double column = x * scene->ring->focal_x + scene->ring->principal_x;
    int seen = 0, may_be_face = 0;
    for (size_t i = 0; i < scene->segments; i++) {
        const Segment *segment = &scene->segment[i];
        if (segment->laser != laser || segment->x_start > column || segment->x_end < column) continue;
        double y = (line_y(segment, column) - scene->ring->principal_y) / scene->ring->focal_y;
        double nearer = inverse_depth(scene, laser, x, y) - (plane[0] * x + plane[1] * y + plane[2]);
        seen = 1;
        may_be_face |= nearer > 0 && segment->x_end - segment->x_start >= min_columns;
    }
    return seen && !may_be_face;
}

/* The plane of a group: the middle of its ends, and unit vectors in it along and across the stripes. */
typedef struct {
    double middle[3], along[3], across[3];
} Flat;

/* Two concentric circles in it. */
typedef struct {
    double x, y, radius[2];
} Circles;

static double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* True if a light sheet meets the plane of the circles inside the outer one. */
static int crosses(const double light[3], const Flat *flat, const Circles *circles) {
    double along = dot(light, flat->along), across = dot(light, flat->across);
    double off = dot(light, flat->middle) + along * circles->x + across * circles->y - 1;
    return fabs(off) < circles->radius[OUTER] * hypot(along, across);
}

/* Penalty of the lasers outside the group whose stripe on the plane the image would show at normalised x, those aside that
   pass beside the ring; without circles it is not known which do. */
static double unseen_lasers_penalty(const Candidate *const member[], int size, const double plane[3], const Flat *flat,
                                    const Circles *circles, const Scene *scene) {
    const RingParams *params = scene->ring;
    double x = 0, length = INFINITY, penalty = 0;
    for (int i = 0; i < size; i++) {
        double first = member[i]->x[0], last = member[i]->x[member[i]->ends - 1];
        x += (first + last) / (2 * size);
        length = fmin(length, last - first);
    }
    for (int laser = 0; laser < scene->lasers; laser++) {
        int in_group = 0;
        for (int i = 0; i < size; i++) in_group |= member[i]->laser == laser;
        const double *light = scene->plane[laser];
        double y = -((plane[0] - light[0]) * x + plane[2] - light[2]) / (plane[1] - light[1]);
        if (in_group || !(y > params->top_y && y < params->bottom_y)) continue;
        if (circles && !crosses(light, flat, circles)) continue;
        int elsewhere = size > 1 && is_seen_elsewhere(laser, x, plane, length * params->focal_x, scene);
        penalty += params->agreement * (elsewhere ? 1 : 2); /* of both ends */
    }
    return penalty;
}

/* Half the chi-square of two concentric arcs through the used ends, which are at most two radii apart. */
static double arcs_cost(const ArcPoint *end, int ends, double sigma) {
    Arcs arcs;
    double cost = 0, first = INFINITY, last = -INFINITY;
    for (int k = 0; k < ends; k++)
        if (end[k].used) {
            first = fmin(first, end[k].y);
            last = fmax(last, end[k].y);
        }
    if (!fit_arcs(end, ends, (last - first) / 2, &arcs)) return 0; /* all ends of one edge are truncated by the border: nothing to test */
    for (int k = 0; k < ends; k++)
        if (end[k].used) {
            double outside = outside_arc(&arcs, &end[k]) / sigma;
            cost += 2 * arcs.bend * end[k].x + 1 > 0 ? 0.5 * outside * outside : INFINITY; /* beyond the centre the face is on the other side */
        }
    return cost;
}

enum { MAX_ENDS = 4 * MAX_MEMBERS };

/* Coordinates of a group's ends in their plane, x along the stripes; those that are not the stripe's own are marked as unused.
   Returns the mean depth. */
static double flat_ends(const Candidate *const member[], int size, const double plane[3], ArcPoint *end, Flat *flat) {
    double point[MAX_ENDS][3], *middle = flat->middle, *along = flat->along;
    *flat = (Flat){{0}, {0}, {0}};
    int count = 0;
    for (int i = 0; i < size; i++)
        for (int e = 0; e < member[i]->ends; e++, count++) {
            double depth = 1 / member[i]->inverse_depth[e], *p = point[count];
            p[0] = member[i]->x[e] * depth;
            p[1] = member[i]->y[e] * depth;
            p[2] = depth;
            end[count].arc = member[i]->edge[e];
            end[count].used = member[i]->own[e];
            for (int k = 0; k < 3; k++) {
                middle[k] += p[k];
                along[k] += e % 2 ? p[k] : -p[k];
            }
        }
    for (int k = 0; k < 3; k++) middle[k] /= count;
    double length = sqrt(plane[0] * plane[0] + plane[1] * plane[1] + plane[2] * plane[2]);
    double n[3] = {plane[0] / length, plane[1] / length, plane[2] / length};
    double off = dot(along, n);
    for (int k = 0; k < 3; k++) along[k] -= off * n[k];
    length = sqrt(along[0] * along[0] + along[1] * along[1] + along[2] * along[2]);
    for (int k = 0; k < 3; k++) along[k] /= length;
    for (int k = 0; k < 3; k++) flat->across[k] = n[(k + 1) % 3] * along[(k + 2) % 3] - n[(k + 2) % 3] * along[(k + 1) % 3];
    for (int e = 0; e < count; e++) {
        double d[3] = {point[e][0] - middle[0], point[e][1] - middle[1], point[e][2] - middle[2]};
        end[e].x = dot(d, along);
        end[e].y = dot(d, flat->across);
    }
    return middle[2];
}

static double circle_cost(const Candidate *const member[], int size, const double plane[3], const Scene *scene) {
    ArcPoint end[MAX_ENDS] = {{0}};
    Flat flat;
    const RingParams *params = scene->ring;
    double sigma = params->along_sigma_px * flat_ends(member, size, plane, end, &flat) / params->focal_x;
    double best = arcs_cost(end, 2 * size, sigma);
    const double dropped = params->agreement + log(2 * size); /* its agreement, and the choice of one of them */
    if (size < 3 || best < dropped) return best;
    for (int e = 0; e < 2 * size; e++) {
        if (!end[e].used) continue;
        end[e].used = 0;
        best = fmin(best, arcs_cost(end, 2 * size, sigma) + dropped);
        end[e].used = 1;
    }
    return best;
}

/* Score of a group; minus infinity if it is impossible, if its ends agree with a plane or with circles no better than by
   chance, or if it is not above `minimum`. */
static double group_score(const Candidate *const member[], int size, const Scene *scene, double minimum) {
    const double limit = scene->ring->agreement * 2 * size;
    double plane[3] = {0}, merit = 0;
    for (int i = 0; i < size; i++) merit += member[i]->merit + (size == MAX_MEMBERS ? member[i]->coincidence_bonus : 0);
    if (!(merit > minimum)) return -INFINITY;
    double cost = plane_cost(member, size, plane);
    if (!(cost < limit && merit - cost > minimum)) return -INFINITY;
    double tilt = size == 1 ? 0 : atan2(hypot(plane[0], plane[1]), fabs(plane[2]));
    if (tilt > scene->ring->max_tilt_rad) return -INFINITY;
    double oblique = 0.5 * (tilt / 0.5) * (tilt / 0.5);
    if (!(merit - cost - oblique > minimum)) return -INFINITY;
    if (size > 1) {
        double circle = circle_cost(member, size, plane, scene);
        if (!(circle < limit)) return -INFINITY;
        cost += circle;
    }
    cost += unseen_lasers_penalty(member, size, plane, NULL, NULL, scene);
    return merit - cost - oblique;
}

/* Chords: stripes across both arcs of a ring */

/* Half the chi-square of two concentric circles |P|^2 + b x + c y + d = 0 (3.13) through the used ends; infinite if these
   are not on two edges, or if a piece between two ends is not on the face between the circles. The equation is linear and, around the
   whole circle, unbiased. A single stripe leaves its distance from the centre open, which is taken for zero: the circles are
   the smallest ones. `sine` receives those of the angles at which the stripes cross their edges. */
static double circles_cost(const ArcPoint *end, int ends, int stripes, double sigma, Circles *circles, double *sine) {
    double count[2] = {0}, x[2] = {0}, y[2] = {0}, q[2] = {0}, xx = 0, xy = 0, yy = 0, xq = 0, yq = 0, cost = 0;
    for (int k = 0; k < ends; k++)
        if (end[k].used) {
            int edge = end[k].arc;
            count[edge] += 1;
            x[edge] += end[k].x;
            y[edge] += end[k].y;
            q[edge] += end[k].x * end[k].x + end[k].y * end[k].y;
        }
    if (count[INNER] == 0 || count[OUTER] == 0) return INFINITY;
    for (int k = 0; k < ends; k++)
        if (end[k].used) {
            int edge = end[k].arc;
            double dx = end[k].x - x[edge] / count[edge], dy = end[k].y - y[edge] / count[edge];
            double dq = end[k].x * end[k].x + end[k].y * end[k].y - q[edge] / count[edge];
            xx += dx * dx;
            xy += dx * dy;
            yy += dy * dy;
            xq += dx * dq;
            yq += dy * dq;
        }
    double determinant = xx * yy - xy * xy, *radius = circles->radius;
    if (stripes > 1 && !(determinant > 1e-6 * xx * yy)) return INFINITY;
    double center_x = 0.5 * xq / xx, center_y = 0; /* of one stripe, along which x is measured */
    if (stripes > 1) {
        center_x = 0.5 * (yy * xq - xy * yq) / determinant;
        center_y = 0.5 * (xx * yq - xy * xq) / determinant;
    }
    circles->x = center_x;
    circles->y = center_y;
    for (int edge = 0; edge < 2; edge++) {
        double square = q[edge] - 2 * center_x * x[edge] - 2 * center_y * y[edge];
        radius[edge] = sqrt(square / count[edge] + center_x * center_x + center_y * center_y);
    }
    if (!(radius[OUTER] > radius[INNER])) return INFINITY;
    for (int k = 0; k < ends; k++) {
        double from_center = hypot(end[k].x - center_x, end[k].y - center_y), off = (from_center - radius[end[k].arc]) / sigma;
        if (end[k].used) cost += 0.5 * off * off;
        sine[k] = fabs(end[k].x - center_x) / fmax(from_center, 1e-12);
        if (k % 2 == 0) continue;
        double middle = hypot((end[k].x + end[k - 1].x) / 2 - center_x, (end[k].y + end[k - 1].y) / 2 - center_y);
        if (!(middle > radius[INNER] - 3 * sigma && middle < radius[OUTER] + 3 * sigma)) return INFINITY;
    }
    return cost;
}

static int count_own(const Candidate *candidate) {
    int own = 0;
    for (int e = 0; e < candidate->ends; e++) own += candidate->own[e];
    return own;
}

/* The number of own ends of a group of chords; 0 if none of its stripes is seen in two pieces, or if an arc has less than three
   ends of two stripes: the curvature passes through any one of them, and a single piece of foil fits every other time. A
   single stripe shows all four of its ends: nothing but these would tell light on the body, seen through the ring. */
static int count_chord_ends(const Candidate *const member[], int size, const RingParams *params) {
    int own[2] = {0}, stripes[2] = {0}, pairs = 0;
    for (int i = 0; i < size; i++) {
        int of_arc[2] = {0}, last = member[i]->ends - 1;
        for (int e = 0; e <= last; e++) {
            int right = last == 3 ? e > 1 : member[i]->edge[0] == member[i]->edge[1] ? e : member[i]->edge[1] == OUTER;
            of_arc[right] += member[i]->own[e];
        }
        for (int arc = 0; arc < 2; arc++) {
            own[arc] += of_arc[arc];
            stripes[arc] += of_arc[arc] > 0;
        }
        pairs += last == 3;
    }
    int seen = pairs && stripes[0] > 1 && stripes[1] > 1 && own[0] > 2 && own[1] > 2;
    if (size == 1) seen = pairs && own[0] + own[1] == 4 && !member[0]->may_be_hidden;
    else seen = seen && own[0] + own[1] >= params->min_chord_ends;
    return seen ? own[0] + own[1] : 0;
}

/* True if the edges of two chords may be four parallel straight lines, as those of a frame or of two bars: these ends lie on
   two circles, too, if they are as far on one side of their centre as on the other. */
static int may_be_straight(const ArcPoint *end, double sigma, double limit) {
    double mean = 0, square = 0;
    for (int k = 0; k < 4; k++) mean += (end[k + 4].x - end[k].x) / 4;
    for (int k = 0; k < 4; k++) {
        double off = (end[k + 4].x - end[k].x - mean) / sigma;
        square += off * off / 2;
    }
    return square / 2 < limit;
}

/* Score of a group of chords, without what is gained by the number of ends that agree; minus infinity if it is impossible.
   `sine` is that of `circles_cost`. */
static double chord_score(const Candidate *const member[], int size, const Scene *scene, double *sine) {
    const RingParams *params = scene->ring;
    double plane[3] = {0}, merit = 0;
    ArcPoint end[MAX_ENDS] = {{0}};
    int ends = 0;
    Flat flat;
    Circles fitted;
    for (int i = 0; i < size; i++) {
        merit += member[i]->merit;
        ends += member[i]->ends;
    }
    double cost = plane_cost(member, size, plane), tilt = atan2(hypot(plane[0], plane[1]), fabs(plane[2]));
    if (!(cost < params->agreement * ends) || tilt > params->max_tilt_rad) return -INFINITY;
    double sigma_px = size == 1 ? params->oblique_sigma_px : params->along_sigma_px;
    double sigma = sigma_px * flat_ends(member, size, plane, end, &flat) / params->focal_x;
    double circles = circles_cost(end, ends, size, sigma, &fitted, sine);
    if (!(circles < params->agreement * ends)) return -INFINITY;
    const ArcPoint *own_end = end;
    for (int i = 0; i < size; own_end += member[i++]->ends) /* the two pieces are on both sides of the centre */
        if (member[i]->ends == 4 && !(own_end[1].x < fitted.x && fitted.x < own_end[2].x)) return -INFINITY;
    if (ends == 8 && size == 2 && may_be_straight(end, sigma, 2 * params->agreement)) return -INFINITY;
    cost += circles + unseen_lasers_penalty(member, size, plane, &flat, &fitted, scene);
    return merit - cost - 0.5 * (tilt / 0.5) * (tilt / 0.5);
}

/* Fills in places, ends and merit of a chord; 0 if it is not possible. */
static int judge_chord(const Segment *all, size_t pieces, const Segment *united, int unions, const Scene *scene, Candidate *chord) {
    place(all, scene->ring, chord);
    if (!possible(scene, chord)) return 0;
    double penalty = judge_ends(all, pieces, scene, chord);
    rate(united, unions, scene, chord);
    chord->merit -= penalty;
    chord->coincidence_bonus = 0;
    return 1;
}

/* Appends a chord to a list if its ends are seen: three of four, or both of one piece with two outer ends. */
static int add_chord(const Candidate *chord, Candidate *list, int count, int maximum) {
    int wanted = chord->ends == 4 ? 3 : chord->edge[0] == chord->edge[1] ? 2 : 1;
    return count_own(chord) < wanted ? count : rank(chord, list, count, maximum);
}

/* The chords of one laser that are seen on both arcs, at most `max_candidates`. Returns how many. */
static int find_pairs(const Segment *all, size_t count, size_t pieces, int laser, const Scene *scene, Candidate *pairs) {
    int found = 0;
    for (size_t i = 0; i < count; i++)
        for (size_t j = 0; j < count && is_of(&all[i], laser, scene); j++) {
            if (!on_one_line(&all[i], &all[j], scene->unions)) continue;
            Candidate pair = {.segment = {(int32_t)i, (int32_t)j}, .laser = laser, .ends = 4,
                              .edge = {OUTER, INNER, INNER, OUTER}};
            Segment both = united(&all[i], &all[j]);
            if (judge_chord(all, pieces, &both, i >= pieces || j >= pieces, scene, &pair))
                found = add_chord(&pair, pairs, found, scene->candidates->max_candidates);
        }
    return found;
}

/* Those of one piece, each with the names that its ends may have, at most `maximum`. Returns how many. */
static int find_single_chords(const Segment *all, size_t count, size_t pieces, int laser, const Scene *scene, int maximum,
                              Candidate *single) {
    static const int edges[3][2] = {{OUTER, OUTER}, {OUTER, INNER}, {INNER, OUTER}};
    int found = 0;
    for (size_t i = 0; i < count; i++) {
        Candidate piece = {.segment = {(int32_t)i, -1}, .laser = laser, .ends = 2};
        if (!is_of(&all[i], laser, scene) || !judge_chord(all, pieces, &all[i], i >= pieces, scene, &piece)) continue;
        for (int k = 0; k < 3; k++) {
            piece.edge[0] = edges[k][0];
            piece.edge[1] = edges[k][1];
            found = add_chord(&piece, single, found, maximum);
        }
    }
    return found;
}

/* The chords of all lasers, sorted by laser. Returns how many, 0 if no stripe is seen on both arcs. Long single pieces, as
   those of foil, do not take the place of chords in two pieces. */
static int find_chords(const Segment *all, size_t count, size_t unions, const Scene *scene, Candidate *chord) {
    int found = 0, pairs = 0, maximum = 2 * scene->candidates->max_candidates;
    for (int laser = 0; laser < scene->lasers; laser++) {
        Candidate *of_laser = chord + found;
        int own = find_pairs(all, count, count - unions, laser, scene, of_laser);
        pairs += own;
        own += find_single_chords(all, count, count - unions, laser, scene, maximum - own, of_laser + own);
        for (int i = 0; i < own; i++) complete(scene->plane[laser], scene->ring, &of_laser[i]);
        found += own;
    }
    return pairs ? found : 0;
}

static int is_among(int32_t segment, const Best *winner, const Candidate *all, int size) {
    int found = 0;
    for (int i = 0; i < size; i++) found |= segment == all[winner->index[i]].segment[0];
    return found;
}

typedef struct {
    const Candidate *all;
    int count, size;
    const Scene *scene;
    const Best *winner; /* in the search for the runner-up: the same segments, other lasers */
    Best *best;
    double *runner_up;
    int chords;
} Search;

/* True if the segments are assigned to the same lasers as those of the winner. */
static int as_winner(const Search *search, const Candidate *const member[]) {
    int same = 1;
    for (int i = 0; i < search->size; i++) {
        const Candidate *winner = &search->all[search->winner->index[i]];
        same &= member[i]->laser == winner->laser && member[i]->segment[0] == winner->segment[0];
    }
    return same;
}

static void visit(Search *search, const Candidate *const member[], const int32_t *index) {
    double minimum = search->winner ? *search->runner_up : search->best->score, sine[MAX_ENDS];
    const RingParams *params = search->scene->ring;
    int own = search->chords ? count_chord_ends(member, search->size, params) : 0;
    if (search->chords && !own) return;
    double score = search->chords ? chord_score(member, search->size, search->scene, sine)
                                  : group_score(member, search->size, search->scene, minimum);
    double gained = search->chords ? score + params->agreement * own : score;
    if (search->winner) {
        if (!as_winner(search, member)) *search->runner_up = fmax(*search->runner_up, score);
    } else if (gained > search->best->gained) {
        search->best->score = score;
        search->best->gained = gained;
        for (int i = 0; i < search->size; i++) search->best->index[i] = index[i];
    }
}

/* True if the first segments of a group may lie on one plane; further segments never lower the cost. */
static int on_one_plane(const Candidate *const member[], int count, const Search *search) {
    double plane[3], limit = search->scene->ring->agreement * search->size * (search->chords ? 4 : 2);
    return count < 2 || plane_cost(member, count, plane) < limit;
}

/* Enumerates the groups of one size with ascending lasers and distinct segments. */
static void descend(Search *search, int depth, const Candidate **member, int32_t *index) {
    if (depth == search->size) {
        visit(search, member, index);
        return;
    }
    for (int c = depth ? index[depth - 1] + 1 : 0; c < search->count; c++) {
        const Candidate *next = &search->all[c];
        int fits = depth == 0 || next->laser > member[depth - 1]->laser;
        for (int i = 0; i < depth; i++) fits &= next->segment[0] != member[i]->segment[0];
        if (!fits || (search->winner && !is_among(next->segment[0], search->winner, search->all, search->size))) continue;
        member[depth] = next;
        index[depth] = c;
        if (depth + 1 == search->size || on_one_plane(member, depth + 1, search))
            descend(search, depth + 1, member, index);
    }
}

/* Candidates must be sorted by laser. */
static Best best_group(const Candidate *all, int count, int size, const Scene *scene) {
    Best best = {{-1, -1, -1}, -INFINITY, -INFINITY, -INFINITY, {0}};
    const Candidate *member[MAX_MEMBERS] = {NULL};
    int32_t index[MAX_MEMBERS] = {0};
    Search search = {all, count, size, scene, NULL, &best, NULL, 0};
    descend(&search, 0, member, index);
    if (best.score > -INFINITY) {
        Best winner = best;
        search.winner = &winner;
        search.runner_up = &best.runner_up;
        descend(&search, 0, member, index);
    }
    return best;
}

/* The best group of chords of one to three lasers, by score and what is gained by the ends that agree. */
static Best best_chords(const Candidate *all, int count, const Scene *scene, int *size) {
    Best best = {{-1, -1, -1}, -INFINITY, -INFINITY, -INFINITY, {0}};
    const Candidate *member[MAX_MEMBERS] = {NULL};
    int32_t index[MAX_MEMBERS] = {0};
    *size = 0;
    for (int lasers = 1; count && lasers <= MAX_MEMBERS; lasers++) {
        Best of_size = best;
        Search search = {all, count, lasers, scene, NULL, &of_size, NULL, 1};
        descend(&search, 0, member, index);
        if (!(of_size.gained > best.gained)) continue;
        best = of_size;
        *size = lasers;
        search.winner = &best;
        search.runner_up = &of_size.runner_up;
        of_size.runner_up = -INFINITY;
        descend(&search, 0, member, index);
        best.runner_up = of_size.runner_up;
    }
    return best;
}

enum { NAMES = 3 };

/* The best three segments of one arc where one of them passes beside the hole, from outer edge to outer edge: their ends with
   every name, each the stripe's own, unless circles fit them better with the names of one arc. `chord` has room for more. */
static void pass_beside_hole(const Segment *all, size_t pieces, const Candidate *candidate, const Best *group, const Scene *scene,
                             Candidate *chord, int count, Best *best, int *size) {
    static const int edges[NAMES][2] = {{OUTER, OUTER}, {OUTER, INNER}, {INNER, OUTER}};
    double sine[MAX_ENDS], highest = group->score;
    if (group->index[0] < 0 || *size > 1) return;
    for (int i = 0; i < MAX_MEMBERS; i++)
        for (int k = 0; k < NAMES; k++) {
            const Candidate *of_arc = &candidate[group->index[i]];
            Candidate *named = &chord[count + NAMES * i + k];
            *named = (Candidate){.segment = {of_arc->segment[0], -1}, .laser = of_arc->laser, .ends = 2,
                                 .edge = {edges[k][0], edges[k][1]}};
            size_t segment = (size_t)of_arc->segment[0];
            if (!judge_chord(all, pieces, &all[segment], segment >= pieces, scene, named) || count_own(named) < 2) return;
            complete(scene->plane[named->laser], scene->ring, named);
        }
    for (int32_t names = 0; names < NAMES * NAMES * NAMES; names++) {
        const int32_t index[MAX_MEMBERS] = {count + names % NAMES, count + NAMES + names / NAMES % NAMES,
                                            count + 2 * NAMES + names / (NAMES * NAMES)};
        const Candidate *const member[MAX_MEMBERS] = {&chord[index[0]], &chord[index[1]], &chord[index[2]]};
        int beside = 0;
        for (int i = 0; i < MAX_MEMBERS; i++) beside |= member[i]->edge[0] == member[i]->edge[1];
        double score = beside ? chord_score(member, MAX_MEMBERS, scene, sine) : -INFINITY;
        if (!(score > highest)) continue;
        highest = score;
        *size = MAX_MEMBERS;
        *best = (Best){{index[0], index[1], index[2]}, score, group->runner_up, score, {0}};
    }
}

enum { MAX_LASERS = 32 };

static int check_lasers(const Segment *segment, Py_ssize_t segments, Py_ssize_t lasers) {
    for (Py_ssize_t i = 0; i < segments; i++) {
        if (segment[i].laser >= -1 && segment[i].laser < (double)lasers) continue;
        PyErr_Format(PyExc_ValueError, "segments: number %zd is of a laser that is not of the rig", i);
        return 0;
    }
    return 1;
}

/* The segments, then unions of them; and the best groups of all. */
typedef struct {
    List segments;
    Candidate *candidate, *chord;
    Best best[MAX_MEMBERS], best_chords;
    int chords; /* lasers of the best group of chords */
} Found;

/* The ends of a group's segment beyond which a nearer surface hides the plane: 1 for the left one, 2 for the right one, 3 for
   both. Light of an unknown laser that the group does not explain may be of this one. */
static int covered_ends(const Segment *all, const Candidate *candidate, const Best *best, int size, int member, const Scene *scene) {
    const Candidate *own = &candidate[best->index[member]];
    const Segment *segment = &all[own->segment[0]];
    int covered = 0;
    for (int e = 0; e < 2; e++)
        for (size_t i = 0; in_view(own->x[e], own->y[e], scene->ring) && i < scene->segments; i++)
            if (is_of(&all[i], own->laser, scene) && !is_among((int32_t)i, best, candidate, size) &&
                !meet_at(e ? segment->x_end : segment->x_start, segment, &all[i], scene->unions) &&
                hidden_beyond(segment, e, &all[i], 0, scene, own->laser))
                covered |= 1 << e;
    return covered;
}

/* Returns 0 if there is no memory. */
static int find(const Segment *segment, size_t count, const Scene *scene, Found *found) {
    List *all = &found->segments;
    size_t room = (size_t)scene->lasers * (size_t)scene->candidates->max_candidates;
    found->candidate = malloc((room ? room : 1) * sizeof *found->candidate);
    found->chord = malloc((2 * room + NAMES * MAX_MEMBERS) * sizeof *found->chord);
    if (found->candidate == NULL || found->chord == NULL || !reserve(all, count + 1)) return 0;
    if (count) memcpy(all->data, segment, count * sizeof *segment);
    all->used = count;
    if (!unite_collinear(segment, count, scene->unions, all)) return 0;
    int candidates = find_candidates(all->data, all->used, all->used - count, scene, found->candidate);
    for (int size = 1; size <= MAX_MEMBERS; size++) {
        Best *best = &found->best[size - 1];
        *best = best_group(found->candidate, candidates, size, scene);
        for (int i = 0; i < size && best->index[0] >= 0; i++)
            best->covered[i] = covered_ends(all->data, found->candidate, best, size, i, scene);
    }
    int chords = find_chords(all->data, all->used, all->used - count, scene, found->chord);
    found->best_chords = best_chords(found->chord, chords, scene, &found->chords);
    pass_beside_hole(all->data, count, found->candidate, &found->best[MAX_MEMBERS - 1], scene, found->chord, chords,
                     &found->best_chords, &found->chords);
    return 1;
}

/* Lasers and indices of a group's segments, its score, that of the runner-up, and the covered ends of each segment. */
static PyObject *group(const Found *found, int size) {
    const Best *best = &found->best[size - 1];
    PyObject *lasers = PyTuple_New(size), *segments = PyTuple_New(size), *covered = PyTuple_New(size);
    for (int i = 0; lasers && segments && covered && i < size; i++) {
        const Candidate *candidate = best->index[0] < 0 ? NULL : &found->candidate[best->index[i]];
        PyTuple_SetItem(lasers, i, PyLong_FromLong(candidate ? candidate->laser : -1));
        PyTuple_SetItem(segments, i, PyLong_FromLong(candidate ? candidate->segment[0] : -1));
        PyTuple_SetItem(covered, i, PyLong_FromLong(best->covered[i]));
    }
    return Py_BuildValue("(NNddN)", lasers, segments, best->score, best->runner_up, covered);
}

/* The score of the best group of chords and that of the runner-up, and for each chord its laser, its segments (the second is -1 if there is none), the
   edges of the first segment's ends, and the sines of the angles at which all ends cross their edges. */
static PyObject *chord_group(const Found *found, const Scene *scene) {
    PyObject *chords = PyTuple_New(found->chords);
    const Candidate *member[MAX_MEMBERS] = {NULL};
    double sine[MAX_ENDS] = {0}, *of_chord = sine;
    for (int i = 0; i < found->chords; i++) member[i] = &found->chord[found->best_chords.index[i]];
    if (found->chords) chord_score(member, found->chords, scene, sine);
    for (int i = 0; chords && i < found->chords; of_chord += member[i++]->ends) {
        const Candidate *chord = member[i];
        int pair = chord->ends == 4;
        PyTuple_SetItem(chords, i, Py_BuildValue("(iiiii(dddd))", chord->laser, chord->segment[0], chord->segment[1],
                                                 chord->edge[0], chord->edge[1], of_chord[0], of_chord[1],
                                                 pair ? of_chord[2] : 0.0, pair ? of_chord[3] : 0.0));
    }
    return Py_BuildValue("(ddN)", found->best_chords.score, found->best_chords.runner_up, chords);
}

PyObject *call_faces(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"segments", FLOAT64, {ANY, NUMBERS(Segment)}},
                                          {"unlabelled", WHOLE, {0, INT32_MAX}},
                                          {"planes", FLOAT64, {N, 3}},
                                          {"?bends", FLOAT64, {N, NUMBERS(Bend)}},
                                          {"unions", &UnionParams_record, {0}},
                                          {"candidates", &CandidateParams_record, {0}},
                                          {"ring", &RingParams_record, {0}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const Py_ssize_t segments = a.view[0].shape[0], lasers = a.view[2].shape[0];
    const Scene scene = {(int)lasers,
                         (unsigned)a.number[1][0].whole,
                         (const double(*)[3])a.view[2].buf,
                         a.view[3].obj ? a.view[3].buf : NULL,
                         (const UnionParams *)a.number[4],
                         (const CandidateParams *)a.number[5],
                         (const RingParams *)a.number[6],
                         a.view[0].buf,
                         (size_t)segments};
    if (!require(lasers <= MAX_LASERS && segments <= INT32_MAX / 2, "planes, segments: there are too many") ||
        !check_lasers(a.view[0].buf, segments, lasers))
        return close_arguments(&a, NULL);
    Found found = {.segments = {NULL, 0, 0, sizeof(Segment)}};
    int done;
    Py_BEGIN_ALLOW_THREADS
    done = find(a.view[0].buf, (size_t)segments, &scene, &found);
    Py_END_ALLOW_THREADS
    PyObject *bytes = list_bytes(done, &found.segments);
    PyObject *result =
        bytes ? Py_BuildValue("(N(NNN)N)", bytes, group(&found, 1), group(&found, 2), group(&found, 3),
                              chord_group(&found, &scene))
              : NULL;
    free(found.candidate);
    free(found.chord);
    return close_arguments(&a, result);
}
