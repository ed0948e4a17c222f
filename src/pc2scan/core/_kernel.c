/* The inner loops of the projection, of deskewing and of maps. project.py, rule.py and occupancy.py describe the rules;
   this file makes them fast.

   Points are taken a block at a time, small enough for the first-level cache: load and drop by height, one loop, or
   eight at a time; then squares, angles and bins, loops without branches that compilers turn into vector
   instructions; then the minimum of each bin. Points are transformed in float32, every product and every sum rounded,
   from left to right, as tf2_sensor_msgs does it. Compiled with -ffp-contract=off: a fused multiply-add rounds
   otherwise than upstream does. */

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

#if defined(__GNUC__)
/* Part of each of the functions that call it, so of their versions for wider vectors too. */
#define INLINED static inline __attribute__((always_inline))
#else
#define INLINED static inline
#endif

enum { BLOCK = 256 };

#if defined(__GNUC__)
/* A cloud is larger than the caches near a core, and their own prefetching ends at each page. */
#define PREFETCH(from) __builtin_prefetch((const void *)((uintptr_t)(from) + 2048))
#else
#define PREFETCH(from)
#endif

/* atan(t) / t in powers of t * t, for t from 0 to 1: Chebyshev interpolation at 15 nodes. Its relative error is below
   2.9e-13; with some roundings of 1.1e-16 the angle's stays below this. */
#define ANGLE_ERROR 4e-13
static const double ATAN[15] = {
    0x1.ffffffffff5ccp-1,  -0x1.5555555316212p-2, 0x1.999998469d323p-3,  -0x1.24922161af34dp-3, 0x1.c717834559cfep-4,
    -0x1.742d65ac65c77p-4, 0x1.39e23d1599a8ep-4,  -0x1.0bb9539dc5436p-4, 0x1.bf2393efe8459p-5,  -0x1.5ab9279e2b201p-5,
    0x1.d17abe7889664p-6,  -0x1.f323674b044a5p-7, 0x1.850bdf56a80b6p-8,  -0x1.807a77421f2f7p-10, 0x1.657b3ba0095aep-13,
};

