/* Two short arcs about one centre through points in a plane, by least squares. The equation is linear in bend, lean and
   the two levels, is regular for straight arcs, and its residual is a distance along x. The usual algebraic fit |P|^2 =
   2 C . P + k has neither property: it is biased towards small circles, severely for points nearly on a line. */
#include "arguments.h"

#include <math.h>
#include <stdlib.h>

#include "arcs.h"

/* Moments of the normal equations for bend and lean; the levels are eliminated by centring each arc: u is x^2 + y^2, v
   is y, and t is x. */
typedef struct {
    double mean_x[2], mean_y[2], mean_q[2];
    double uu, uv, vv, ut, vt;
} Moments;

/* Returns 0 if an arc has no point. */
static int moments_of(const ArcPoint *point, int count, Moments *m) {
    double of_arc[2] = {0};
    *m = (Moments){.uu = 0};
    for (int k = 0; k < count; k++)
        if (point[k].used) {
            int arc = point[k].arc;
            of_arc[arc] += 1;
            m->mean_x[arc] += point[k].x;
            m->mean_y[arc] += point[k].y;
            m->mean_q[arc] += point[k].x * point[k].x + point[k].y * point[k].y;
        }
    if (of_arc[0] == 0 || of_arc[1] == 0) return 0;
    for (int arc = 0; arc < 2; arc++) {
        m->mean_x[arc] /= of_arc[arc];
        m->mean_y[arc] /= of_arc[arc];
        m->mean_q[arc] /= of_arc[arc];
    }
    for (int k = 0; k < count; k++)
        if (point[k].used) {
            int arc = point[k].arc;
            double u = point[k].x * point[k].x + point[k].y * point[k].y - m->mean_q[arc];
            double v = point[k].y - m->mean_y[arc], t = point[k].x - m->mean_x[arc];
            m->uu += u * u;
            m->uv += u * v;
            m->vv += v * v;
            m->ut += u * t;
            m->vt += v * t;
        }
    return 1;
}

static void solve_arcs(const Moments *m, int straight, Arcs *arcs) {
    double determinant = m->uu * m->vv - m->uv * m->uv;
    arcs->bend = arcs->lean = 0;
    if (!straight && determinant > 1e-12 * m->uu * m->vv) {
        arcs->bend = -(m->vv * m->ut - m->uv * m->vt) / determinant;
        arcs->lean = -(m->uu * m->vt - m->uv * m->ut) / determinant;
    } else if (m->vv > 0)
        arcs->lean = -m->vt / m->vv;
    for (int arc = 0; arc < 2; arc++)
        arcs->level[arc] = -m->mean_x[arc] - arcs->bend * m->mean_q[arc] - arcs->lean * m->mean_y[arc];
}

/* One over the radius; positive if the centre lies on the side of positive x. */
static double arcs_curvature(const Arcs *arcs) {
    double level = 1 + arcs->lean * arcs->lean - 2 * arcs->bend * (arcs->level[0] + arcs->level[1]);
    return -2 * arcs->bend / sqrt(fmax(level, 1e-12));
}

int fit_arcs(const ArcPoint *point, int count, double min_radius, Arcs *arcs) {
    Moments moments;
    if (!moments_of(point, count, &moments)) return 0;
    solve_arcs(&moments, 0, arcs);
    if (fabs(arcs_curvature(arcs)) > 1 / min_radius) solve_arcs(&moments, 1, arcs);
    return 1;
}

double outside_arc(const Arcs *arcs, const ArcPoint *point) {
    double x = point->x, y = point->y, residual = arcs->bend * (x * x + y * y) + x + arcs->lean * y + arcs->level[point->arc];
    return residual / fmax(hypot(2 * arcs->bend * x + 1, 2 * arcs->bend * y + arcs->lean), 1e-9);
}

TABLE(Arcs, ARCS_COLUMNS);

PyObject *call_arcs(PyObject *module, PyObject *tuple) {
    (void)module;
    static const Parameter parameter[] = {{"points", FLOAT64, {M, N, 2}}, {"arc", INT64, {N}}, {">arcs", FLOAT64, {M, NUMBERS(Arcs)}}};
    Arguments a;
    if (!OPEN(tuple, parameter, &a)) return NULL;
    const size_t count = (size_t)a.view[0].shape[1];
    const double(*at)[2] = a.view[0].buf;
    const int64_t *arc = a.view[1].buf;
    ArcPoint *point = malloc((count + 1) * sizeof *point);
    int fits = 1;
    for (size_t k = 0; fits && k < count; k++) fits = require(arc[k] == 0 || arc[k] == 1, "arc: must be 0 or 1");
    for (Py_ssize_t i = 0; point && fits && i < a.view[0].shape[0]; i++, at += count) {
        for (size_t k = 0; k < count; k++) point[k] = (ArcPoint){at[k][0], at[k][1], (int)arc[k], 1};
        fits = require(fit_arcs(point, (int)count, 0, (Arcs *)a.view[2].buf + i), "arc: one has no point");
    }
    if (!point) PyErr_NoMemory();
    free(point);
    return close_arguments(&a, point && fits ? Py_NewRef(Py_None) : NULL);
}
