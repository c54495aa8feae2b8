/* OpenCV's distortion model and its inverse by Newton's method. */
#include "lens.h"

#include <math.h>

#include "kernels.h"

RECORD(Lens, LENS);

enum { MAX_STEPS = 20, CHUNK = 64 };
#define CLOSE 1e-5 /* normalised; Newton's next step would move by its square: 1e-7 px */

/* OpenCV's distortion of (x, y) and its derivatives: dx/dx, dx/dy, dy/dy (the mixed ones are equal). */
static inline void distort(const Lens *lens, int rational, double x, double y, double at[2], double slope[3]) {
    double r2 = x * x + y * y;
    double radial = 1 + r2 * (lens->k1 + r2 * (lens->k2 + r2 * lens->k3));
    double grow = 2 * (lens->k1 + r2 * (2 * lens->k2 + r2 * 3 * lens->k3));
    if (rational) {
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

static int is_rational(const Lens *lens) { return lens->k4 != 0 || lens->k5 != 0 || lens->k6 != 0; }

/* Points that are undistorted together: distorted and undistorted normalised coordinates, and the last step. */
typedef struct {
    double goal_x[CHUNK], goal_y[CHUNK], u[CHUNK], v[CHUNK], move[CHUNK];
} Chunk;

/* One step for all points of a chunk; inlined where it is known whether the lens is rational. */
static inline void step_all(const Lens *lens, int rational, Chunk *chunk) {
    const double *restrict goal_x = chunk->goal_x, *restrict goal_y = chunk->goal_y;
    double *restrict u = chunk->u, *restrict v = chunk->v, *restrict move = chunk->move;
    const Lens l = *lens;
    for (size_t i = 0; i < CHUNK; i++) {
        double at[2], slope[3];
        distort(&l, rational, u[i], v[i], at, slope);
        double off_x = at[0] - goal_x[i], off_y = at[1] - goal_y[i];
        double part = 1 / (slope[0] * slope[2] - slope[1] * slope[1]);
        double move_x = part * (slope[2] * off_x - slope[1] * off_y);
        double move_y = part * (slope[0] * off_y - slope[1] * off_x);
        u[i] -= move_x;
        v[i] -= move_y;
        move[i] = fabs(move_x) + fabs(move_y);
    }
}

static void step(const Lens *lens, int rational, Chunk *chunk) {
    if (rational)
        step_all(lens, 1, chunk);
    else
        step_all(lens, 0, chunk);
}

static int all_close(const Chunk *chunk) {
    int far = 0;
    for (size_t i = 0; i < CHUNK; i++) far |= chunk->move[i] > CLOSE;
    return !far;
}

/* Fills a chunk; the last point is repeated. */
static void take(const Lens *lens, const double *restrict x, const double *restrict y, size_t n, double shift_x,
                 double shift_y, Chunk *restrict chunk) {
    double per_x = 1 / lens->fx, per_y = 1 / lens->fy;
    double centre_x = lens->cx, centre_y = lens->cy;
    for (size_t i = 0; i < n; i++) {
        chunk->goal_x[i] = (x[i] - centre_x) * per_x;
        chunk->goal_y[i] = (y[i] - centre_y) * per_y;
    }
    for (size_t i = n; i < CHUNK; i++) {
        chunk->goal_x[i] = chunk->goal_x[n - 1];
        chunk->goal_y[i] = chunk->goal_y[n - 1];
    }
    for (size_t i = 0; i < CHUNK; i++) {
        chunk->u[i] = chunk->goal_x[i] + shift_x;
        chunk->v[i] = chunk->goal_y[i] + shift_y;
    }
}

void undistort(const Lens *lens, double *x, double *y, size_t n) {
    /* Neighbouring points have similar distortion: a chunk starts with the shift of the point before. */
    double shift_x = 0, shift_y = 0;
    int rational = is_rational(lens);
    Chunk chunk;
    for (size_t first = 0; first < n; first += CHUNK) {
        size_t count = n - first < CHUNK ? n - first : CHUNK;
        take(lens, x + first, y + first, count, shift_x, shift_y, &chunk);
        for (int i = 0; i < MAX_STEPS; i++) {
            step(lens, rational, &chunk);
            if (all_close(&chunk)) break;
        }
        for (size_t i = 0; i < count; i++) {
            x[first + i] = chunk.u[i] * lens->fx + lens->cx;
            y[first + i] = chunk.v[i] * lens->fy + lens->cy;
        }
        shift_x = chunk.u[count - 1] - chunk.goal_x[count - 1];
        shift_y = chunk.v[count - 1] - chunk.goal_y[count - 1];
        if (!isfinite(shift_x) || !isfinite(shift_y)) shift_x = shift_y = 0;
    }
}

void distort_pixel(const Lens *lens, double *x, double *y) {
    double at[2], slope[3];
    distort(lens, is_rational(lens), (*x - lens->cx) / lens->fx, (*y - lens->cy) / lens->fy, at, slope);
    *x = at[0] * lens->fx + lens->cx;
    *y = at[1] * lens->fy + lens->cy;
}
