/* How a sensor moved while it measured a cloud, and where points are at their own times. rigid.py describes both. */

#ifndef PC2SCAN_MOVING_H
#define PC2SCAN_MOVING_H

#include "arrays.h"
#include "scan.h"

/* Products and sums of numbers below this do not become infinite or NaN. */
#define TAME 1e18f

/* A part of the time in which a cloud was measured. In it, the transform is a polynomial of the time: start + s *
   (rate + s * bend), with s from 0 to 1. Each coefficient has twelve numbers: the rows of a rotation, then a
   translation. */
typedef struct {
    /* A time belongs to the first part that does not end before it: times after `after` up to `end`. Only the first
       part has the time of its beginning, which many points may have: drivers write 0 where nothing was measured. */
    double begin, after, end, scale;
    /* Whether there is a transform, and whether all of its numbers are below TAME. */
    int known, tame;
    double start[12];
    float rate[12], bend[12];
} Part;

/* How a sensor moved while it measured a cloud. */
typedef struct {
    Py_buffer times_of, nodes, rows;
    int held;
    Axis times;
    /* Seconds are (value - offset) * unit. */
    double offset, unit;
    Part *parts;
    Py_ssize_t count;
    /* The part of the latest point. */
    Py_ssize_t part;
    /* How many points with coordinates have no time, and how many have no transform at their time. */
    int64_t untimed, nowhere;
    /* If z of a moved point is outside these limits, its x and y may have any value. */
    float lowest, highest;
    /* Whether all points have times between those of the nodes, and all parts are known and tame. */
    int timed, whole;
    /* z of any point at any time is row[0] * x + row[1] * y + row[2] * z + row[3], with an error of at most slope *
       (|x| + |y| + |z|) + level. */
    float row[4], slope, level;
} Motion;

/* Points of a block, and where they are at their own times. */
typedef struct {
    float x[PADDED], y[PADDED], z[PADDED], to_x[PADDED], to_y[PADDED], to_z[PADDED];
    double times[PADDED];
    /* For chosen points only: how many there are, and their numbers in their row. */
    int filled;
    int32_t number[PADDED];
} Moved;

/* Take a motion from Python: a MovingTransform; see rigid.py. It must be released even if this fails. */
HIDDEN int take_motion(Motion *motion, const Cloud *cloud, PyObject *tuple);
HIDDEN void release_motion(Motion *motion);

/* Project points at their own times. */
HIDDEN void load_moving(Scan *scan, const Cloud *cloud, Motion *motion);

/* Write the coordinates of points at their own times. */
HIDDEN void deskew_cloud(const Cloud *cloud, Motion *motion, float *out);

#endif
