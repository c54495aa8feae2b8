/* From distorted pixels to those of the same camera without distortion, by Newton's method. */
#include "tracks.h"

#include <math.h>

enum { MOST_STEPS = 20 };
#define CLOSE 1e-5 /* normalised; Newton's next step would move by its square: 1e-7 px */

/* OpenCV's distortion of (x, y) and its derivatives: dx/dx, dx/dy, dy/dy (the mixed ones are equal). */
static void distort(const Lens *lens, double x, double y, double at[2], double slope[3]) {
    double r2 = x * x + y * y;
    double radial = 1 + r2 * (lens->k1 + r2 * (lens->k2 + r2 * lens->k3));
    double grow = 2 * (lens->k1 + r2 * (2 * lens->k2 + r2 * 3 * lens->k3));
    if (lens->k4 != 0 || lens->k5 != 0 || lens->k6 != 0) {
        double part = 1 / (1 + r2 * (lens->k4 + r2 * (lens->k5 + r2 * lens->k6)));
        radial *= part;
        grow = part * (grow - 2 * radial * (lens->k4 + r2 * (2 * lens->k5 + r2 * 3 * lens->k6)));
    }
    at[0] = x * radial + 2 * lens->p1 * x * y + lens->p2 * (r2 + 2 * x * x);
    at[1] = y * radial + lens->p1 * (r2 + 2 * y * y) + 2 * lens->p2 * x * y;
    slope[0] = radial + x * x * grow + 2 * lens->p1 * y + 6 * lens->p2 * x;
    slope[1] = x * y * grow + 2 * lens->p1 * x + 2 * lens->p2 * y;
    slope[2] = radial + y * y * grow + 6 * lens->p1 * y + 2 * lens->p2 * x;
}

void undistort(const Lens *lens, double *x, double *y, size_t n) {
    /* Neighbours on a stripe are shifted alike: the shifts of the two points before are continued. */
    double shift_x = 0, shift_y = 0, before_x = 0, before_y = 0;
    double per_x = 1 / lens->fx, per_y = 1 / lens->fy;
    for (size_t i = 0; i < n; i++) {
        double goal_x = (x[i] - lens->cx) * per_x, goal_y = (y[i] - lens->cy) * per_y;
        double u = goal_x + 2 * shift_x - before_x, v = goal_y + 2 * shift_y - before_y;
        for (int step = 0; step < MOST_STEPS; step++) {
            double at[2], slope[3];
            distort(lens, u, v, at, slope);
            double off_x = at[0] - goal_x, off_y = at[1] - goal_y;
            double part = 1 / (slope[0] * slope[2] - slope[1] * slope[1]);
            double move_x = part * (slope[2] * off_x - slope[1] * off_y);
            double move_y = part * (slope[0] * off_y - slope[1] * off_x);
            u -= move_x;
            v -= move_y;
            if (!(fabs(move_x) + fabs(move_y) > CLOSE)) break;
        }
        before_x = shift_x;
        before_y = shift_y;
        shift_x = isfinite(u) ? u - goal_x : 0;
        shift_y = isfinite(v) ? v - goal_y : 0;
        x[i] = u * lens->fx + lens->cx;
        y[i] = v * lens->fy + lens->cy;
    }
}

void distort_pixel(const Lens *lens, double *x, double *y) {
    double at[2], slope[3];
    distort(lens, (*x - lens->cx) / lens->fx, (*y - lens->cy) / lens->fy, at, slope);
    *x = at[0] * lens->fx + lens->cx;
    *y = at[1] * lens->fy + lens->cy;
}
