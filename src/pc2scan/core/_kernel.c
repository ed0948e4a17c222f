/* The projection's inner loop. The rules are told in project.py and grid.py; what is here is how to keep them fast.

   Points are taken a block at a time, small enough for the first-level cache: load and drop by height, one loop;
   then squares, angles and slots, loops without branches that compilers turn into vector instructions; then the
   minimum of each slot. Compiled with -ffp-contract=off: a fused multiply-add rounds otherwise than upstream does. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && __GNUC__ >= 12 && !defined(__clang__)
/* The same loops with wider vectors, chosen when the module is loaded. */
#define WIDEST __attribute__((target_clones("default", "arch=x86-64-v3", "arch=x86-64-v4")))
#else
#define WIDEST
#endif

enum { BLOCK = 512 };

/* atan(t) / t in powers of t * t, for t from 0 to 1: Chebyshev interpolation at 15 nodes. Its relative error is below
   2.9e-13; with some roundings of 1.1e-16 the angle's stays below this. */
#define ANGLE_ERROR 4e-13
static const double ATAN[15] = {
    0x1.ffffffffff5ccp-1,  -0x1.5555555316212p-2, 0x1.999998469d323p-3,  -0x1.24922161af34dp-3, 0x1.c717834559cfep-4,
    -0x1.742d65ac65c77p-4, 0x1.39e23d1599a8ep-4,  -0x1.0bb9539dc5436p-4, 0x1.bf2393efe8459p-5,  -0x1.5ab9279e2b201p-5,
    0x1.d17abe7889664p-6,  -0x1.f323674b044a5p-7, 0x1.850bdf56a80b6p-8,  -0x1.807a77421f2f7p-10, 0x1.657b3ba0095aep-13,
};

/* float32(atan2(y, x)) of up to BLOCK points, none of them NaN. */
WIDEST static void angles_of(const float *restrict x, const float *restrict y, float *restrict angle, int count) {
    int32_t unsure[BLOCK];
    int32_t any = 0;
    for (int i = 0; i < count; i++) {
        double across = x[i], up = y[i];
        double a = fabs(across), b = fabs(up);
        double longer = a > b ? a : b, shorter = a > b ? b : a;
        double t = shorter / longer, u = t * t, sum = ATAN[14];
        for (int k = 13; k >= 0; k--) sum = sum * u + ATAN[k];
        double turn = t * sum;
        turn = b > a ? 0x1.921fb54442d18p+0 - turn : turn;
        turn = copysign(1.0, across) < 0 ? 0x1.921fb54442d18p+1 - turn : turn;
        float low = (float)(turn - turn * ANGLE_ERROR), high = (float)(turn + turn * ANGLE_ERROR);
        angle[i] = copysignf(low, y[i]);
        /* False for NaN too, which is what 0 / 0 and inf / inf end as. */
        unsure[i] = !(low == high);
        any |= unsure[i];
    }
    if (any)
        for (int i = 0; i < count; i++)
            if (unsure[i]) angle[i] = (float)atan2((double)y[i], (double)x[i]);
}

/* What points are compared with; in the order of project.py's array. */
typedef struct {
    double lowest, highest, least, most, angle_min, angle_max, angle_increment;
} Limits;

/* Slots behind the beams: the fates of points that are in none. */
enum { PAST_END, OUTSIDE, TOO_FAR, FATES };

typedef struct {
    Limits limits;
    double *smallest; /* the smallest square of each beam, and of each fate */
    int32_t beams;
    int64_t nan, height, fates[FATES];
    float x[BLOCK], y[BLOCK], z[BLOCK];
    int filled;
} Scan;

WIDEST static void project_block(Scan *scan) {
    const Limits limits = scan->limits;
    const int count = scan->filled;
    const int32_t beams = scan->beams;
    const float first = (float)limits.angle_min, last = (float)limits.angle_max;
    double squares[BLOCK];
    float angle[BLOCK];
    int32_t slot[BLOCK], lost[FATES] = {0, 0, 0};
    /* float64 holds the squares of float32 exactly, and libm's hypotf adds them in float64. */
    for (int i = 0; i < count; i++) squares[i] = (double)scan->x[i] * scan->x[i] + (double)scan->y[i] * scan->y[i];
    angles_of(scan->x, scan->y, angle, count);
    for (int i = 0; i < count; i++) {
        double quotient = ((double)angle[i] - limits.angle_min) / limits.angle_increment;
        /* Outside the sector the quotient may be beyond the integers. */
        int32_t outside = (angle[i] < first) | (angle[i] > last);
        int32_t index = (int32_t)(outside ? 0.0 : quotient);
        index = index < beams ? index : beams + PAST_END;
        slot[i] = outside ? beams + OUTSIDE : index;
    }
    for (int i = 0; i < count; i++) {
        int32_t away = !((squares[i] >= limits.least) & (squares[i] <= limits.most));
        slot[i] = away ? beams + TOO_FAR : slot[i];
    }
    for (int i = 0; i < count; i++) {
        lost[PAST_END] += slot[i] == beams + PAST_END;
        lost[OUTSIDE] += slot[i] == beams + OUTSIDE;
        lost[TOO_FAR] += slot[i] == beams + TOO_FAR;
    }
    for (int i = 0; i < count; i++)
        if (squares[i] < scan->smallest[slot[i]]) scan->smallest[slot[i]] = squares[i];
    for (int fate = 0; fate < FATES; fate++) scan->fates[fate] += lost[fate];
    scan->filled = 0;
}

