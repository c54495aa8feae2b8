/* Types that the stages of the line detector share. */
#ifndef RINGPOSE_SEGMENTS_H
#define RINGPOSE_SEGMENTS_H

#include "kernels.h"

/* The gradient of a pixel comes from the 7 x 7 pixels around it, and is 0 where they leave the image. */
enum { MARGIN = 3 };

/* Units of the magnitude in one grey value per pixel: 16 of the smoothing, 8 of the Sobel weights. */
enum { STEPS_PER_DN = 16 * 8 };

typedef struct {
    int32_t x, y;
} Pixel;

typedef struct {
    int32_t first, last; /* pixels of a chain */
} Piece;

#endif
