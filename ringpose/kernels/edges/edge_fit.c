/* The arcs that explain break points, the stripes' lines, and edge points, by robust least squares. */
#include "edges.h"

#include <math.h>
#include <string.h>

#include "cholesky.h"

typedef struct {
    double matrix[STATE][STATE], side[STATE]; /* the lower triangle */
} Equations;

static double dot(const double a[AXES], const double b[AXES]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void add_row(Equations *equations, const double row[STATE], double residual, double weight) {
    for (int i = 0; i < STATE; i++) {
        const double weighted = weight * row[i];
        for (int j = 0; j <= i; j++) equations->matrix[i][j] += weighted * row[j];
        equations->side[i] += weighted * residual;
    }
}

static void add_sights(const Evidence *evidence, double outlier_sigmas, const RingArcs *arcs, Equations *equations) {
    for (size_t k = 0; k < evidence->sights; k++) {
        double row[STATE];
        const double per = 1 / evidence->sigma[k];
        const double residual = off_face(arcs, evidence->ray + AXES * k, evidence->side[k], row) * per;
        const double excess = residual / outlier_sigmas, root = 1 / (1 + excess * excess);
        for (int i = 0; i < STATE; i++) row[i] *= per;
        add_row(equations, row, residual, root * root);
    }
}

static void add_plane(const Evidence *evidence, const RingArcs *arcs, Equations *equations) {
    for (size_t k = 0; k < evidence->plane_points; k++) {
        double offset[AXES];
        for (int i = 0; i < AXES; i++) offset[i] = evidence->plane_point[AXES * k + i] - arcs->origin[i];
        const double per = 1 / evidence->plane_sigma[k];
        const double row[STATE] = {dot(offset, arcs->axes[0]) * per, dot(offset, arcs->axes[1]) * per, -per};
        add_row(equations, row, dot(offset, arcs->axes[2]) * per, 1);
    }
}

static void add_priors(const Evidence *evidence, const FitRules *rules, const RingArcs *arcs, Equations *equations) {
    const double *across = evidence->reference, *along = evidence->reference + AXES;
    const double *tilted[2] = {across, along};
    for (int i = 0; i < 2; i++) {
        const double row[STATE] = {dot(tilted[i], arcs->axes[0]) / rules->tilt_sigma,
                                   dot(tilted[i], arcs->axes[1]) / rules->tilt_sigma};
        add_row(equations, row, dot(tilted[i], arcs->axes[2]) / rules->tilt_sigma, 1);
    }
    const double turn[STATE] = {0, 0, 0, 0, dot(arcs->axes[1], along) / rules->turn_sigma};
    add_row(equations, turn, dot(arcs->axes[0], along) / rules->turn_sigma, 1);
    const double bend[STATE] = {0, 0, 0, 0, 0, 1 / rules->curvature_sigma};
    add_row(equations, bend, arcs->curvature / rules->curvature_sigma, 1);
    const double band[STATE] = {0, 0, 0, 0, 0, 0, 1 / rules->half_band_sigma};
    add_row(equations, band, (arcs->half_band - rules->half_band) / rules->half_band_sigma, 1);
}

/* Cayley's transform of a turn, which keeps the axes at right angles. */
static void turn_axes(const double turn[AXES], RingArcs *arcs) {
    const double x = turn[0], y = turn[1], z = turn[2], part = 1 / (1 + (x * x + y * y + z * z) / 4);
    const double skew[AXES][AXES] = {{0, z, -x}, {-z, 0, -y}, {x, y, 0}};
    double turned[AXES][AXES];
    for (int i = 0; i < AXES; i++)
        for (int k = 0; k < AXES; k++) {
            turned[i][k] = arcs->axes[i][k];
            for (int j = 0; j < AXES; j++) {
                const double square = skew[i][0] * skew[0][j] + skew[i][1] * skew[1][j] + skew[i][2] * skew[2][j];
                turned[i][k] += part * (skew[i][j] + square / 2) * arcs->axes[j][k];
            }
        }
    memcpy(arcs->axes, turned, sizeof turned);
}

static void move(const double step[STATE], RingArcs *arcs) {
    for (int i = 0; i < AXES; i++) arcs->origin[i] += step[2] * arcs->axes[2][i] + step[3] * arcs->axes[0][i];
    turn_axes((const double[AXES]){step[0], step[1], step[4]}, arcs);
    arcs->curvature += step[5];
    arcs->half_band += step[6];
}

void fit_ring_arcs(const Evidence *evidence, const FitRules *rules, RingArcs *arcs, double *covariance) {
    Equations equations;
    for (int round = 0; round < (int)rules->rounds; round++) {
        memset(&equations, 0, sizeof equations);
        add_sights(evidence, rules->outlier_sigmas, arcs, &equations);
        add_plane(evidence, arcs, &equations);
        add_priors(evidence, rules, arcs, &equations);
        if (!factorised(equations.matrix[0], STATE)) equations.matrix[0][0] = NAN; /* and so will be all solutions */
        solve(equations.matrix[0], STATE, equations.side, 1);
        for (int i = 0; i < STATE; i++) {
            const double step = -equations.side[i], most = rules->longest[i];
            equations.side[i] = step > most ? most : step < -most ? -most : step;
        }
        move(equations.side, arcs);
    }
    for (int i = 0; i < STATE; i++) {
        double *row = covariance + STATE * i;
        memset(row, 0, STATE * sizeof *row);
        row[i] = 1;
        solve(equations.matrix[0], STATE, row, 1);
    }
}