/* One coordinate of a cloud: rows of columns, strided and unaligned. */
typedef struct {
    const char *data;
    Py_ssize_t row_step, step;
} Axis;

static inline double read_double(const char *from) {
    double value;
    memcpy(&value, from, sizeof value);
    return value;
}

static inline float read_float(const char *from) {
    float value;
    memcpy(&value, from, sizeof value);
    return value;
}

static inline double read_either(const char *from, int doubles) { return doubles ? read_double(from) : read_float(from); }

/* Drop points that are NaN or too high or low: from so many of them on, in place. */
WIDEST static void drop_by_height(Scan *scan, const int from, const int count) {
    const float lowest = (float)scan->limits.lowest, highest = (float)scan->limits.highest;
    float *restrict x = scan->x + from, *restrict y = scan->y + from;
    const float *restrict z = scan->z + from;
    int32_t keep[BLOCK], nans = 0, kept = 0;
    for (int i = 0; i < count; i++) {
        int32_t nan = (x[i] != x[i]) | (y[i] != y[i]) | (z[i] != z[i]);
        keep[i] = !nan & (z[i] >= lowest) & (z[i] <= highest);
        nans += nan;
        kept += keep[i];
    }
    scan->nan += nans;
    scan->height += count - nans - kept;
    scan->filled = from + kept;
    if (kept == count || kept == 0) return;
    for (int i = 0, to = 0; i < count; i++) {
        x[to] = x[i];
        y[to] = y[i];
        to += keep[i];
    }
}

/* Take points of one row. Inlined, so that compilers know of each call whether it has doubles and has to move. */
static inline void load(Scan *scan, const char *x, const char *y, const char *z, const Axis axis[3], Py_ssize_t count,
                        const int doubles, const double *move) {
    const Py_ssize_t dx = axis[0].step, dy = axis[1].step, dz = axis[2].step;
    while (count > 0) {
        const int filled = scan->filled;
        const int take = count < BLOCK - filled ? (int)count : BLOCK - filled;
        float *restrict to_x = scan->x + filled, *restrict to_y = scan->y + filled, *restrict to_z = scan->z + filled;
        for (int i = 0; i < take; i++) {
            if (move) {
                double sx = read_either(x, doubles), sy = read_either(y, doubles), sz = read_either(z, doubles);
                to_x[i] = (float)(sx * move[0] + sy * move[1] + sz * move[2] + move[9]);
                to_y[i] = (float)(sx * move[3] + sy * move[4] + sz * move[5] + move[10]);
                to_z[i] = (float)(sx * move[6] + sy * move[7] + sz * move[8] + move[11]);
            } else {
                to_x[i] = (float)read_either(x, doubles);
                to_y[i] = (float)read_either(y, doubles);
                to_z[i] = (float)read_either(z, doubles);
            }
            x += dx, y += dy, z += dz;
        }
        drop_by_height(scan, filled, take);
        if (scan->filled == BLOCK) project_block(scan);
        count -= take;
    }
}

static void load_rows(Scan *scan, const Axis axis[3], Py_ssize_t rows, Py_ssize_t columns, int doubles, const double *move) {
    for (Py_ssize_t row = 0; row < rows; row++) {
        const char *x = axis[0].data + row * axis[0].row_step;
        const char *y = axis[1].data + row * axis[1].row_step;
        const char *z = axis[2].data + row * axis[2].row_step;
        if (doubles && move) load(scan, x, y, z, axis, columns, 1, move);
        else if (doubles) load(scan, x, y, z, axis, columns, 1, NULL);
        else if (move) load(scan, x, y, z, axis, columns, 0, move);
        else load(scan, x, y, z, axis, columns, 0, NULL);
    }
    if (scan->filled) project_block(scan);
}

/* A contiguous array of doubles or floats from Python. */
static int contiguous(PyObject *object, Py_buffer *view, int flags, Py_ssize_t item, Py_ssize_t count) {
    if (PyObject_GetBuffer(object, view, flags | PyBUF_C_CONTIGUOUS) < 0) return -1;
    if (view->itemsize == item && (count < 0 || view->len == count * item)) return 0;
    PyBuffer_Release(view);
    PyErr_SetString(PyExc_ValueError, "an array has another length or item size than expected");
    return -1;
}

