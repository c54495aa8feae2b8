/* The paper's two closed forms. No Python in here. */
#ifndef RINGPOSE_FORMS_H
#define RINGPOSE_FORMS_H

enum { MOST_POINTS = 64, FORM_NUMBERS = 13, SOLUTION_NUMBERS = 13, PLANE_NUMBERS = 7 };

enum { NORMAL = 0, OFFSET = 3, CENTER = 4, RADIUS = 7, GRASP = 9, QUOTIENT = 12 };

/* What both solve: points of both edges, and below which quotient of singular values the centre is damped. */
typedef struct {
    int count;
    const long long *edge; /* 0 inner, 1 outer */
    double singular_below;
    int regular; /* its quotient is known to be larger: neither computed nor told (NaN) */
} Problem;

/* Unit normal, offset, centre, radii, grasp point, q; lengths in metres. NaN for what an unseen edge would tell. */
void paper_form(const Problem *problem, const double (*points_m)[3], double form[FORM_NUMBERS]);
void constrained_form(const Problem *problem, const double (*points_m)[3], double form[FORM_NUMBERS]);

/* The plane nearest to points: unit normal of either sign, distance, and the singular values of the centred points. */
void nearest_plane(const double (*points_m)[3], int count, double plane[PLANE_NUMBERS]);

/* One of these forms, and by central differences its derivatives by the points' coordinates x1 y1 z1 x2 ...: row after
   row of tilts, offset, centre along the tilt basis, radii, centre and grasp point. `step` is in units of the points'
   largest distance from their mean. */
typedef void (*Form)(const Problem *problem, const double (*points_m)[3], double form[FORM_NUMBERS]);
void form_derivatives(Form solve, const Problem *problem, const double (*points_m)[3], double step,
                      double form[FORM_NUMBERS], double *jacobian);

#endif
