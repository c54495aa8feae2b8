/* Ends of stripes in the plane nearest to them. */
#include "arcs.h"

#include <math.h>

enum { SWEEPS = 8 };

/* A ray whose cosine with a plane's normal is below this runs along the plane. */
#define GRAZING 1e-9

/* Where the ray of a pixel meets a plane; NaN if it does not before the camera. */
static void meet(const Lens *lens, double x, double y, const double plane[4], double point[3]) {
    double ray[3] = {(x - lens->cx) / lens->fx, (y - lens->cy) / lens->fy, 1};
    double cosine = plane[0] * ray[0] + plane[1] * ray[1] + plane[2];
    double length = sqrt(ray[0] * ray[0] + ray[1] * ray[1] + 1), t = plane[3] / cosine;
    if (!(fabs(cosine) >= GRAZING * length && t > 0)) t = NAN;
    for (int k = 0; k < 3; k++) point[k] = t * ray[k];
}

/* Turns axes i and j so that their mixed moment vanishes (Jacobi). */
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

/* Unit normal of the plane nearest to points about their middle. */
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
    int least = moment[1][1] < moment[0][0];
    if (moment[2][2] < moment[least][least]) least = 2;
    for (int k = 0; k < 3; k++) normal[k] = axes[least][k];
}

void flatten_ends(const double *position, const double *planes, const Lens *lens, End *end, int count) {
    double x[MOST_ENDS], y[MOST_ENDS], point[MOST_ENDS][3], middle[3] = {0}, n[3];
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
