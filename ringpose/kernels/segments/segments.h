/* The line detector: gradient, chains, straight pieces, lines. No Python in here. */
#ifndef RINGPOSE_SEGMENTS_H
#define RINGPOSE_SEGMENTS_H

#include "kernels.h"

/* The gradient of a pixel comes from the 7 x 7 pixels around it, and is 0 where they leave the image. */
enum { MARGIN = 3 };

typedef struct {
    int32_t x, y;
} Pixel;

typedef struct {
    const void *data; /* uint8_t if bits is 8, uint16_t if it is more */
    size_t height, width;
    int bits;
} Image;

typedef struct {
    List index;       /* int32_t: row * width + column */
    List orientation; /* uint8_t: 0 to 3, the walking direction along the edge */
} Anchors;

/* Each returns 0 if there is no memory, and leaves its lists to the caller. */
int find_gradient(const Image *image, int upper, int16_t *magnitude, Anchors *anchors);

typedef struct {
    int16_t *magnitude;
    size_t height, width;
    int lower; /* an edge has at least this magnitude */
} EdgeArea;

int walk_chains(const EdgeArea *area, const int32_t *anchor, const uint8_t *orientation, size_t anchors, size_t shortest,
                List *pixels, List *starts);

typedef struct {
    double deviation;    /* of estimated length from chord, pixels */
    double share_change; /* L1 difference of direction shares */
    size_t window;       /* steps */
    size_t shortest;     /* pixels */
} CutRules;

typedef struct {
    int32_t first, last; /* pixels of a chain */
} Piece;

int cut_chains(const Pixel *pixels, const int32_t *starts, size_t chains, CutRules rules, List *pieces);

typedef struct {
    const int16_t *data;
    size_t height, width;
} Magnitude;

typedef struct {
    double start_x, start_y, end_x, end_y;
} Line;

/* Sums over the points of a line. */
typedef struct {
    double count, x, y, xx, xy, yy;
} Moments;

/* The regression of y on x, if flat, or of x on y; 0 if the points do not determine one. */
int line_through(const Moments *sum, int flat, double *slope, double *offset);

int fit_pieces(const Magnitude *magnitude, const Pixel *pixels, const Piece *pieces, size_t count, size_t trim,
               List *lines, List *moments);

typedef struct {
    double gap;       /* along the line, pixels */
    double aside;     /* of an end from the joined line, pixels */
    int64_t shortest; /* pixels of a line to which others are joined */
} JoinRules;

/* `ends`: x and y of the start and of the end of each line. */
int join_lines(const double *ends, const Moments *moments, const Piece *pieces, size_t count, JoinRules rules,
               List *joined, List *support);

#endif
