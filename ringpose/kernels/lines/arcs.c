/* Two short arcs about one centre. */
#include "arcs.h"

#include <math.h>

/* What the equations of the two unknowns are made of, once the c are eliminated by centring each arc. */
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

void arc_costs(End *end, int ends, double *result) {
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
