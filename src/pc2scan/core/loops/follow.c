/* The transforms of frames over time: when they are looked up, and what they are. */

#include "arrays.h"
#include "functions.h"

/* Compute a rotation's matrix, in the order of operations of rigid.py's rotation_matrices. Returns the quaternion's
   squared length. */
static double matrix_of(const double q[4], double m[9]) {
    const double x = q[0], y = q[1], z = q[2], w = q[3];
    const double squared = x * x + y * y + z * z + w * w, scale = 2.0 / squared;
    const double xs = x * scale, ys = y * scale, zs = z * scale;
    const double wx = w * xs, wy = w * ys, wz = w * zs, xx = x * xs, xy = x * ys, xz = x * zs;
    const double yy = y * ys, yz = y * zs, zz = z * zs;
    const double all[9] = {1.0 - (yy + zz), xy - wz, xz + wy, xy + wz, 1.0 - (xx + zz),
                           yz - wx,         xz - wy, yz + wx, 1.0 - (xx + yy)};
    memcpy(m, all, sizeof all);
    return squared;
}

/* Apply a link's transform to a row that holds another transform. tf2 rotates the translation by the quaternion as it
   is, which scales it by the quaternion's squared length. */
static void compose(const double m[9], const double t[3], const double squared, double *row) {
    double turned[12];
    for (int i = 0; i < 3; i++) {
        const double *own = m + 3 * i;
        for (int k = 0; k < 3; k++) turned[3 * i + k] = own[0] * row[k] + own[1] * row[3 + k] + own[2] * row[6 + k];
        turned[9 + i] = squared * (own[0] * row[9] + own[1] * row[10] + own[2] * row[11]) + t[i];
    }
    memcpy(row, turned, sizeof turned);
}

/* Two neighbouring samples of a frame, between which it is interpolated. */
typedef struct {
    const double *first, *last;
    double angle, over, sign;
} Between;

static void set_between(Between *between, const double *first, const double *last) {
    const double *q = first + 3, *r = last + 3;
    const double product = q[0] * r[0] + q[1] * r[1] + q[2] * r[2] + q[3] * r[3];
    const double one = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    const double other = r[0] * r[0] + r[1] * r[1] + r[2] * r[2] + r[3] * r[3];
    const double cosine = fabs(product) / sqrt(one * other);
    between->first = first;
    between->last = last;
    between->angle = acos(cosine < 1 ? cosine : 1);
    between->over = sin(between->angle);
    between->sign = product < 0 ? -1 : 1;
}

static double interpolate(const Between *between, double ratio, double m[9], double t[3]) {
    const double *first = between->first, *last = between->last, angle = between->angle;
    double q[4];
    for (int k = 0; k < 3; k++) t[k] = (1 - ratio) * first[k] + ratio * last[k];
    if (angle == 0) memcpy(q, first + 3, sizeof q);
    else {
        const double from = sin((1 - ratio) * angle) / between->over;
        const double to = sin(ratio * angle) * between->sign / between->over;
        for (int k = 0; k < 4; k++) q[k] = from * first[3 + k] + to * last[3 + k];
    }
    return matrix_of(q, m);
}

static void follow_link(const int64_t *times, Py_ssize_t count, const int64_t *stamps, const double *poses,
                        Py_ssize_t samples, double *rows) {
    Between between = {NULL, NULL, 0, 0, 0};
    Py_ssize_t older = 0;
    double m[9], t[3];
    for (Py_ssize_t i = 0; i < count; i++, rows += 12) {
        if (times[i] < stamps[0] || times[i] > stamps[samples - 1]) {
            for (int k = 0; k < 12; k++) rows[k] = NAN;
            continue;
        }
        if (i == 0 || times[i] < stamps[older]) {
            Py_ssize_t low = 0, high = samples - 1;
            while (low < high) {
                Py_ssize_t middle = (low + high + 1) / 2;
                if (stamps[middle] <= times[i]) low = middle;
                else high = middle - 1;
            }
            older = low;
        }
        while (older + 1 < samples && stamps[older + 1] <= times[i]) older++;
        const Py_ssize_t newer = older + 1 < samples ? older + 1 : older;
        const double *first = poses + 7 * older, *last = poses + 7 * newer;
        if (between.first != first || between.last != last) set_between(&between, first, last);
        const double whole = (double)(stamps[newer] - stamps[older]);
        const double ratio = newer > older ? (double)(times[i] - stamps[older]) / whole : 0;
        const double squared = interpolate(&between, ratio, m, t);
        compose(m, t, squared, rows);
    }
}

