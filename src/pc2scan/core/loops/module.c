/* The module pc2scan.core._kernel: the functions of plain.py, with the same results, but faster. Only this file and
   arrays.c handle Python's objects, besides follow.c, span.c and trace.c, which have functions of their own.

   Points are processed in blocks that fit into the first-level cache. loading.c reads points, transforms them, and
   drops them by height; moving.c does the same at each point's own time; scan.c projects the remaining ones. Compile
   with -ffp-contract=off: a fused multiply-add rounds differently from upstream. */

#include "angles.h"
#include "arrays.h"
#include "functions.h"
#include "moving.h"
#include "scan.h"

#ifdef EIGHT
uint64_t together[256];
int eight_at_once, sixteen_at_once;

int prepare_lanes(int most) {
    for (int set = 0; set < 256; set++) {
        together[set] = 0;
        for (int lane = 0, to = 0; lane < 8; lane++)
            if (set >> lane & 1) together[set] |= (uint64_t)lane << 8 * to++;
    }
    eight_at_once = most >= 8 && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("popcnt");
    sixteen_at_once = most >= 16 && eight_at_once && __builtin_cpu_supports("avx512f") &&
                      __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") &&
                      __builtin_cpu_supports("avx512bw");
    return sixteen_at_once ? 16 : eight_at_once ? 8 : 1;
}
#else
static int prepare_lanes(int most) {
    (void)most;
    return 1;
}
#endif

/* The arguments of a projection: a cloud, the rule, and the transform. */
typedef struct {
    Cloud cloud;
    Motion motion;
    Py_buffer rule, transform;
    int has_transform, has_motion;
} Asked;

static void release(Asked *asked) {
    release_cloud(&asked->cloud);
    if (asked->rule.obj) PyBuffer_Release(&asked->rule);
    if (asked->has_transform) PyBuffer_Release(&asked->transform);
    if (asked->has_motion) release_motion(&asked->motion);
}

static int take(Asked *asked, PyObject *xyz[3], PyObject *rule, PyObject *transform) {
    memset(asked, 0, sizeof *asked);
    if (take_coordinates(&asked->cloud, xyz) < 0) return -1;
    if (contiguous(rule, &asked->rule, PyBUF_SIMPLE, 8, sizeof(Rule) / 8) < 0) {
        asked->rule.obj = NULL;
        goto failed;
    }
    if (PyTuple_Check(transform)) {
        asked->has_motion = 1;
        if (take_motion(&asked->motion, &asked->cloud, transform) < 0) goto failed;
    } else if (transform != Py_None) {
        if (contiguous(transform, &asked->transform, PyBUF_SIMPLE, 4, 12) < 0) goto failed;
        asked->has_transform = 1;
    }
    return 0;
failed:
    release(asked);
    return -1;
}

/* Allocate a scan, with room for some doubles behind it. */
static Scan *new_scan(const Asked *asked, int32_t beams, size_t doubles) {
    Scan *scan = PyMem_Malloc(sizeof *scan + doubles * sizeof(double));
    if (!scan) {
        PyErr_NoMemory();
        return NULL;
    }
    memset(scan, 0, sizeof *scan);
    memcpy(&scan->rule, asked->rule.buf, sizeof scan->rule);
    scan->beams = beams;
    return scan;
}

static void run(Scan *scan, Asked *asked) {
    const Cloud *cloud = &asked->cloud;
    if (asked->has_motion) load_moving(scan, cloud, &asked->motion);
    else load_rows(scan, cloud->axis, cloud->rows, cloud->columns, asked->has_transform ? asked->transform.buf : NULL);
}

static PyObject *rejection_counts(const Scan *scan, const Asked *asked) {
    const long long nan = scan->nan, height = scan->height, range = scan->rejected[TOO_FAR];
    const long long angle = scan->rejected[OUTSIDE], past_end = scan->rejected[PAST_END];
    if (!asked->has_motion) return Py_BuildValue("(LLLLL)", nan, height, range, angle, past_end);
    const long long untimed = asked->motion.untimed, nowhere = asked->motion.nowhere;
    return Py_BuildValue("(LLLLLLL)", nan, height, range, angle, past_end, untimed, nowhere);
}

static PyObject *project(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *xyz[3], *rule, *transform, *ranges_of, *result = NULL;
    float limit, empty;
    if (!PyArg_ParseTuple(args, "OOOOOOff", &xyz[0], &xyz[1], &xyz[2], &rule, &transform, &ranges_of, &limit, &empty))
        return NULL;
    Asked asked;
    if (take(&asked, xyz, rule, transform) < 0) return NULL;
    Py_buffer ranges;
    if (contiguous(ranges_of, &ranges, PyBUF_WRITABLE, 4, -1) == 0) {
        const int32_t beams = (int32_t)(ranges.len / 4);
        Scan *scan = new_scan(&asked, beams, (size_t)beams + REASONS);
        if (scan) {
            scan->smallest = (double *)(scan + 1);
            float *range = ranges.buf;
            PyThreadState *state = let_others(asked.cloud.rows * asked.cloud.columns + beams);
            for (int32_t i = 0; i < beams + REASONS; i++) scan->smallest[i] = INFINITY;
            run(scan, &asked);
            for (int32_t i = 0; i < beams; i++) {
                float root = (float)sqrt(scan->smallest[i]);
                range[i] = root < limit ? root : empty;
            }
            if (state) PyEval_RestoreThread(state);
            result = rejection_counts(scan, &asked);
            PyMem_Free(scan);
        }
        PyBuffer_Release(&ranges);
    }
    release(&asked);
    return result;
}