static PyObject *project(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *objects[3], *limits_of, *move_of, *ranges_of, *result = NULL;
    float no_return;
    if (!PyArg_ParseTuple(args, "OOOOOOf", &objects[0], &objects[1], &objects[2], &limits_of, &move_of, &ranges_of,
                          &no_return))
        return NULL;
    Py_buffer coordinates[3], limits, move, ranges;
    Axis axis[3];
    int held = 0;
    Scan *scan = NULL;
    for (; held < 3; held++) {
        Py_buffer *view = &coordinates[held];
        if (PyObject_GetBuffer(objects[held], view, PyBUF_STRIDES) < 0) goto release;
        int same = view->ndim == coordinates[0].ndim && view->itemsize == coordinates[0].itemsize;
        for (int i = 0; same && i < view->ndim; i++) same = view->shape[i] == coordinates[0].shape[i];
        if (!same || view->ndim < 1 || view->ndim > 2 || (view->itemsize != 4 && view->itemsize != 8)) {
            PyBuffer_Release(view);
            PyErr_SetString(PyExc_ValueError, "coordinates are not three arrays of one shape and type");
            goto release;
        }
        axis[held].data = view->buf;
        axis[held].step = view->strides[view->ndim - 1];
        axis[held].row_step = view->ndim == 2 ? view->strides[0] : 0;
    }
    if (contiguous(limits_of, &limits, PyBUF_SIMPLE, 8, sizeof(Limits) / 8) < 0) goto release;
    if (move_of != Py_None && contiguous(move_of, &move, PyBUF_SIMPLE, 8, 12) < 0) goto release_limits;
    if (contiguous(ranges_of, &ranges, PyBUF_WRITABLE, 4, -1) < 0) goto release_move;
    int32_t beams = (int32_t)(ranges.len / 4);
    scan = PyMem_Malloc(sizeof *scan + (size_t)(beams + FATES) * sizeof(double));
    if (!scan) {
        PyErr_NoMemory();
        goto release_ranges;
    }
    memset(scan, 0, sizeof *scan);
    memcpy(&scan->limits, limits.buf, sizeof scan->limits);
    scan->smallest = (double *)(scan + 1);
    scan->beams = beams;
    Py_ssize_t rows = coordinates[0].ndim == 2 ? coordinates[0].shape[0] : 1;
    Py_ssize_t columns = coordinates[0].shape[coordinates[0].ndim - 1];
    Py_BEGIN_ALLOW_THREADS
    for (int32_t i = 0; i < beams + FATES; i++) scan->smallest[i] = INFINITY;
    load_rows(scan, axis, rows, columns, coordinates[0].itemsize == 8, move_of == Py_None ? NULL : move.buf);
    float *range = ranges.buf;
    for (int32_t i = 0; i < beams; i++) {
        float root = (float)sqrt(scan->smallest[i]);
        range[i] = root < no_return ? root : no_return;
    }
    Py_END_ALLOW_THREADS
    result = Py_BuildValue("(LLLLL)", (long long)scan->nan, (long long)scan->height, (long long)scan->fates[TOO_FAR],
                           (long long)scan->fates[OUTSIDE], (long long)scan->fates[PAST_END]);
    PyMem_Free(scan);
release_ranges:
    PyBuffer_Release(&ranges);
release_move:
    if (move_of != Py_None) PyBuffer_Release(&move);
release_limits:
    PyBuffer_Release(&limits);
release:
    while (held > 0) PyBuffer_Release(&coordinates[--held]);
    return result;
}

static PyObject *angles(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *objects[3];
    if (!PyArg_ParseTuple(args, "OOO", &objects[0], &objects[1], &objects[2])) return NULL;
    Py_buffer x, y, out;
    if (contiguous(objects[0], &x, PyBUF_SIMPLE, 4, -1) < 0) return NULL;
    PyObject *result = NULL;
    if (contiguous(objects[1], &y, PyBUF_SIMPLE, 4, x.len / 4) < 0) goto release_x;
    if (contiguous(objects[2], &out, PyBUF_WRITABLE, 4, x.len / 4) < 0) goto release_y;
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t from = 0; from < x.len / 4; from += BLOCK) {
        Py_ssize_t left = x.len / 4 - from;
        angles_of((const float *)x.buf + from, (const float *)y.buf + from, (float *)out.buf + from,
                  left < BLOCK ? (int)left : BLOCK);
    }
    Py_END_ALLOW_THREADS
    result = Py_NewRef(Py_None);
    PyBuffer_Release(&out);
release_y:
    PyBuffer_Release(&y);
release_x:
    PyBuffer_Release(&x);
    return result;
}

static PyMethodDef methods[] = {
    {"project", project, METH_VARARGS,
     "project(x, y, z, limits, move, ranges, no_return) -> (nan, height, range, angle, past_end)"},
    {"angles", angles, METH_VARARGS, "angles(x, y, out): float32(atan2(y, x)) of contiguous float32, none of them NaN"},
    {NULL, NULL, 0, NULL},
};

static PyModuleDef_Slot slots[] = {{0, NULL}};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_kernel", NULL, 0, methods, slots, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__kernel(void) { return PyModuleDef_Init(&module); }