/* float32(atan2(y, x)) of up to BLOCK points. */
INLINED void angles_of(const float *restrict x, const float *restrict y, float *restrict angle, int count) {
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

/* fdlibm's float32 coefficients of (t - atan(t)) / t, in powers of t * t. */
static const float FDLIBM[11] = {
    0x1.555556p-2f, -0x1.99999ap-3f, 0x1.24924ap-3f, -0x1.c71c70p-4f, 0x1.745cdcp-4f, -0x1.3b0f2ap-4f,
    0x1.10d66ap-4f, -0x1.dde2d6p-5f, 0x1.97b4b2p-5f, -0x1.2b4442p-5f, 0x1.0ad3aep-6f,
};

/* Its argument reduction, from some quotients t on: atan(t) = high + low + atan((a * t + b) / (c * t + d)). */
enum { REDUCTIONS = 6 };
static const struct {
    float from, a, b, c, d, high, low;
} REDUCTION[REDUCTIONS] = {
    {0, 1, 0, 0, 1, 0, 0},
    {0.4375f, 2, -1, 1, 2, 0x1.dac670p-2f, 0x1.586ed2p-28f},
    {0.6875f, 1, -1, 1, 1, 0x1.921fb4p-1f, 0x1.4442d0p-25f},
    {1.1875f, 1, -1.5f, 1.5f, 1, 0x1.f730bcp-1f, 0x1.281f68p-25f},
    {2.4375f, 0, -1, 1, 0, 0x1.921fb4p+0f, 0x1.4442d0p-24f},
    {0x1p25f, 0, 0, 0, 1, 0x1.921fb4p+0f, 0x1.4442d0p-24f},
};

/* atan2f(y, x) of up to BLOCK points as glibc 2.31 to 2.40 returns it on x86-64: fdlibm's algorithm in float32. The
   same steps as in fdlibm.py. */
INLINED void glibc_angles_of(const float *restrict x, const float *restrict y, float *restrict angle, int count) {
    const float pi = 0x1.921fb6p+1f, half_pi = 0x1.921fb6p+0f, quarter_pi = 0x1.921fb6p-1f;
    for (int i = 0; i < count; i++) {
        const float across = fabsf(x[i]), up = fabsf(y[i]), back = copysignf(1, x[i]);
        float t = up / across, a = 1, b = 0, c = 0, d = 1, high = 0, low = 0;
        for (int k = 1; k < REDUCTIONS; k++) {
            a = t >= REDUCTION[k].from ? REDUCTION[k].a : a;
            b = t >= REDUCTION[k].from ? REDUCTION[k].b : b;
            c = t >= REDUCTION[k].from ? REDUCTION[k].c : c;
            d = t >= REDUCTION[k].from ? REDUCTION[k].d : d;
            high = t >= REDUCTION[k].from ? REDUCTION[k].high : high;
            low = t >= REDUCTION[k].from ? REDUCTION[k].low : low;
        }
        t = t < 0x1p25f ? t : 0x1p25f;
        const float s = (a * t + b) / (c * t + d), z = s * s, w = z * z;
        float odd = FDLIBM[10], even = FDLIBM[9];
        for (int k = 8; k >= 0; k -= 2) odd = FDLIBM[k] + w * odd;
        for (int k = 7; k >= 1; k -= 2) even = FDLIBM[k] + w * even;
        const float ahead = high - ((s * (z * odd + w * even) - low) - s);
        const float behind = pi - (ahead + 0x1.777a5cp-24f);
        float turn = back < 0 ? behind : ahead;
        /* On the axes and at infinity the quotient does not decide. */
        const float along = back < 0 ? pi : 0, diagonal = back < 0 ? 3 * quarter_pi : quarter_pi;
        turn = (across == 0) | (up == INFINITY) ? half_pi : turn;
        turn = (across == INFINITY) & (up == INFINITY) ? diagonal : turn;
        turn = up == 0 ? along : turn;
        turn = (across != across) | (up != up) ? across + up : turn;
        angle[i] = copysignf(turn, y[i]);
    }
}

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

/* Inlined, so that each rounding of angles has a function of its own: one for both took 4 % longer. */
INLINED void project_with(Scan *scan, const int glibc) {
    const Rule rule = scan->rule;
    const int count = scan->filled;
    const int32_t beams = scan->beams, behind = rule.closed ? beams - 1 : beams + PAST_END;
    const float first = (float)rule.first, last = (float)rule.last;
    double squares[BLOCK];
    float angle[BLOCK];
    int32_t bin[BLOCK], lost[REASONS] = {0, 0, 0};
    /* float64 holds the squares of float32 exactly, and libm's hypotf adds them in float64. */
    for (int i = 0; i < count; i++) squares[i] = (double)scan->x[i] * scan->x[i] + (double)scan->y[i] * scan->y[i];
    if (glibc) glibc_angles_of(scan->x, scan->y, angle, count);
    else angles_of(scan->x, scan->y, angle, count);
    for (int i = 0; i < count; i++) {
        double turned = angle[i] + rule.offset;
        turned = turned >= rule.turn ? turned - rule.turn : turned;
        /* The angles from -float32(pi) to float32(pi) are more than one turn. */
        turned = turned >= rule.turn ? turned - rule.turn : turned;
        double quotient = (turned + rule.skew) / rule.increment;
        /* Outside the sector the quotient may be beyond the integers. */
        int32_t outside = (angle[i] < first) | (angle[i] > last) | (turned > rule.end);
        int32_t index = (int32_t)(outside ? 0.0 : quotient);
        index = index < beams ? index : behind;
        bin[i] = outside ? beams + OUTSIDE : index;
    }
    for (int i = 0; i < count; i++) {
        int32_t away = !((squares[i] >= rule.least) & (squares[i] <= rule.most));
        bin[i] = away ? beams + TOO_FAR : bin[i];
    }
    for (int i = 0; i < count; i++) {
        lost[PAST_END] += bin[i] == beams + PAST_END;
        lost[OUTSIDE] += bin[i] == beams + OUTSIDE;
        lost[TOO_FAR] += bin[i] == beams + TOO_FAR;
    }
    for (int reason = 0; reason < REASONS; reason++) scan->rejected[reason] += lost[reason];
    scan->filled = 0;
    if (scan->smallest) {
        for (int i = 0; i < count; i++)
            if (squares[i] < scan->smallest[bin[i]]) scan->smallest[bin[i]] = squares[i];
        return;
    }
    int64_t to = scan->gathered;
    for (int i = 0; i < count; i++) {
        if (bin[i] >= beams) continue;
        scan->bins[to] = bin[i];
        scan->ranges[to] = (float)sqrt(squares[i]);
        scan->numbers[to++] = scan->number[i];
    }
    scan->gathered = to;
}

WIDEST static void project_correct(Scan *scan) { project_with(scan, 0); }
WIDEST static void project_glibc(Scan *scan) { project_with(scan, 1); }

static void project_block(Scan *scan) {
    if (scan->rule.glibc) project_glibc(scan);
    else project_correct(scan);
}

/* One coordinate of a cloud: rows of columns, strided and unaligned, of any of PointField's datatypes. */
typedef struct {
    const char *data;
    Py_ssize_t row_step, step;
    char kind; /* NumPy's: i, u or f */
    int size, swapped;
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

/* Any value; float64 holds them all. */
static double read_any(const char *from, const Axis *axis) {
    char turned[8];
    if (axis->swapped) {
        for (int i = 0; i < axis->size; i++) turned[i] = from[axis->size - 1 - i];
        from = turned;
    }
    if (axis->kind == 'f') return axis->size == 8 ? read_double(from) : read_float(from);
    uint8_t u8;
    uint16_t u16;
    uint32_t u32;
    switch (axis->size) {
        case 1: memcpy(&u8, from, 1); return axis->kind == 'i' ? (int8_t)u8 : u8;
        case 2: memcpy(&u16, from, 2); return axis->kind == 'i' ? (int16_t)u16 : u16;
        default: memcpy(&u32, from, 4); return axis->kind == 'i' ? (double)(int32_t)u32 : (double)u32;
    }
}

/* What the three axes have in common. */
enum { FLOATS, DOUBLES, MIXED };

static inline double read_as(const char *from, const Axis *axis, const int common) {
    return common == FLOATS ? read_float(from) : common == DOUBLES ? read_double(from) : read_any(from, axis);
}

/* Drop points that are NaN or too high or low: from so many of them on, in place. */
WIDEST static void drop_by_height(Scan *scan, const int from, const int count) {
    const float lowest = (float)scan->rule.lowest, highest = (float)scan->rule.highest;
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
    if (scan->smallest) return;
    for (int i = 0, to = from; i < count; i++) {
        scan->number[to] = scan->number[from + i];
        to += keep[i];
    }
}

#if defined(__x86_64__) && defined(__GNUC__)
#include <immintrin.h>
#define EIGHT

/* For each set of eight lanes: where its members go when they move together. */
static uint64_t together[256];
static int eight_at_once;

static void prepare_eight(void) {
    for (int set = 0; set < 256; set++)
        for (int lane = 0, to = 0; lane < 8; lane++)
            if (set >> lane & 1) together[set] |= (uint64_t)lane << 8 * to++;
    eight_at_once = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("popcnt");
}

/* One coordinate of eight points, transformed: a row of the rotation, and its part of the translation. */
__attribute__((target("avx2,popcnt"))) static inline __m256 turn_eight(__m256 x, __m256 y, __m256 z, const float *row,
                                                                       const float *offset) {
    __m256 sum = _mm256_mul_ps(x, _mm256_broadcast_ss(row));
    sum = _mm256_add_ps(sum, _mm256_mul_ps(y, _mm256_broadcast_ss(row + 1)));
    sum = _mm256_add_ps(sum, _mm256_mul_ps(z, _mm256_broadcast_ss(row + 2)));
    return _mm256_add_ps(sum, _mm256_broadcast_ss(offset));
}

/* Take points of one row, eight at a time, as long as what is read of them stays in front of the last one: x, y and z
   are float32 that follow each other, with four bytes behind them. Returns how many were taken. Inlined, so that
   compilers know of each call whether it has to transform the points. */
__attribute__((target("avx2,popcnt"), always_inline)) static inline Py_ssize_t load_eight(
    Scan *scan, const char *from, Py_ssize_t step, Py_ssize_t count, const float *transform) {
    const __m256 lowest = _mm256_set1_ps((float)scan->rule.lowest), highest = _mm256_set1_ps((float)scan->rule.highest);
    Py_ssize_t taken = 0;
    int64_t nans = 0, kept = 0;
    /* Points of 32 bytes share a processor's lines of 64. */
    const Py_ssize_t lines = step < 64 ? 64 : step;
    for (; taken + 8 < count; taken += 8, from += 8 * step) {
        __m256 pair[4];
        for (Py_ssize_t line = 0; line < 8 * step; line += lines) PREFETCH(from + line);
        for (int i = 0; i < 4; i++) {
            const char *one = from + i * step, *other = from + (i + 4) * step;
            pair[i] = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps((const float *)one)),
                                           _mm_loadu_ps((const float *)other), 1);
        }
        const __m256 xy = _mm256_unpacklo_ps(pair[0], pair[1]), yx = _mm256_unpacklo_ps(pair[2], pair[3]);
        __m256 x = _mm256_shuffle_ps(xy, yx, 0x44), y = _mm256_shuffle_ps(xy, yx, 0xee);
        __m256 z = _mm256_shuffle_ps(_mm256_unpackhi_ps(pair[0], pair[1]), _mm256_unpackhi_ps(pair[2], pair[3]), 0x44);
        if (transform) {
            const __m256 sx = x, sy = y, sz = z;
            x = turn_eight(sx, sy, sz, transform, transform + 9);
            y = turn_eight(sx, sy, sz, transform + 3, transform + 10);
            z = turn_eight(sx, sy, sz, transform + 6, transform + 11);
        }
        const __m256 nan = _mm256_or_ps(_mm256_cmp_ps(x, y, _CMP_UNORD_Q), _mm256_cmp_ps(z, z, _CMP_UNORD_Q));
        const __m256 inside = _mm256_and_ps(_mm256_cmp_ps(z, lowest, _CMP_GE_OQ), _mm256_cmp_ps(z, highest, _CMP_LE_OQ));
        const int keep = _mm256_movemask_ps(_mm256_andnot_ps(nan, inside));
        nans += __builtin_popcount((unsigned)_mm256_movemask_ps(nan));
        if (!keep) continue;
        if (scan->filled > BLOCK - 8) project_block(scan);
        const __m256i to = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128((long long)together[keep]));
        _mm256_storeu_ps(scan->x + scan->filled, _mm256_permutevar8x32_ps(x, to));
        _mm256_storeu_ps(scan->y + scan->filled, _mm256_permutevar8x32_ps(y, to));
        const int more = __builtin_popcount((unsigned)keep);
        scan->filled += more;
        kept += more;
    }
    scan->nan += nans;
    scan->height += taken - nans - kept;
    return taken;
}

