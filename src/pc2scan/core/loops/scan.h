/* A scan while points are projected to it: project.py and rule.py describe the rules. */

#ifndef PC2SCAN_SCAN_H
#define PC2SCAN_SCAN_H

#include "fields.h"

/* What points are compared with: the array that rule.py makes and explains. */
typedef struct {
    double lowest, highest, least, most;
    double first, last, offset, turn, end, skew, increment, closed;
    double glibc;
} Rule;

/* Bins behind those of the beams, for points that are rejected: one for each reason that is found this late. */
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

/* Of the points of the block from so many on: keep those that are not NaN, too high or too low. */
HIDDEN void drop_by_height(Scan *scan, int from, int count);

/* Project points at one transform, or none. */
HIDDEN void load_rows(Scan *scan, const Axis axis[3], Py_ssize_t rows, Py_ssize_t columns, const float *transform);

#endif
