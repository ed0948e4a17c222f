/* A scan to which points are projected. project.py and rule.py describe the rules. */

#ifndef PC2SCAN_SCAN_H
#define PC2SCAN_SCAN_H

#include "fields.h"

/* The limits of a scan: the array that rule.py makes and describes. */
typedef struct {
    double lowest, highest, least, most;
    double first, last, offset, turn, end, skew, increment, closed;
    double glibc;
} Rule;

/* Bins behind those of the beams, for rejected points: one for each reason that is found in the projection. */
enum { PAST_END, OUTSIDE, TOO_FAR, REASONS };

typedef struct {
    Rule rule;
    int32_t beams;
    int64_t nan, height, rejected[REASONS];
    /* Either the smallest square of each bin, */
    double *smallest;
    /* or the bin index, range and number of each return. */
    int32_t *bins;
    float *ranges;
    int64_t *numbers, gathered;
    float x[BLOCK], y[BLOCK], z[BLOCK];
    int64_t number[BLOCK];
    int filled;
} Scan;

/* Project the points of the block, and empty it. */
HIDDEN void project_block(Scan *scan);

/* Of the points of the block, from index `from` on, drop those that are NaN, too high or too low. */
HIDDEN void drop_by_height(Scan *scan, int from, int count);

/* Project points with one transform, or without. */
HIDDEN void load_rows(Scan *scan, const Axis axis[3], Py_ssize_t rows, Py_ssize_t columns, const float *transform);

#endif
