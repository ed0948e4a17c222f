/* The transforms of one frame over time. */

#include "arrays.h"
#include "functions.h"

/* A rotation's matrix, in the order of operations of rigid.py's rotation_matrices. */
static void matrix_of(const double q[4], double m[9]) {
    const double x = q[0], y = q[1], z = q[2], w = q[3];
    const double scale = 2.0 / (x * x + y * y + z * z + w * w);
    const double xs = x * scale, ys = y * scale, zs = z * scale;
    const double wx = w * xs, wy = w * ys, wz = w * zs, xx = x * xs, xy = x * ys, xz = x * zs;
    const double yy = y * ys, yz = y * zs, zz = z * zs;
    const double all[9] = {1.0 - (yy + zz), xy - wz, xz + wy, xy + wz, 1.0 - (xx + zz),
                           yz - wx,         xz - wy, yz + wx, 1.0 - (xx + yy)};
    memcpy(m, all, sizeof all);
}

/* A row of a transform after another one. */
static void compose(const double m[9], const double t[3], double *row) {
    double turned[12];
    for (int i = 0; i < 3; i++) {
        const double *own = m + 3 * i;
        for (int k = 0; k < 3; k++) turned[3 * i + k] = own[0] * row[k] + own[1] * row[3 + k] + own[2] * row[6 + k];
        turned[9 + i] = own[0] * row[9] + own[1] * row[10] + own[2] * row[11] + t[i];
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

static void interpolate(const Between *between, double ratio, double m[9], double t[3]) {
    const double *first = between->first, *last = between->last, angle = between->angle;
    double q[4];
    for (int k = 0; k < 3; k++) t[k] = (1 - ratio) * first[k] + ratio * last[k];
    if (angle == 0) memcpy(q, first + 3, sizeof q);
    else {
        const double from = sin((1 - ratio) * angle) / between->over;
        const double to = sin(ratio * angle) * between->sign / between->over;
        for (int k = 0; k < 4; k++) q[k] = from * first[3 + k] + to * last[3 + k];
    }
    matrix_of(q, m);
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
        interpolate(&between, newer > older ? (double)(times[i] - stamps[older]) / whole : 0, m, t);
        compose(m, t, rows);
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
        matrix_of(pose + 3, m);
        for (Py_ssize_t i = 0; i < count; i++) compose(m, pose, row + 12 * i);
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
