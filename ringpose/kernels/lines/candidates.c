/* Which tracks may be the ring's face, and under which laser. */
#include <math.h>

#include "faces.h"
#include "track_line.h"

/* The ends on the normalised image. */
static void place(const Track *track, const RingRules *ring, Candidate *candidate) {
    double end[2] = {track->x_start, track->x_end};
    for (int side = 0; side < 2; side++) {
        candidate->x[side] = (end[side] - ring->principal_x) / ring->focal_x;
        candidate->y[side] = (line_y(track, end[side]) - ring->principal_y) / ring->focal_y;
    }
}

/* Whether a stripe of that light plane lies at the depth of a ring and is as long as its face is wide; fills in the
   inverse depths. */
static int possible(const double light[3], const CandidateRules *rules, Candidate *candidate) {
    double point[2][3], length = 0;
    for (int side = 0; side < 2; side++) {
        double x = candidate->x[side], y = candidate->y[side], w = light[0] * x + light[1] * y + light[2];
        if (!(w > 1 / rules->farthest && w < 1 / rules->nearest)) return 0;
        candidate->inverse_depth[side] = w;
        point[side][0] = x * (1 / w);
        point[side][1] = y * (1 / w);
        point[side][2] = 1 / w;
    }
    for (int k = 0; k < 3; k++) length += (point[1][k] - point[0][k]) * (point[1][k] - point[0][k]);
    return length > rules->shortest * rules->shortest && length < rules->longest * rules->longest;
}

/* Whether what lies on an unlabelled track's line may be another laser's stripe on the body behind it. */
static int meets_another(const Track *track, const Candidate *candidate, const Scene *scene) {
    const CandidateRules *rules = &scene->rules->candidates;
    double x = (candidate->x[0] + candidate->x[1]) / 2, y = (candidate->y[0] + candidate->y[1]) / 2;
    double depth = 2 / (candidate->inverse_depth[0] + candidate->inverse_depth[1]);
    for (int laser = 0; track->laser < 0 && laser < scene->lasers; laser++) {
        const double *light = scene->plane[laser];
        double behind = 1 / (light[0] * x + light[1] * y + light[2]) - depth;
        if (laser != candidate->laser && scene->unlabelled >> laser & 1 && behind > rules->behind_least &&
            behind < rules->behind_most)
            return 1;
    }
    return 0;
}

/* How much a track looks like a flat metal face: long for its scatter, and nothing on its line beyond its ends; where
   that may be another laser's, a group of three forgives what is more than such a coincidence costs. */
static void judge(const Track *track, int is_union, const Scene *scene, Candidate *candidate) {
    const CandidateRules *rules = &scene->rules->candidates;
    double share = track->spilt / (track->spilt + track->count), rough = track->scatter / rules->usual_scatter;
    double straight = 2 * log(fmin(track->count, rules->enough_columns)) - 0.5 * rough * rough;
    double spilt = rules->spill_cost * share, unlikely = spilt - rules->coincidence_cost;
    candidate->merit = straight - spilt - rules->clipped_cost * track->clipped - rules->union_cost * is_union;
    candidate->forgiven = unlikely > 0 && meets_another(track, candidate, scene) ? unlikely : 0;
}

/* The ends' share in the equations of a plane: 1/z = p . (x, y, 1), each weighted by what a pixel's error across the
   track does to the inverse depth. */
static void complete(const double light[3], const RingRules *ring, Candidate *candidate) {
    double sigma = fmax(ring->across_sigma * fabs(light[1]) / ring->focal_y, 1e-12), weight = 1 / (sigma * sigma);
    for (int side = 0; side < 2; side++) {
        double x = candidate->x[side], y = candidate->y[side], w = candidate->inverse_depth[side];
        double product[6] = {x * x, x * y, x, y * y, y, 1};
        for (int k = 0; k < 6; k++) candidate->normal_matrix[k] += weight * product[k];
        candidate->right_side[0] += weight * x * w;
        candidate->right_side[1] += weight * y * w;
        candidate->right_side[2] += weight * w;
        candidate->square += weight * w * w;
    }
}

/* Puts a candidate behind those of its laser that are no worse, if fewer than `most` of them are; returns how many of
   them there are then. */
static int rank(const Candidate *candidate, Candidate *own, int count, int most) {
    int at = count < most ? count : most;
    double at_best = candidate->merit + candidate->forgiven;
    for (; at > 0 && at_best > own[at - 1].merit + own[at - 1].forgiven; at--)
        if (at < most) own[at] = own[at - 1];
    if (at < most) own[at] = *candidate;
    return count < most ? count + 1 : most;
}

int find_candidates(const Track *track, size_t count, size_t unions, const Scene *scene, Candidate *all) {
    const FaceRules *rules = scene->rules;
    int found = 0;
    for (int laser = 0; laser < scene->lasers; laser++) {
        int own = 0;
        for (size_t i = 0; i < count; i++) {
            int allowed = track[i].laser < 0 ? scene->unlabelled >> laser & 1 : track[i].laser == laser;
            Candidate candidate = {.track = (int32_t)i, .laser = laser};
            if (!allowed) continue;
            place(&track[i], &rules->ring, &candidate);
            if (!possible(scene->plane[laser], &rules->candidates, &candidate)) continue;
            judge(&track[i], i >= count - unions, scene, &candidate);
            own = rank(&candidate, all + found, own, (int)rules->candidates.most);
        }
        for (int i = 0; i < own; i++) complete(scene->plane[laser], &rules->ring, &all[found + i]);
        found += own;
    }
    return found;
}