static PyObject *gather(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *xyz[3], *rule, *transform, *bins_of, *ranges_of, *numbers_of, *result = NULL;
    int beams;
    if (!PyArg_ParseTuple(args, "OOOOOiOOO", &xyz[0], &xyz[1], &xyz[2], &rule, &transform, &beams, &bins_of, &ranges_of,
                          &numbers_of))
        return NULL;
    Asked asked;
    if (take(&asked, xyz, rule, transform) < 0) return NULL;
    const Py_ssize_t most = asked.cloud.rows * asked.cloud.columns;
    Py_buffer bins, ranges, numbers;
    if (contiguous(bins_of, &bins, PyBUF_WRITABLE, 4, most) < 0) goto release_asked;
    if (contiguous(ranges_of, &ranges, PyBUF_WRITABLE, 4, most) < 0) goto release_bins;
    if (contiguous(numbers_of, &numbers, PyBUF_WRITABLE, 8, most) < 0) goto release_ranges;
    Scan *scan = new_scan(&asked, beams, 0);
    if (scan) {
        scan->bins = bins.buf;
        scan->ranges = ranges.buf;
        scan->numbers = numbers.buf;
        PyThreadState *state = let_others(most);
        run(scan, &asked);
        if (state) PyEval_RestoreThread(state);
        result = rejection_counts(scan, &asked);
        PyMem_Free(scan);
    }
    PyBuffer_Release(&numbers);
release_ranges:
    PyBuffer_Release(&ranges);
release_bins:
    PyBuffer_Release(&bins);
release_asked:
    release(&asked);
    return result;
}

WIDEST static void angles_by(const float *x, const float *y, float *angle, int count, int glibc) {
    if (glibc) glibc_angles_of(x, y, angle, count);
    else angles_of(x, y, angle, count);
}

static PyObject *angles(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *objects[3];
    int glibc = 0;
    if (!PyArg_ParseTuple(args, "OOO|p", &objects[0], &objects[1], &objects[2], &glibc)) return NULL;
    Py_buffer x, y, out;
    if (contiguous(objects[0], &x, PyBUF_SIMPLE, 4, -1) < 0) return NULL;
    PyObject *result = NULL;
    if (contiguous(objects[1], &y, PyBUF_SIMPLE, 4, x.len / 4) < 0) goto release_x;
    if (contiguous(objects[2], &out, PyBUF_WRITABLE, 4, x.len / 4) < 0) goto release_y;
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t from = 0; from < x.len / 4; from += BLOCK) {
        Py_ssize_t left = x.len / 4 - from;
        angles_by((const float *)x.buf + from, (const float *)y.buf + from, (float *)out.buf + from,
                  left < BLOCK ? (int)left : BLOCK, glibc);
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

static PyObject *deskew(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *xyz[3], *tuple, *out_of, *result = NULL;
    if (!PyArg_ParseTuple(args, "OOOO!O", &xyz[0], &xyz[1], &xyz[2], &PyTuple_Type, &tuple, &out_of)) return NULL;
    Cloud cloud;
    if (take_coordinates(&cloud, xyz) < 0) return NULL;
    const Py_ssize_t most = cloud.rows * cloud.columns;
    Motion motion = {0};
    Py_buffer out;
    if (take_motion(&motion, &cloud, tuple) == 0 && contiguous(out_of, &out, PyBUF_WRITABLE, 4, 3 * most) == 0) {
        PyThreadState *state = let_others(most);
        deskew_cloud(&cloud, &motion, out.buf);
        if (state) PyEval_RestoreThread(state);
        result = Py_BuildValue("(LL)", (long long)motion.untimed, (long long)motion.nowhere);
        PyBuffer_Release(&out);
    }
    release_motion(&motion);
    release_cloud(&cloud);
    return result;
}

static PyObject *lanes(PyObject *self, PyObject *args) {
    (void)self;
    int most;
    return PyArg_ParseTuple(args, "i", &most) ? PyLong_FromLong(prepare_lanes(most)) : NULL;
}

static PyMethodDef methods[] = {
    {"project", project, METH_VARARGS,
     "project(x, y, z, rule, transform, ranges, limit, empty) -> (nan, height, range, angle, past_end); see plain.py"},
    {"gather", gather, METH_VARARGS,
     "gather(x, y, z, rule, transform, beams, bins, ranges, numbers) -> the same counts; see plain.py"},
    {"deskew", deskew, METH_VARARGS,
     "deskew(x, y, z, motion, out) -> points without a time, and without a transform; see plain.py"},
    {"span", span, METH_VARARGS, "span(x, values) -> (least, largest, measured, unknown); see plain.py"},
    {"follow", follow, METH_VARARGS, "follow(times, stamps, poses, rows): one frame's poses; see plain.py"},
    {"nodes", nodes, METH_VARARGS, "nodes(stamps, begin, end, step) -> (times as bytes, longest gap); see plain.py"},
    {"trace", trace, METH_VARARGS, "trace(cells, width, mark, rays, hits): rays into a grid; see plain.py"},
    {"angles", angles, METH_VARARGS, "angles(x, y, out, glibc=False): atan2(y, x) of contiguous float32; see plain.py"},
    {"lanes", lanes, METH_VARARGS,
     "lanes(most) -> how many points the loops do at once from now on: 16, 8 or 1; no result depends on it"},
    {NULL, NULL, 0, NULL},
};

static int prepare(PyObject *self) {
    (void)self;
    prepare_lanes(16);
    return 0;
}

static PyModuleDef_Slot slots[] = {{Py_mod_exec, prepare}, {0, NULL}};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_kernel", NULL, 0, methods, slots, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__kernel(void) { return PyModuleDef_Init(&module); }
