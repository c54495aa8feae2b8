/* Two short arcs about one centre through points in a plane, by least squares. */
#include <math.h>

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

/* One over the radius; positive if the centre lies on the side of positive x. */
static double arcs_curvature(const Arcs *arcs) {
    double level = 1 + arcs->b * arcs->b - 2 * arcs->a * (arcs->c[0] + arcs->c[1]);
    return -2 * arcs->a / sqrt(fmax(level, 1e-12));
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

double arcs_band(const Arcs *arcs) { return fabs(arcs->c[1] - arcs->c[0]) / sqrt(1 + arcs->b * arcs->b); }
