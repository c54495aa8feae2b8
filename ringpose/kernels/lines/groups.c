/* Which tracks lie on one planar ring: every choice of one track a laser is scored. */
#include "faces.h"

#include <math.h>
#include <stddef.h>

#include "arcs.h"

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

/* On a plane the inverse depth is linear in the normalised image: 1/z = p . (x, y, 1). Half the squared sigmas of
   the tracks' ends from the best such plane, which for a single track is the one that faces the camera. */
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

/* Lasers outside the group whose stripe on the plane the image would show at normalised x. */
static int unseen_lasers(const Candidate *const member[], int size, const double plane[3], const Scene *scene) {
    const RingRules *rules = &scene->rules->ring;
    double x = 0;
    int unseen = 0;
    for (int i = 0; i < size; i++) x += (member[i]->x[0] + member[i]->x[1]) / (2 * size);
    for (int laser = 0; laser < scene->lasers; laser++) {
        int in_group = 0;
        for (int i = 0; i < size; i++) in_group |= member[i]->laser == laser;
        const double *light = scene->plane[laser];
        double y = -((plane[0] - light[0]) * x + plane[2] - light[2]) / (plane[1] - light[1]);
        double row = y * rules->focal_y + rules->principal_y;
        unseen += !in_group && row > rules->border && row < rules->height - rules->border;
    }
    return unseen;
}

/* Half the squared sigmas of the used ends from two arcs about one centre; infinite for rings that nobody builds. */
static double arcs_cost(const End *end, int ends, double sigma, const RingRules *rules) {
    Arcs arcs;
    double cost = 0;
    int fitted = fit_wide_arcs(end, ends, rules->minimum_radius, &arcs);
    if (!fitted) return 0; /* the border cut off all ends of an edge: there is nothing to check */
    for (int k = 0; k < ends; k++)
        if (end[k].used) {
            double outside = outside_arc(&arcs, &end[k]) / sigma;
            cost += 0.5 * outside * outside;
        }
    return arcs_band(&arcs) < rules->minimum_band ? INFINITY : cost;
}

/* The ends of a group in their plane, x along the stripes from start to end, without those that the border cut off;
   returns their mean depth. */
static double flat_ends(const Candidate *const member[], int size, const double plane[3], const RingRules *rules,
                        End *end) {
    double point[2 * MOST_MEMBERS][3], middle[3] = {0}, along[3] = {0};
    for (int i = 0; i < size; i++)
        for (int side = 0; side < 2; side++) {
            double depth = 1 / member[i]->inverse_depth[side], *p = point[2 * i + side];
            p[0] = member[i]->x[side] * depth;
            p[1] = member[i]->y[side] * depth;
            p[2] = depth;
            for (int k = 0; k < 3; k++) {
                middle[k] += p[k] / (2 * size);
                along[k] += side ? p[k] : -p[k];
            }
        }
    double length = sqrt(plane[0] * plane[0] + plane[1] * plane[1] + plane[2] * plane[2]);
    double n[3] = {plane[0] / length, plane[1] / length, plane[2] / length};
    double off = along[0] * n[0] + along[1] * n[1] + along[2] * n[2];
    for (int k = 0; k < 3; k++) along[k] -= off * n[k];
    length = sqrt(along[0] * along[0] + along[1] * along[1] + along[2] * along[2]);
    for (int k = 0; k < 3; k++) along[k] /= length;
    double across[3] = {n[1] * along[2] - n[2] * along[1], n[2] * along[0] - n[0] * along[2],
                        n[0] * along[1] - n[1] * along[0]};
    for (int e = 0; e < 2 * size; e++) {
        double d[3] = {point[e][0] - middle[0], point[e][1] - middle[1], point[e][2] - middle[2]};
        double x = member[e / 2]->x[e % 2], y = member[e / 2]->y[e % 2];
        end[e] = (End){d[0] * along[0] + d[1] * along[1] + d[2] * along[2],
                       d[0] * across[0] + d[1] * across[1] + d[2] * across[2], e % 2,
                       !(x < rules->left || x > rules->right || y < rules->top || y > rules->bottom), 0, 0};
    }
    return middle[2];
}

