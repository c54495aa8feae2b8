/* Two concentric arcs through the ends of stripes, in the best-fitting plane of these. */
#include "arguments.h"

#include <math.h>
#include <string.h>

#include "arcs.h"

/* Moments of the normal equations for a and b; the c are eliminated by centring each arc. */
typedef struct {
    double mean_x[2], mean_y[2], mean_q[2];
    double uu, uv, vv, ut, vt;
} Moments;

/* 0 if an arc has no point. */
static int moments_of(const End *end, int ends, Moments *m) {
    double count[2] = {0};
    *m = (Moments){.uu = 0};
    for (int k = 0; k < ends; k++)
        if (end[k].used) {
            int arc = end[k].arc;
            count[arc] += 1;
            m->mean_x[arc] += end[k].x;
            m->mean_y[arc] += end[k].y;
            m->mean_q[arc] += end[k].x * end[k].x + end[k].y * end[k].y;
        }
    if (count[0] == 0 || count[1] == 0) return 0;
    for (int arc = 0; arc < 2; arc++) {
        m->mean_x[arc] /= count[arc];
        m->mean_y[arc] /= count[arc];
        m->mean_q[arc] /= count[arc];
    }
    for (int k = 0; k < ends; k++)
        if (end[k].used) {
            int arc = end[k].arc;
            double u = end[k].x * end[k].x + end[k].y * end[k].y - m->mean_q[arc];
            double v = end[k].y - m->mean_y[arc], t = end[k].x - m->mean_x[arc];
            m->uu += u * u;
            m->uv += u * v;
            m->vv += v * v;
            m->ut += u * t;
            m->vt += v * t;
        }
    return 1;
}

static void solve(const Moments *m, int straight, Arcs *arcs) {
    double determinant = m->uu * m->vv - m->uv * m->uv;
    arcs->a = arcs->b = 0;
    if (!straight && determinant > 1e-12 * m->uu * m->vv) {
        arcs->a = -(m->vv * m->ut - m->uv * m->vt) / determinant;
        arcs->b = -(m->uu * m->vt - m->uv * m->ut) / determinant;
    } else if (m->vv > 0)
        arcs->b = -m->vt / m->vv;
    for (int arc = 0; arc < 2; arc++)
        arcs->c[arc] = -m->mean_x[arc] - arcs->a * m->mean_q[arc] - arcs->b * m->mean_y[arc];
}

int fit_arcs(const End *end, int ends, Arcs *arcs) {
    Moments moments;
    if (!moments_of(end, ends, &moments)) return 0;
    solve(&moments, 0, arcs);
    return 1;
}

int fit_wide_arcs(const End *end, int ends, double radius, Arcs *arcs) {
    Moments moments;
    if (!moments_of(end, ends, &moments)) return 0;
    solve(&moments, 0, arcs);
    if (fabs(arcs_curvature(arcs)) > 1 / radius) solve(&moments, 1, arcs);
    return 1;
}

double outside_arc(const Arcs *arcs, const End *end) {
    double x = end->x, y = end->y, residual = arcs->a * (x * x + y * y) + x + arcs->b * y + arcs->c[end->arc];
    return residual / fmax(hypot(2 * arcs->a * x + 1, 2 * arcs->a * y + arcs->b), 1e-9);
}

double arcs_curvature(const Arcs *arcs) {
    double level = 1 + arcs->b * arcs->b - 2 * arcs->a * (arcs->c[0] + arcs->c[1]);
    return -2 * arcs->a / sqrt(fmax(level, 1e-12));
}

static double cost(const End *end, int ends) {
    Arcs arcs;
    double sum = 0;
    if (!fit_arcs(end, ends, &arcs)) return INFINITY;
    for (int k = 0; k < ends; k++)
        if (end[k].used) {
            double outside = outside_arc(&arcs, &end[k]) / end[k].sigma;
            sum += 0.5 * outside * outside;
        }
    return sum;
}