__attribute__((target("avx2,popcnt"))) static Py_ssize_t load_eight_untransformed(Scan *scan, const char *from,
                                                                                  Py_ssize_t step, Py_ssize_t count) {
    return load_eight(scan, from, step, count, NULL);
}

__attribute__((target("avx2,popcnt"))) static Py_ssize_t load_eight_transformed(Scan *scan, const char *from,
                                                                                Py_ssize_t step, Py_ssize_t count,
                                                                                const float *transform) {
    return load_eight(scan, from, step, count, transform);
}
#endif

/* Take points of one row. Inlined, so that compilers know of each call what it reads and whether it transforms. */
static inline void load(Scan *scan, const char *x, const char *y, const char *z, const Axis axis[3], int64_t number,
                        Py_ssize_t count, const int common, const float *transform) {
    const Py_ssize_t dx = axis[0].step, dy = axis[1].step, dz = axis[2].step;
    while (count > 0) {
        const int filled = scan->filled;
        const int take = count < BLOCK - filled ? (int)count : BLOCK - filled;
        float *restrict to_x = scan->x + filled, *restrict to_y = scan->y + filled, *restrict to_z = scan->z + filled;
        for (int i = 0; i < take; i++) {
            PREFETCH(x);
            const float sx = (float)read_as(x, &axis[0], common), sy = (float)read_as(y, &axis[1], common);
            const float sz = (float)read_as(z, &axis[2], common);
            to_x[i] = transform ? sx * transform[0] + sy * transform[1] + sz * transform[2] + transform[9] : sx;
            to_y[i] = transform ? sx * transform[3] + sy * transform[4] + sz * transform[5] + transform[10] : sy;
            to_z[i] = transform ? sx * transform[6] + sy * transform[7] + sz * transform[8] + transform[11] : sz;
            x += dx, y += dy, z += dz;
        }
        if (!scan->smallest)
            for (int i = 0; i < take; i++) scan->number[filled + i] = number + i;
        drop_by_height(scan, filled, take);
        if (scan->filled == BLOCK) project_block(scan);
        number += take;
        count -= take;
    }
}

