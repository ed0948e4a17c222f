/* Arrays from Python: clouds, fields of their points, and contiguous numbers. */

#ifndef PC2SCAN_ARRAYS_H
#define PC2SCAN_ARRAYS_H

#include "fields.h"

/* Take a contiguous array of `count` numbers of `item` bytes each; of any count if `count` is negative. */
HIDDEN int contiguous(PyObject *object, Py_buffer *view, int flags, Py_ssize_t item, Py_ssize_t count);

/* The coordinates of a cloud: three arrays of one shape. */
typedef struct {
    Py_buffer coordinates[3];
    Axis axis[3];
    Py_ssize_t rows, columns;
    int held;
} Cloud;

HIDDEN int take_coordinates(Cloud *cloud, PyObject *xyz[3]);
HIDDEN void release_cloud(Cloud *cloud);

/* Take a field of the points that is not a coordinate. */
HIDDEN int take_field(const Cloud *cloud, PyObject *array, Py_buffer *view, Axis *axis);

/* Release the interpreter's lock, unless that takes longer than the work: a number of points or beams. */
static inline PyThreadState *let_others(Py_ssize_t work) { return work > 16384 ? PyEval_SaveThread() : NULL; }

#endif