static void arc_costs(End *end, int ends, double *result) {
    result[0] = cost(end, ends);
    for (int k = 0; k < ends; k++) {
        end[k].used = 0;
        result[k + 1] = cost(end, ends);
        end[k].used = 1;
    }
    Arcs arcs = {0, 0, {0, 0}};
    double curvature = fit_arcs(end, ends, &arcs) ? arcs_curvature(&arcs) : NAN, variance = 0;
    for (int k = 0; k < ends; k++) {
        double x = end[k].x;
        end[k].x += end[k].along_sigma;
        double change = fit_arcs(end, ends, &arcs) ? arcs_curvature(&arcs) - curvature : NAN;
        variance += change * change;
        end[k].x = x;
    }
    result[ends + 1] = curvature;
    result[ends + 2] = sqrt(variance);
}

double arcs_band(const Arcs *arcs) { return fabs(arcs->c[1] - arcs->c[0]) / sqrt(1 + arcs->b * arcs->b); }

enum { SWEEPS = 8 };

/* A ray is parallel to a plane if its cosine with the normal is below this. */
#define GRAZING 1e-9

/* Intersection of the ray of a pixel with a plane; NaN if it is not in front of the camera. */
static void meet(const Lens *lens, double x, double y, const double plane[4], double point[3]) {
    double ray[3] = {(x - lens->cx) / lens->fx, (y - lens->cy) / lens->fy, 1};
    double cosine = plane[0] * ray[0] + plane[1] * ray[1] + plane[2];
    double length = sqrt(ray[0] * ray[0] + ray[1] * ray[1] + 1), t = plane[3] / cosine;
    if (!(fabs(cosine) >= GRAZING * length && t > 0)) t = NAN;
    for (int k = 0; k < 3; k++) point[k] = t * ray[k];
}

/* Jacobi rotation of axes i and j: their mixed moment becomes 0. */
static void turn(double moment[3][3], double axes[3][3], int i, int j) {
    if (moment[i][j] == 0) return;
    double half = (moment[j][j] - moment[i][i]) / (2 * moment[i][j]);
    double t = (half < 0 ? -1 : 1) / (fabs(half) + sqrt(half * half + 1)), c = 1 / sqrt(t * t + 1), s = t * c;
    for (int k = 0; k < 3; k++) {
        double a = moment[k][i], b = moment[k][j];
        moment[k][i] = c * a - s * b;
        moment[k][j] = s * a + c * b;
    }
    for (int k = 0; k < 3; k++) {
        double a = moment[i][k], b = moment[j][k], u = axes[i][k], v = axes[j][k];
        moment[i][k] = c * a - s * b;
        moment[j][k] = s * a + c * b;
        axes[i][k] = c * u - s * v;
        axes[j][k] = s * u + c * v;
    }
}

/* Unit normal of the best-fitting plane: eigenvector of the smallest eigenvalue of the second moments (Jacobi). */
static void nearest_normal(const double (*point)[3], int count, const double middle[3], double normal[3]) {
    double moment[3][3] = {{0}}, axes[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    for (int k = 0; k < count; k++)
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) moment[i][j] += (point[k][i] - middle[i]) * (point[k][j] - middle[j]);
    for (int sweep = 0; sweep < SWEEPS; sweep++) {
        turn(moment, axes, 0, 1);
        turn(moment, axes, 0, 2);
        turn(moment, axes, 1, 2);
    }
    int minimum = moment[1][1] < moment[0][0];
    if (moment[2][2] < moment[minimum][minimum]) minimum = 2;
    for (int k = 0; k < 3; k++) normal[k] = axes[minimum][k];
}

