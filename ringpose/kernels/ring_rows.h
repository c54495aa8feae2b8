/* What a ring predicts of stripes and break points, with all derivatives. No Python in here. */
#ifndef RINGPOSE_RING_ROWS_H
#define RINGPOSE_RING_ROWS_H

enum { STATE = 7, ORIGIN_NUMBERS = 18 };

typedef struct {
    double plane[3], outward[3], shift, curvature, band;
} RingState;

/* Sights: the lines' ends, then the break points, with their light planes. */
typedef struct {
    int ends, points;
    const double (*ray)[3];
    const double (*light)[4];            /* normal and distance of the light plane */
    const double *whitening;             /* ends x ends, blocks of two on the diagonal */
    const double (*point)[2];            /* -1 or +1 for the edge, standard deviation of the abscissa */
} Sighted;

/* Points of the ring's visible edges. */
typedef struct {
    int count;
    const double (*ray)[3];
    const double (*edge)[3]; /* -1 or +1, and the displacement by one standard deviation across the edge */
} VisibleEdges;

/* Where the numbers of a prediction go. */
typedef struct {
    double *residual, (*by_state)[STATE]; /* of ends and points */
    double *slope, *steepness, (*y_by_plane)[3], (*ray)[3]; /* of sights */
    double *distance, (*by_ray)[2], (*arc_by_state)[STATE], *by_x, *scale; /* of points */
    double *origin; /* position, its derivatives by the plane, by the mean ray */
} Prediction;

/* How many numbers a prediction has, and where each of them goes in one array. */
int prediction_numbers(int ends, int points);
void lay_out(double *to, int ends, int points, Prediction *laid);

void predict(const RingState *state, const Sighted *sighted, const Prediction *to);

/* Of that where the stripes run: slope, steepness, ray, y_by_plane. */
void predict_lines(const RingState *state, const Sighted *sighted, const Prediction *to);

/* Distances of visible edges from their circles, in standard deviations, with all derivatives. */
void compare_edges(const RingState *state, const VisibleEdges *edges, const double *origin, double *residual,
                   double (*by_state)[STATE]);

#endif
