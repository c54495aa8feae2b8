/* The paper's two closed forms. No Python in here. */
#ifndef RINGPOSE_FORMS_H
#define RINGPOSE_FORMS_H

enum { MOST_POINTS = 64, FORM_NUMBERS = 13 };

/* What both solve: points of both edges, and below which quotient of singular values the centre is damped. */
typedef struct {
    int count;
    const long long *edge; /* 0 inner, 1 outer */
    double singular_below;
} Problem;

/* Unit normal, offset, centre, radii, grasp point, q; lengths in metres. NaN for what an unseen edge would tell. */
void paper_form(const Problem *problem, const double (*points_m)[3], double form[FORM_NUMBERS]);
void constrained_form(const Problem *problem, const double (*points_m)[3], double form[FORM_NUMBERS]);

#endif
