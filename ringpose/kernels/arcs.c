/* Two short arcs about one centre; twin: reference_ring.py. */
#include "arcs.h"

#include <math.h>

/* The c are eliminated by centring each arc, which leaves two unknowns. */
int fit_arcs(const End *end, int ends, Arcs *arcs) {
    double count[2] = {0}, mean_x[2] = {0}, mean_y[2] = {0}, mean_q[2] = {0};
    for (int k = 0; k < ends; k++)
        if (end[k].used) {
            int arc = end[k].arc;
            count[arc] += 1;
            mean_x[arc] += end[k].x;
            mean_y[arc] += end[k].y;
            mean_q[arc] += end[k].x * end[k].x + end[k].y * end[k].y;
        }
    if (count[0] == 0 || count[1] == 0) return 0;
    for (int arc = 0; arc < 2; arc++) {
        mean_x[arc] /= count[arc];
        mean_y[arc] /= count[arc];
        mean_q[arc] /= count[arc];
    }
    double uu = 0, uv = 0, vv = 0, ut = 0, vt = 0;
    for (int k = 0; k < ends; k++)
        if (end[k].used) {
            int arc = end[k].arc;
            double u = end[k].x * end[k].x + end[k].y * end[k].y - mean_q[arc];
            double v = end[k].y - mean_y[arc], t = end[k].x - mean_x[arc];
            uu += u * u;
            uv += u * v;
            vv += v * v;
            ut += u * t;
            vt += v * t;
        }
    double determinant = uu * vv - uv * uv;
    arcs->a = arcs->b = 0;
    if (determinant > 1e-12 * uu * vv) {
        arcs->a = -(vv * ut - uv * vt) / determinant;
        arcs->b = -(uu * vt - uv * ut) / determinant;
    } else if (vv > 0)
        arcs->b = -vt / vv;
    for (int arc = 0; arc < 2; arc++) arcs->c[arc] = -mean_x[arc] - arcs->a * mean_q[arc] - arcs->b * mean_y[arc];
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