static void flatten_ends(const double *position, const double *planes, const Lens *lens, End *end, int count) {
    double x[MAX_ENDS], y[MAX_ENDS], point[MAX_ENDS][3], middle[3] = {0}, n[3];
    for (int k = 0; k < count; k++) {
        x[k] = position[2 * k];
        y[k] = position[2 * k + 1];
    }
    undistort(lens, x, y, (size_t)count);
    for (int k = 0; k < count; k++) {
        meet(lens, x[k], y[k], planes + 4 * k, point[k]);
        for (int i = 0; i < 3; i++) middle[i] += point[k][i] / count;
    }
    nearest_normal((const double(*)[3])point, count, middle, n);
    double length = (n[2] < 0 ? -1 : 1) * hypot(n[0], n[2]), along[2] = {n[2] / length, -n[0] / length};
    double down[3] = {n[1] * along[1], n[2] * along[0] - n[0] * along[1], -n[1] * along[0]};
    for (int k = 0; k < count; k++) {
        double a = point[k][0] - middle[0], b = point[k][1] - middle[1], c = point[k][2] - middle[2];
        end[k].x = a * along[0] + c * along[1];
        end[k].y = a * down[0] + b * down[1] + c * down[2];
        end[k].sigma = point[k][2] / lens->fx;
    }
}

/* Ends that were found, as points on their arcs; `number` is their index among all ends. */
typedef struct {
    double place[MAX_ENDS][2], light[MAX_ENDS][4];
    End end[MAX_ENDS];
    int number[MAX_ENDS], arc[2];
} SeenEnds;

static int find_seen(const Py_buffer view[3], SeenEnds *seen) {
    const double(*position)[2] = view[0].buf, (*covariance)[4] = view[1].buf, (*plane)[4] = view[2].buf;
    int count = 0, all = 2 * (int)view[0].shape[0];
    seen->arc[0] = seen->arc[1] = 0;
    for (int k = 0; k < all; k++) {
        if (isnan(position[k][0])) continue;
        memcpy(seen->place[count], position[k], sizeof position[k]);
        memcpy(seen->light[count], plane[k / 2], sizeof plane[0]);
        seen->end[count] = (End){.arc = k % 2, .used = 1, .along_sigma = sqrt(covariance[k][0])};
        seen->number[count++] = k;
        seen->arc[k % 2]++;
    }
    return count;
}

/* Sigmas in metres: along x and, with that of the circles, across. */
static void scale_sigmas(SeenEnds *seen, int count, double circle_sigma, int exact) {
    for (int i = 0; i < count; i++) {
        double metres = seen->end[i].sigma, *along = &seen->end[i].along_sigma;
        *along = metres * (count <= exact ? hypot(*along, circle_sigma) : *along);
        seen->end[i].sigma = hypot(*along, circle_sigma * metres);
    }
}

PyObject *call_arcs(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"position", 'd', {N, 2, 2}}, {"covariance", 'd', {N, 2, 2, 2}},
                                          {"planes", 'd', {N, 4}},      {"lens", 'T', {NUMBERS(Lens)}},
                                          {"circle_sigma", 'R', {0}},   {"exact", 'L', {0, INT32_MAX}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const Py_ssize_t lasers = a.view[0].shape[0];
    if (!require(lasers <= MAX_ENDS / 2, "position: there are too many lasers")) return close_arguments(&a, NULL);
    SeenEnds seen;
    double cost[MAX_ENDS + 3], without[MAX_ENDS];
    int count = find_seen(a.view, &seen);
    flatten_ends(seen.place[0], seen.light[0], (const Lens *)a.number[3], seen.end, count);
    scale_sigmas(&seen, count, a.number[4][0], (int)a.number[5][0]);
    arc_costs(seen.end, count, cost);
    for (Py_ssize_t k = 0; k < 2 * lasers; k++) without[k] = INFINITY;
    for (int i = 0; i < count; i++) without[seen.number[i]] = cost[i + 1];
    PyObject *list = PyTuple_New(2 * lasers);
    for (Py_ssize_t k = 0; list && k < 2 * lasers; k++) PyTuple_SetItem(list, k, PyFloat_FromDouble(without[k]));
    return close_arguments(
        &a, Py_BuildValue("((ii)dNdd)", seen.arc[0], seen.arc[1], cost[0], list, cost[count + 1], cost[count + 2]));
}