PyObject *follow(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *times_of, *stamps_of, *poses_of, *rows_of, *result = NULL;
    if (!PyArg_ParseTuple(args, "OOOO", &times_of, &stamps_of, &poses_of, &rows_of)) return NULL;
    Py_buffer times, stamps, poses, rows;
    if (contiguous(times_of, &times, PyBUF_SIMPLE, 8, -1) < 0) return NULL;
    const Py_ssize_t count = times.len / 8;
    if (contiguous(stamps_of, &stamps, PyBUF_SIMPLE, 8, -1) < 0) goto release_times;
    const Py_ssize_t samples = stamps.len / 8;
    if (contiguous(poses_of, &poses, PyBUF_SIMPLE, 8, 7 * (samples ? samples : 1)) < 0) goto release_stamps;
    if (contiguous(rows_of, &rows, PyBUF_WRITABLE, 8, 12 * count) < 0) goto release_poses;
    if (samples) follow_link(times.buf, count, stamps.buf, poses.buf, samples, rows.buf);
    else {
        const double *pose = poses.buf;
        double m[9], *row = rows.buf;
        const double squared = matrix_of(pose + 3, m);
        for (Py_ssize_t i = 0; i < count; i++) compose(m, pose, squared, row + 12 * i);
    }
    result = Py_NewRef(Py_None);
    PyBuffer_Release(&rows);
release_poses:
    PyBuffer_Release(&poses);
release_stamps:
    PyBuffer_Release(&stamps);
release_times:
    PyBuffer_Release(&times);
    return result;
}

/* Return how many stamps are before a time; with `same`, how many are not after it. */
static Py_ssize_t stamps_before(const int64_t *stamps, Py_ssize_t count, int64_t time, int same) {
    Py_ssize_t low = 0, high = count;
    while (low < high) {
        const Py_ssize_t middle = (low + high) / 2;
        if (stamps[middle] < time || (same && stamps[middle] == time)) low = middle + 1;
        else high = middle;
    }
    return low;
}

/* Merge increasing times into other increasing times, which have room for them. Returns the new number of times. */
static Py_ssize_t merge(int64_t *times, Py_ssize_t count, const int64_t *others, Py_ssize_t more) {
    const Py_ssize_t sum = count + more;
    for (Py_ssize_t to = sum; more;)
        times[--to] = count && times[count - 1] > others[more - 1] ? times[--count] : others[--more];
    return sum;
}

/* Remove times that occur twice, and insert the middle between each time and the next. Returns the new number of
   times. */
static Py_ssize_t with_middles(int64_t *times, Py_ssize_t count) {
    Py_ssize_t kept = 1;
    for (Py_ssize_t i = 1; i < count; i++)
        if (times[i] != times[kept - 1]) times[kept++] = times[i];
    for (Py_ssize_t i = kept - 1; i > 0; i--) {
        times[2 * i] = times[i];
        times[2 * i - 1] = times[i - 1] + (times[i] - times[i - 1]) / 2;
    }
    return 2 * kept - 1;
}

PyObject *nodes(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *all, *result = NULL;
    long long begin, end, step;
    if (!PyArg_ParseTuple(args, "O!LLL", &PyTuple_Type, &all, &begin, &end, &step)) return NULL;
    const int64_t most = INT64_MAX / 4, length = begin > -most && end < most ? end - begin : 0;
    const int64_t parts = length > 0 && step > 0 ? (length - 1) / step + 1 : 0;
    if (!parts || length > most / parts) {
        PyErr_SetString(PyExc_ValueError, "the end is not behind the beginning, or the step is too small");
        return NULL;
    }
    int64_t longest = 0;
    Py_ssize_t count = (Py_ssize_t)parts + 1, room = 2 * count;
    int64_t *times = PyMem_Malloc((size_t)room * sizeof *times);
    if (!times) return PyErr_NoMemory();
    for (int64_t i = 0; i <= parts; i++) times[i] = begin + i * length / parts;
    for (Py_ssize_t k = 0; k < PyTuple_Size(all); k++) {
        Py_buffer view;
        if (contiguous(PyTuple_GetItem(all, k), &view, PyBUF_SIMPLE, 8, -1) < 0) goto release;
        const int64_t *stamps = view.buf;
        const Py_ssize_t samples = view.len / 8;
        const Py_ssize_t from = stamps_before(stamps, samples, begin, 0), to = stamps_before(stamps, samples, end, 1);
        const Py_ssize_t inside = stamps_before(stamps, samples, begin, 1), outside = stamps_before(stamps, samples, end, 0);
        for (Py_ssize_t i = inside > 1 ? inside : 1; i <= outside && i < samples; i++)
            longest = stamps[i] - stamps[i - 1] > longest ? stamps[i] - stamps[i - 1] : longest;
        room += 2 * (to - from);
        int64_t *more = PyMem_Realloc(times, (size_t)room * sizeof *times);
        if (more) {
            times = more;
            count = merge(times, count, stamps + from, to - from);
        }
        PyBuffer_Release(&view);
        if (!more) {
            PyErr_NoMemory();
            goto release;
        }
    }
    count = with_middles(times, count);
    result = Py_BuildValue("(y#L)", (const char *)times, count * (Py_ssize_t)sizeof *times, (long long)longest);
release:
    PyMem_Free(times);
    return result;
}