static int in_common(const Axis axis[3]) {
    int floats = 1, doubles = 1;
    for (int i = 0; i < 3; i++) {
        floats &= axis[i].kind == 'f' && axis[i].size == 4 && !axis[i].swapped;
        doubles &= axis[i].kind == 'f' && axis[i].size == 8 && !axis[i].swapped;
    }
    return floats ? FLOATS : doubles ? DOUBLES : MIXED;
}

static void load_rows(Scan *scan, const Axis axis[3], Py_ssize_t rows, Py_ssize_t columns, const float *transform) {
    const int common = in_common(axis);
    for (Py_ssize_t row = 0; row < rows; row++) {
        const char *x = axis[0].data + row * axis[0].row_step;
        const char *y = axis[1].data + row * axis[1].row_step;
        const char *z = axis[2].data + row * axis[2].row_step;
        int64_t number = (int64_t)row * columns;
        Py_ssize_t taken = 0;
#ifdef EIGHT
        /* Points of twelve bytes have the next one behind them. */
        if (eight_at_once && common == FLOATS && scan->smallest && y - x == 4 && z - x == 8 && axis[0].step >= 12 &&
            axis[1].step == axis[0].step && axis[2].step == axis[0].step)
            taken = transform ? load_eight_transformed(scan, x, axis[0].step, columns, transform)
                         : load_eight_untransformed(scan, x, axis[0].step, columns);
        x += taken * axis[0].step, y += taken * axis[1].step, z += taken * axis[2].step;
        number += taken;
#endif
        const Py_ssize_t left = columns - taken;
        if (common == FLOATS && transform) load(scan, x, y, z, axis, number, left, FLOATS, transform);
        else if (common == FLOATS) load(scan, x, y, z, axis, number, left, FLOATS, NULL);
        else if (common == DOUBLES && transform) load(scan, x, y, z, axis, number, left, DOUBLES, transform);
        else if (common == DOUBLES) load(scan, x, y, z, axis, number, left, DOUBLES, NULL);
        else load(scan, x, y, z, axis, number, left, MIXED, transform);
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

/* A cloud from Python, with the rule and the transform. */
typedef struct {
    Py_buffer coordinates[3], rule, transform;
    Axis axis[3];
    Py_ssize_t rows, columns;
    int held, has_transform;
} Cloud;

static void release(Cloud *cloud) {
    while (cloud->held > 0) PyBuffer_Release(&cloud->coordinates[--cloud->held]);
    if (cloud->rule.obj) PyBuffer_Release(&cloud->rule);
    if (cloud->has_transform) PyBuffer_Release(&cloud->transform);
}

/* The type of an array's values, from its dtype. */
static int find_type(PyObject *array, Axis *axis, Py_ssize_t item) {
    PyObject *dtype = PyObject_GetAttrString(array, "dtype");
    if (!dtype) return -1;
    PyObject *text = PyObject_GetAttrString(dtype, "str");
    Py_DECREF(dtype);
    if (!text) return -1;
    const char *type = PyUnicode_AsUTF8AndSize(text, NULL);
    int known = type && type[0] && type[1] && strchr("iuf", type[1]) && type[2] && !type[3];
    if (known) {
        axis->kind = type[1];
        axis->size = type[2] - '0';
        known = axis->size == item && (axis->kind == 'f' ? item == 4 || item == 8 : item == 1 || item == 2 || item == 4);
        axis->swapped = type[0] == (PY_BIG_ENDIAN ? '<' : '>');
    }
    Py_DECREF(text);
    if (type && !known) PyErr_SetString(PyExc_ValueError, "coordinates are of a type that no PointField has");
    return known ? 0 : -1;
}

static int take_coordinates(Cloud *cloud, PyObject *xyz[3]) {
    memset(cloud, 0, sizeof *cloud);
    const Py_buffer *like = &cloud->coordinates[0];
    for (; cloud->held < 3; cloud->held++) {
        Py_buffer *view = &cloud->coordinates[cloud->held];
        if (PyObject_GetBuffer(xyz[cloud->held], view, PyBUF_STRIDES) < 0) goto failed;
        Axis *axis = &cloud->axis[cloud->held];
        int same = view->ndim == like->ndim;
        for (int i = 0; same && i < view->ndim; i++) same = view->shape[i] == like->shape[i];
        if (!same || view->ndim < 1 || view->ndim > 2) {
            PyBuffer_Release(view);
            PyErr_SetString(PyExc_ValueError, "coordinates are not three arrays of one shape");
            goto failed;
        }
        if (find_type(xyz[cloud->held], axis, view->itemsize) < 0) {
            PyBuffer_Release(view);
            goto failed;
        }
        axis->data = view->buf;
        axis->step = view->strides[view->ndim - 1];
        axis->row_step = view->ndim == 2 ? view->strides[0] : 0;
    }
    cloud->rows = like->ndim == 2 ? like->shape[0] : 1;
    cloud->columns = like->shape[like->ndim - 1];
    return 0;
failed:
    release(cloud);
    return -1;
}

static int take(Cloud *cloud, PyObject *xyz[3], PyObject *rule, PyObject *transform) {
    if (take_coordinates(cloud, xyz) < 0) return -1;
    if (contiguous(rule, &cloud->rule, PyBUF_SIMPLE, 8, sizeof(Rule) / 8) < 0) {
        cloud->rule.obj = NULL;
        goto failed;
    }
    if (transform != Py_None) {
        if (contiguous(transform, &cloud->transform, PyBUF_SIMPLE, 4, 12) < 0) goto failed;
        cloud->has_transform = 1;
    }
    return 0;
failed:
    release(cloud);
    return -1;
}

/* Room for a scan, and for some doubles behind it. */
static Scan *new_scan(const Cloud *cloud, int32_t beams, size_t doubles) {
    Scan *scan = PyMem_Malloc(sizeof *scan + doubles * sizeof(double));
    if (!scan) {
        PyErr_NoMemory();
        return NULL;
    }
    memset(scan, 0, sizeof *scan);
    memcpy(&scan->rule, cloud->rule.buf, sizeof scan->rule);
    scan->beams = beams;
    return scan;
}

static void run(Scan *scan, const Cloud *cloud) {
    load_rows(scan, cloud->axis, cloud->rows, cloud->columns, cloud->has_transform ? cloud->transform.buf : NULL);
}

/* Let other threads have the interpreter, unless taking turns takes longer than this many points or beams do. */
static PyThreadState *let_others(Py_ssize_t work) { return work > 16384 ? PyEval_SaveThread() : NULL; }

static PyObject *rejection_counts(const Scan *scan) {
    return Py_BuildValue("(LLLLL)", (long long)scan->nan, (long long)scan->height, (long long)scan->rejected[TOO_FAR],
                         (long long)scan->rejected[OUTSIDE], (long long)scan->rejected[PAST_END]);
}

static PyObject *project(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *xyz[3], *rule, *transform, *ranges_of, *result = NULL;
    float limit, empty;
    if (!PyArg_ParseTuple(args, "OOOOOOff", &xyz[0], &xyz[1], &xyz[2], &rule, &transform, &ranges_of, &limit, &empty))
        return NULL;
    Cloud cloud;
    if (take(&cloud, xyz, rule, transform) < 0) return NULL;
    Py_buffer ranges;
    if (contiguous(ranges_of, &ranges, PyBUF_WRITABLE, 4, -1) == 0) {
        const int32_t beams = (int32_t)(ranges.len / 4);
        Scan *scan = new_scan(&cloud, beams, (size_t)beams + REASONS);
        if (scan) {
            scan->smallest = (double *)(scan + 1);
            float *range = ranges.buf;
            PyThreadState *state = let_others(cloud.rows * cloud.columns + beams);
            for (int32_t i = 0; i < beams + REASONS; i++) scan->smallest[i] = INFINITY;
            run(scan, &cloud);
            for (int32_t i = 0; i < beams; i++) {
                float root = (float)sqrt(scan->smallest[i]);
                range[i] = root < limit ? root : empty;
            }
            if (state) PyEval_RestoreThread(state);
            result = rejection_counts(scan);
            PyMem_Free(scan);
        }
        PyBuffer_Release(&ranges);
    }
    release(&cloud);
    return result;
}

static PyObject *gather(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *xyz[3], *rule, *transform, *bins_of, *ranges_of, *numbers_of, *result = NULL;
    int beams;
    if (!PyArg_ParseTuple(args, "OOOOOiOOO", &xyz[0], &xyz[1], &xyz[2], &rule, &transform, &beams, &bins_of, &ranges_of,
                          &numbers_of))
        return NULL;
    Cloud cloud;
    if (take(&cloud, xyz, rule, transform) < 0) return NULL;
    const Py_ssize_t most = cloud.rows * cloud.columns;
    Py_buffer bins, ranges, numbers;
    if (contiguous(bins_of, &bins, PyBUF_WRITABLE, 4, most) < 0) goto release_cloud;
    if (contiguous(ranges_of, &ranges, PyBUF_WRITABLE, 4, most) < 0) goto release_bins;
    if (contiguous(numbers_of, &numbers, PyBUF_WRITABLE, 8, most) < 0) goto release_ranges;
    Scan *scan = new_scan(&cloud, beams, 0);
    if (scan) {
        scan->bins = bins.buf;
        scan->ranges = ranges.buf;
        scan->numbers = numbers.buf;
        PyThreadState *state = let_others(most);
        run(scan, &cloud);
        if (state) PyEval_RestoreThread(state);
        result = rejection_counts(scan);
        PyMem_Free(scan);
    }
    PyBuffer_Release(&numbers);
release_ranges:
    PyBuffer_Release(&ranges);
release_bins:
    PyBuffer_Release(&bins);
release_cloud:
    release(&cloud);
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

/* The parts of a cloud's time between two nodes, and the transforms at these: twelve numbers each. */
typedef struct {
    const double *times, *transforms;
    Py_ssize_t nodes;
    /* Of each part: by how much its transform changes, and one by its duration. */
    double *steps, *scales;
} Motion;

/* The part that a time lies in: the first that does not end before it, or the one behind it if only that is known. */
static Py_ssize_t part_at(const Motion *motion, double time, Py_ssize_t part) {
    const double *ends = motion->times + 1;
    const Py_ssize_t last = motion->nodes - 2;
    if (part < last && time > ends[part] && time <= ends[part + 1]) part++;
    else if (!(time > motion->times[part] && time <= ends[part])) {
        Py_ssize_t low = 0, high = last;
        while (low < high) {
            Py_ssize_t middle = (low + high) / 2;
            if (ends[middle] < time) low = middle + 1;
            else high = middle;
        }
        part = low;
    }
    return part;
}

static int is_known(const Motion *motion, Py_ssize_t part) {
    const double *from = motion->transforms + 12 * part;
    return from[0] == from[0] && from[12] == from[12];
}

/* Transform points of one part: the transform is interpolated linearly. */
WIDEST static void deskew_run(const float *restrict x, const float *restrict y, const float *restrict z,
                              const double *restrict times, int count, const Motion *motion, Py_ssize_t part,
                              float *restrict to_x, float *restrict to_y, float *restrict to_z) {
    const double begin = motion->times[part], scale = motion->scales[part];
    const double *restrict from = motion->transforms + 12 * part, *restrict step = motion->steps + 12 * part;
    for (int i = 0; i < count; i++) {
        const double ratio = (times[i] - begin) * scale, a = x[i], b = y[i], c = z[i];
        to_x[i] = (float)((from[0] + ratio * step[0]) * a + (from[1] + ratio * step[1]) * b +
                          (from[2] + ratio * step[2]) * c + (from[9] + ratio * step[9]));
        to_y[i] = (float)((from[3] + ratio * step[3]) * a + (from[4] + ratio * step[4]) * b +
                          (from[5] + ratio * step[5]) * c + (from[10] + ratio * step[10]));
        to_z[i] = (float)((from[6] + ratio * step[6]) * a + (from[7] + ratio * step[7]) * b +
                          (from[8] + ratio * step[8]) * c + (from[11] + ratio * step[11]));
    }
}

/* Transform a cloud whose points were measured one after the other. Returns how many points have no transform. */
static int64_t deskew_cloud(const Cloud *cloud, const double *times, const Motion *motion, float *out) {
    const int common = in_common(cloud->axis);
    const double first = motion->times[0], last = motion->times[motion->nodes - 1];
    float x[BLOCK], y[BLOCK], z[BLOCK], to_x[BLOCK], to_y[BLOCK], to_z[BLOCK];
    Py_ssize_t part = 0, place = 0;
    int64_t missing = 0;
    for (Py_ssize_t row = 0; row < cloud->rows; row++)
        for (Py_ssize_t column = 0; column < cloud->columns;) {
            const int count = cloud->columns - column < BLOCK ? (int)(cloud->columns - column) : BLOCK;
            for (int axis = 0; axis < 3; axis++) {
                const Axis *own = &cloud->axis[axis];
                const char *from = own->data + row * own->row_step + column * own->step;
                float *to = axis == 0 ? x : axis == 1 ? y : z;
                if (common == FLOATS)
                    for (int i = 0; i < count; i++) to[i] = read_float(from + i * own->step);
                else
                    for (int i = 0; i < count; i++) to[i] = (float)read_any(from + i * own->step, own);
            }
            for (int i = 0; i < count;) {
                const double time = times[place + i];
                int end = i + 1;
                int known = time >= first && time <= last;
                if (known) {
                    part = part_at(motion, time, part);
                    Py_ssize_t used = part;
                    if (!is_known(motion, part) && time == motion->times[part + 1] && part < motion->nodes - 2) used++;
                    const double low = motion->times[part], high = motion->times[part + 1];
                    if (used == part)
                        while (end < count && times[place + end] > low && times[place + end] < high) end++;
                    known = is_known(motion, used);
                    if (known)
                        deskew_run(x + i, y + i, z + i, times + place + i, end - i, motion, used, to_x + i, to_y + i,
                                   to_z + i);
                }
                if (!known)
                    for (int k = i; k < end; k++) {
                        missing += x[k] == x[k] && y[k] == y[k] && z[k] == z[k];
                        to_x[k] = to_y[k] = to_z[k] = NAN;
                    }
                i = end;
            }
            for (int i = 0; i < count; i++, out += 3) {
                out[0] = to_x[i];
                out[1] = to_y[i];
                out[2] = to_z[i];
            }
            column += count;
            place += count;
        }
    return missing;
}

static PyObject *deskew(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *xyz[3], *times_of, *nodes_of, *transforms_of, *out_of, *result = NULL;
    double *steps = NULL;
    if (!PyArg_ParseTuple(args, "OOOOOOO", &xyz[0], &xyz[1], &xyz[2], &times_of, &nodes_of, &transforms_of, &out_of))
        return NULL;
    Cloud cloud;
    if (take_coordinates(&cloud, xyz) < 0) return NULL;
    const Py_ssize_t most = cloud.rows * cloud.columns;
    Py_buffer times, nodes, transforms, out;
    if (contiguous(times_of, &times, PyBUF_SIMPLE, 8, most) < 0) goto release_cloud;
    if (contiguous(nodes_of, &nodes, PyBUF_SIMPLE, 8, -1) < 0) goto release_times;
    if (contiguous(transforms_of, &transforms, PyBUF_SIMPLE, 8, nodes.len / 8 * 12) < 0) goto release_nodes;
    if (contiguous(out_of, &out, PyBUF_WRITABLE, 4, 3 * most) < 0) goto release_transforms;
    if (nodes.len < 16) PyErr_SetString(PyExc_ValueError, "there are fewer than two nodes");
    else if ((steps = PyMem_Malloc((size_t)(nodes.len / 8 * 13) * sizeof *steps)) == NULL) PyErr_NoMemory();
    else {
        const Py_ssize_t parts = nodes.len / 8 - 1;
        const Motion motion = {nodes.buf, transforms.buf, parts + 1, steps, steps + 12 * parts};
        for (Py_ssize_t k = 0; k < 12 * parts; k++) steps[k] = motion.transforms[k + 12] - motion.transforms[k];
        for (Py_ssize_t k = 0; k < parts; k++) motion.scales[k] = 1.0 / (motion.times[k + 1] - motion.times[k]);
        PyThreadState *state = let_others(most);
        const int64_t missing = deskew_cloud(&cloud, times.buf, &motion, out.buf);
        if (state) PyEval_RestoreThread(state);
        result = PyLong_FromLongLong((long long)missing);
        PyMem_Free(steps);
    }
    PyBuffer_Release(&out);
release_transforms:
    PyBuffer_Release(&transforms);
release_nodes:
    PyBuffer_Release(&nodes);
release_times:
    PyBuffer_Release(&times);
release_cloud:
    release(&cloud);
    return result;
}

/* A grid of log-odds that rays are drawn into; occupancy.py has the numbers. */
enum { UNKNOWN = -128, HIT = 17, MISS = -8, LOWEST = -40, HIGHEST = 70 };

/* A cell's high byte is its log-odds, the low one the mark of the last scan that changed it. */
typedef struct {
    int16_t *cells;
    int mark;
} Grid;

/* A cell takes the first change of each scan. */
INLINED void observe(const Grid *grid, int64_t place, int change) {
    const int cell = grid->cells[place], odds = cell >> 8;
    if ((cell & 255) == grid->mark) return;
    int value = (odds == UNKNOWN ? 0 : odds) + change;
    value = value < LOWEST ? LOWEST : value;
    value = value > HIGHEST ? HIGHEST : value;
    grid->cells[place] = (int16_t)(value * 256 + grid->mark);
}

/* The cells of a line, by Bresenham's algorithm; the last one only if nothing was hit there. */
static void draw_free(const Grid *grid, int64_t width, const int32_t *ray, int hit) {
    const int64_t dx = (int64_t)ray[2] - ray[0], dy = (int64_t)ray[3] - ray[1];
    const int64_t across = dx < 0 ? -dx : dx, up = dy < 0 ? -dy : dy;
    const int64_t along_x = dx < 0 ? -1 : 1, along_y = dy < 0 ? -width : width;
    const int64_t length = across > up ? across : up, other = across > up ? up : across;
    const int64_t step = across > up ? along_x : along_y, aside = across > up ? along_y : along_x;
    int64_t place = ray[1] * width + ray[0], error = length;
    for (int64_t left = length + !hit; left > 0; left--) {
        observe(grid, place, MISS);
        error += 2 * other;
        const int64_t turns = -(int64_t)(error >= 2 * length);
        place += step + (aside & turns);
        error -= 2 * length & turns;
    }
}

static void draw_rays(const Grid *grid, int64_t width, const int32_t *rays, const uint8_t *hits, Py_ssize_t count) {
    for (Py_ssize_t i = 0; i < count; i++)
        if (hits[i]) observe(grid, rays[4 * i + 3] * width + rays[4 * i + 2], HIT);
    for (Py_ssize_t i = 0; i < count; i++) {
        /* Near the sensor many beams end in one cell. */
        if (i && hits[i] == hits[i - 1] && !memcmp(rays + 4 * i, rays + 4 * i - 4, 4 * sizeof *rays)) continue;
        draw_free(grid, width, rays + 4 * i, hits[i]);
    }
}

static int are_inside(const int32_t *rays, Py_ssize_t count, Py_ssize_t width, Py_ssize_t height) {
    for (Py_ssize_t i = 0; i < 4 * count; i++)
        if (rays[i] < 0 || rays[i] >= (i % 2 ? height : width)) return 0;
    return 1;
}

static PyObject *trace(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *cells_of, *rays_of, *hits_of, *result = NULL;
    Py_ssize_t width;
    int mark;
    if (!PyArg_ParseTuple(args, "OniOO", &cells_of, &width, &mark, &rays_of, &hits_of)) return NULL;
    Py_buffer cells, rays, hits;
    if (contiguous(cells_of, &cells, PyBUF_WRITABLE, 2, -1) < 0) return NULL;
    if (contiguous(hits_of, &hits, PyBUF_SIMPLE, 1, -1) < 0) goto release_cells;
    if (contiguous(rays_of, &rays, PyBUF_SIMPLE, 4, 4 * hits.len) < 0) goto release_hits;
    const Py_ssize_t size = cells.len / 2;
    if (width < 1 || size % width || mark < 0 || mark > 255) PyErr_SetString(PyExc_ValueError, "the grid is not as wide as that, or the mark no byte");
    else if (!are_inside(rays.buf, hits.len, width, size / width))
        PyErr_SetString(PyExc_ValueError, "a ray leaves the grid");
    else {
        const Grid grid = {cells.buf, mark};
        /* A ray takes as long as dozens of points. */
        PyThreadState *state = let_others(64 * hits.len);
        draw_rays(&grid, width, rays.buf, hits.buf, hits.len);
        if (state) PyEval_RestoreThread(state);
        result = Py_NewRef(Py_None);
    }
    PyBuffer_Release(&rays);
release_hits:
    PyBuffer_Release(&hits);
release_cells:
    PyBuffer_Release(&cells);
    return result;
}

static PyMethodDef methods[] = {
    {"project", project, METH_VARARGS,
     "project(x, y, z, rule, transform, ranges, limit, empty) -> (nan, height, range, angle, past_end); see plain.py"},
    {"gather", gather, METH_VARARGS,
     "gather(x, y, z, rule, transform, beams, bins, ranges, numbers) -> the same counts; see plain.py"},
    {"deskew", deskew, METH_VARARGS,
     "deskew(x, y, z, times, node_times, transforms, out) -> points without a transform; see plain.py"},
    {"trace", trace, METH_VARARGS, "trace(cells, width, mark, rays, hits): rays into a grid; see plain.py"},
    {"angles", angles, METH_VARARGS, "angles(x, y, out, glibc=False): atan2(y, x) of contiguous float32; see plain.py"},
    {NULL, NULL, 0, NULL},
};

static int prepare(PyObject *self) {
    (void)self;
#ifdef EIGHT
    prepare_eight();
#endif
    return 0;
}

static PyModuleDef_Slot slots[] = {{Py_mod_exec, prepare}, {0, NULL}};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_kernel", NULL, 0, methods, slots, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__kernel(void) { return PyModuleDef_Init(&module); }
