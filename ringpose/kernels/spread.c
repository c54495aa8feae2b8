/* From covariances of break points to those of points in their light planes. */
#include "misfit.h"

/* dP/dpixel of P = t r: t (1 - r m^T / (m . r)), then what a pixel is of the ray, through the lens. */
static void by_pixel(const double point[3], const double light[3], const Lens *lens, double to[3][2]) {
    double x = point[0] / point[2], y = point[1] / point[2], slope[3];
    double cosine = light[0] * x + light[1] * y + light[2], ray[3] = {x, y, 1};
    distortion_slope(lens, x, y, slope);
    double part = 1 / (slope[0] * slope[2] - slope[1] * slope[1]);
    double inverse[2][2] = {{part * slope[2] / lens->fx, -part * slope[1] / lens->fy},
                            {-part * slope[1] / lens->fx, part * slope[0] / lens->fy}};
    for (int i = 0; i < 3; i++) {
        double by_ray[2];
        for (int j = 0; j < 2; j++) by_ray[j] = point[2] * ((i == j) - ray[i] * light[j] / cosine);
        for (int j = 0; j < 2; j++) to[i][j] = by_ray[0] * inverse[0][j] + by_ray[1] * inverse[1][j];
    }
}

void add_spread_m2(const Sights *sights, const double (*covariance_px2)[4], const Lens *lens, double *covariance_m2) {
    int width = 3 * sights->count;
    for (int n = 0; n < sights->count; n++) {
        const double *c = covariance_px2[n];
        double j[3][2], *block = covariance_m2 + 3 * n * width + 3 * n;
        by_pixel(sights->point_m[n], sights->light_normal[n], lens, j);
        for (int a = 0; a < 3; a++) {
            double first = j[a][0] * c[0] + j[a][1] * c[2], second = j[a][0] * c[1] + j[a][1] * c[3];
            for (int b = 0; b < 3; b++) block[a * width + b] += first * j[b][0] + second * j[b][1];
        }
    }
}