static double circle_cost(const Candidate *const member[], int size, const double plane[3], const Scene *scene) {
    End end[2 * MOST_MEMBERS] = {{0}};
    const RingRules *rules = &scene->rules->ring;
    double sigma = rules->along_sigma * flat_ends(member, size, plane, rules, end) / rules->focal_x;
    double best = arcs_cost(end, 2 * size, sigma, rules);
    if (size < 3 || best < rules->dropped_end) return best;
    for (int e = 0; e < 2 * size; e++) {
        if (!end[e].used) continue;
        end[e].used = 0;
        best = fmin(best, arcs_cost(end, 2 * size, sigma, rules) + rules->dropped_end);
        end[e].used = 1;
    }
    return best;
}

/* The score of a group; minus infinity if it is impossible, or not above `least`. */
static double group_score(const Candidate *const member[], int size, const Scene *scene, double least) {
    const RingRules *rules = &scene->rules->ring;
    double plane[3] = {0}, merit = 0;
    for (int i = 0; i < size; i++) merit += member[i]->merit + (size == MOST_MEMBERS ? member[i]->forgiven : 0);
    if (!(merit > least)) return -INFINITY;
    double cost = plane_cost(member, size, plane);
    if (!(cost < rules->plane_limit * size && merit - cost > least)) return -INFINITY;
    double tilt = size == 1 ? 0 : atan2(hypot(plane[0], plane[1]), fabs(plane[2]));
    if (tilt > rules->tilt) return -INFINITY;
    double oblique = 0.5 * (tilt / 0.5) * (tilt / 0.5);
    if (!(merit - cost - oblique > least)) return -INFINITY;
    if (size > 1) {
        double circle = circle_cost(member, size, plane, scene);
        if (!(circle < rules->circle_limit * size)) return -INFINITY;
        cost += circle;
    }
    cost += rules->unseen * unseen_lasers(member, size, plane, scene);
    return merit - cost - oblique;
}

static int among(int32_t track, const Best *known, const Candidate *all, int size) {
    int found = 0;
    for (int i = 0; i < size; i++) found |= track == all[known->index[i]].track;
    return found;
}

typedef struct {
    const Candidate *all;
    int count, size;
    const Scene *scene;
    const Best *known; /* when looking for rivals of the best: the same tracks under other lasers */
    Best *best;
    double *rival;
} Search;

static void visit(Search *search, const Candidate *const member[], const int32_t *index) {
    double least = search->known ? *search->rival : search->best->score;
    double score = group_score(member, search->size, search->scene, least);
    if (search->known) {
        int itself = 1;
        for (int i = 0; i < search->size; i++) itself &= index[i] == search->known->index[i];
        if (!itself) *search->rival = fmax(*search->rival, score);
    } else if (score > search->best->score) {
        search->best->score = score;
        for (int i = 0; i < search->size; i++) search->best->index[i] = index[i];
    }
}

/* Whether a group's first tracks may lie on one plane: more of them cost no less. */
static int on_one_plane(const Candidate *const member[], int count, const Search *search) {
    double plane[3], limit = search->scene->rules->ring.plane_limit * search->size;
    return count < 2 || plane_cost(member, count, plane) < limit;
}

/* All groups of a size in which lasers ascend and no track stands twice. */
static void descend(Search *search, int depth, const Candidate **member, int32_t *index) {
    if (depth == search->size) {
        visit(search, member, index);
        return;
    }
    for (int c = depth ? index[depth - 1] + 1 : 0; c < search->count; c++) {
        const Candidate *next = &search->all[c];
        int fits = depth == 0 || next->laser > member[depth - 1]->laser;
        for (int i = 0; i < depth; i++) fits &= next->track != member[i]->track;
        if (!fits || (search->known && !among(next->track, search->known, search->all, search->size))) continue;
        member[depth] = next;
        index[depth] = c;
        if (depth + 1 == search->size || on_one_plane(member, depth + 1, search)) descend(search, depth + 1, member, index);
    }
}

Best best_group(const Candidate *all, int count, int size, const Scene *scene) {
    Best best = {{-1, -1, -1}, -INFINITY, -INFINITY};
    const Candidate *member[MOST_MEMBERS] = {NULL};
    int32_t index[MOST_MEMBERS] = {0};
    Search search = {all, count, size, scene, NULL, &best, NULL};
    descend(&search, 0, member, index);
    if (best.score > -INFINITY) {
        Best known = best;
        search.known = &known;
        search.rival = &best.rival;
        descend(&search, 0, member, index);
    }
    return best;
}
