/* The inner loops of the projection, of deskewing and of maps. project.py, rule.py and occupancy.py describe the rules;
   this file makes them fast.

   Points are taken a block at a time, small enough for the first-level cache: load and drop by height, one loop, or
   eight at a time; then squares, angles and bins, loops without branches that compilers turn into vector
   instructions; then the minimum of each bin. Points are transformed in float32, every product and every sum rounded,
   from left to right, as tf2_sensor_msgs does it. Compiled with -ffp-contract=off: a fused multiply-add rounds
   otherwise than upstream does. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <float.h>
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

/* Numbers below it can be multiplied and added up without becoming infinite, nor then NaN. */
#define TAME 1e18f

/* A part of the time in which a cloud was measured. The transform in it is a polynomial of the time: start + s * (rate +
   s * bend), with s from 0 to 1; each has twelve numbers, the rows of a rotation, then a translation. */
typedef struct {
    /* A time belongs to the first part that ends at it or behind it. */
    double begin, end, scale;
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
    /* Points with coordinates that have no time, or no transform at their time. */
    int64_t untimed, nowhere;
    /* Points whose z is outside of these may have any x and y. */
    float lowest, highest;
} Motion;

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

static inline uint32_t read_unsigned(const char *from) {
    uint32_t value;
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
    uint64_t u64;
    switch (axis->size) {
        case 1: memcpy(&u8, from, 1); return axis->kind == 'i' ? (int8_t)u8 : u8;
        case 2: memcpy(&u16, from, 2); return axis->kind == 'i' ? (int16_t)u16 : u16;
        case 8: memcpy(&u64, from, 8); return axis->kind == 'i' ? (double)(int64_t)u64 : (double)u64;
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

/* The part that a time lies in: -1 if it is in none, or NaN. */
static Py_ssize_t part_at(const Motion *motion, double time) {
    const Part *parts = motion->parts;
    Py_ssize_t part = motion->part, last = motion->count - 1;
    if (!(time >= parts[0].begin && time <= parts[last].end)) return -1;
    if (!(time > parts[part].begin && time <= parts[part].end)) {
        if (part < last && time > parts[part].end && time <= parts[part + 1].end) part++;
        else {
            Py_ssize_t low = 0, high = last;
            while (low < high) {
                Py_ssize_t middle = (low + high) / 2;
                if (parts[middle].end < time) low = middle + 1;
                else high = middle;
            }
            part = low;
        }
    }
    /* Where transforms begin to be known, their first one is. */
    if (!parts[part].known && part < last && time == parts[part].end) part++;
    return part;
}

enum { PADDED = BLOCK + 8 };

/* Points of a block, and where they are at their own times. */
typedef struct {
    float x[PADDED], y[PADDED], z[PADDED], to_x[PADDED], to_y[PADDED], to_z[PADDED];
    double times[PADDED];
} Moved;

/* One coordinate of a point: the row from 3 * axis on, and a part of the translation. */
static inline float move_one(const Part *part, int axis, float x, float y, float z, float s) {
    const double *start = part->start + 3 * axis;
    const float *rate = part->rate + 3 * axis, *bend = part->bend + 3 * axis;
    const float along = rate[0] * x + rate[1] * y + rate[2] * z + part->rate[9 + axis];
    const float aside = bend[0] * x + bend[1] * y + bend[2] * z + part->bend[9 + axis];
    const double place = start[0] * x + start[1] * y + start[2] * z + part->start[9 + axis];
    return (float)(place + s * (along + s * aside));
}

/* Transform points as long as they are of one part. Returns the first one that is not. */
static int move_run(const Part *part, Moved *block, int from, int end) {
    int i = from;
    for (; i < end && (i == from || (block->times[i] > part->begin && block->times[i] <= part->end)); i++) {
        const float s = (float)((block->times[i] - part->begin) * part->scale);
        const float x = block->x[i], y = block->y[i], z = block->z[i];
        block->to_x[i] = move_one(part, 0, x, y, z, s);
        block->to_y[i] = move_one(part, 1, x, y, z, s);
        block->to_z[i] = move_one(part, 2, x, y, z, s);
    }
    return i;
}

#ifdef EIGHT
#define EIGHT_WIDE __attribute__((target("avx2,popcnt"), always_inline)) static inline

/* A row of twelve numbers times points. */
EIGHT_WIDE __m256d row_four(const double *row, const double *offset, __m256d x, __m256d y, __m256d z) {
    __m256d sum = _mm256_mul_pd(_mm256_broadcast_sd(row), x);
    sum = _mm256_add_pd(sum, _mm256_mul_pd(_mm256_broadcast_sd(row + 1), y));
    sum = _mm256_add_pd(sum, _mm256_mul_pd(_mm256_broadcast_sd(row + 2), z));
    return _mm256_add_pd(sum, _mm256_broadcast_sd(offset));
}

EIGHT_WIDE __m128 upper(__m256 eight) { return _mm256_extractf128_ps(eight, 1); }
EIGHT_WIDE __m128 lower(__m256 eight) { return _mm256_castps256_ps128(eight); }

/* The same as move_one. */
EIGHT_WIDE __m256 move_eight(const Part *part, int axis, __m256 x, __m256 y, __m256 z, __m256 s, const __m256d wide[6]) {
    const __m256 along = turn_eight(x, y, z, part->rate + 3 * axis, part->rate + 9 + axis);
    const __m256 aside = turn_eight(x, y, z, part->bend + 3 * axis, part->bend + 9 + axis);
    const __m256 away = _mm256_mul_ps(s, _mm256_add_ps(along, _mm256_mul_ps(s, aside)));
    const double *row = part->start + 3 * axis, *offset = part->start + 9 + axis;
    const __m256d low = row_four(row, offset, wide[0], wide[1], wide[2]);
    const __m256d high = row_four(row, offset, wide[3], wide[4], wide[5]);
    return _mm256_set_m128(_mm256_cvtpd_ps(_mm256_add_pd(high, _mm256_cvtps_pd(upper(away)))),
                           _mm256_cvtpd_ps(_mm256_add_pd(low, _mm256_cvtps_pd(lower(away)))));
}

/* The same as move_run, eight at a time: what is written behind the last one is overwritten later. Where all eight are
   too high or too low, their x and y are not needed; 0 stands for them, unless they may be NaN, which counts first. */
__attribute__((target("avx2,popcnt"))) static int move_run_eight(const Part *part, Moved *block, int from, int end,
                                                                 float lowest, float highest) {
    const __m256d begin = _mm256_set1_pd(part->begin), scale = _mm256_set1_pd(part->scale);
    const __m256d close = _mm256_set1_pd(part->end);
    const __m256 least = _mm256_set1_ps(lowest), most = _mm256_set1_ps(highest), tame = _mm256_set1_ps(TAME);
    const __m256 absolute = _mm256_castsi256_ps(_mm256_set1_epi32(0x7fffffff));
    for (int i = from; i < end; i += 8) {
        const __m256d first = _mm256_loadu_pd(block->times + i), second = _mm256_loadu_pd(block->times + i + 4);
        const __m256d own_first = _mm256_and_pd(_mm256_cmp_pd(first, begin, _CMP_GT_OQ), _mm256_cmp_pd(first, close, _CMP_LE_OQ));
        const __m256d own_second = _mm256_and_pd(_mm256_cmp_pd(second, begin, _CMP_GT_OQ), _mm256_cmp_pd(second, close, _CMP_LE_OQ));
        /* Of the very first point the part is known. */
        const int own = _mm256_movemask_pd(own_first) | _mm256_movemask_pd(own_second) << 4 | (i == from);
        const __m256 s = _mm256_set_m128(_mm256_cvtpd_ps(_mm256_mul_pd(_mm256_sub_pd(second, begin), scale)),
                                         _mm256_cvtpd_ps(_mm256_mul_pd(_mm256_sub_pd(first, begin), scale)));
        const __m256 x = _mm256_loadu_ps(block->x + i), y = _mm256_loadu_ps(block->y + i);
        const __m256 z = _mm256_loadu_ps(block->z + i);
        const __m256d wide[6] = {_mm256_cvtps_pd(lower(x)), _mm256_cvtps_pd(lower(y)), _mm256_cvtps_pd(lower(z)),
                                 _mm256_cvtps_pd(upper(x)), _mm256_cvtps_pd(upper(y)), _mm256_cvtps_pd(upper(z))};
        const __m256 to_z = move_eight(part, 2, x, y, z, s, wide);
        _mm256_storeu_ps(block->to_z + i, to_z);
        const __m256 away = _mm256_or_ps(_mm256_cmp_ps(to_z, least, _CMP_LT_OQ), _mm256_cmp_ps(to_z, most, _CMP_GT_OQ));
        const __m256 sum = _mm256_add_ps(_mm256_and_ps(x, absolute), _mm256_add_ps(_mm256_and_ps(y, absolute), _mm256_and_ps(z, absolute)));
        const __m256 finite = _mm256_cmp_ps(sum, tame, _CMP_LE_OQ);
        if (part->tame && _mm256_movemask_ps(_mm256_and_ps(away, finite)) == 255) {
            _mm256_storeu_ps(block->to_x + i, _mm256_setzero_ps());
            _mm256_storeu_ps(block->to_y + i, _mm256_setzero_ps());
        } else {
            _mm256_storeu_ps(block->to_x + i, move_eight(part, 0, x, y, z, s, wide));
            _mm256_storeu_ps(block->to_y + i, move_eight(part, 1, x, y, z, s, wide));
        }
        if (own != 255) return i + __builtin_ctz(~(unsigned)own) < end ? i + __builtin_ctz(~(unsigned)own) : end;
    }
    return end;
}
#endif

static void move_block(Motion *motion, Moved *block, const int count) {
    for (int i = 0; i < count;) {
        const double time = block->times[i];
        const Py_ssize_t number = part_at(motion, time);
        if (number >= 0 && motion->parts[number].known) {
            const Part *part = &motion->parts[number];
            motion->part = number;
#ifdef EIGHT
            if (eight_at_once) {
                i = move_run_eight(part, block, i, count, motion->lowest, motion->highest);
                continue;
            }
#endif
            i = move_run(part, block, i, count);
            continue;
        }
        if (block->x[i] == block->x[i] && block->y[i] == block->y[i] && block->z[i] == block->z[i]) {
            motion->nowhere += time == time;
            motion->untimed += time != time;
        }
        block->to_x[i] = block->to_y[i] = block->to_z[i] = NAN;
        i++;
    }
}

#ifdef EIGHT
/* The same as what load_eight begins with. */
__attribute__((target("avx2"))) static int transpose_eight(const char *from, Py_ssize_t step, int count, float *x,
                                                           float *y, float *z) {
    const Py_ssize_t lines = step < 64 ? 64 : step;
    int taken = 0;
    for (; taken + 8 < count; taken += 8, from += 8 * step) {
        __m256 pair[4];
        for (Py_ssize_t line = 0; line < 8 * step; line += lines) PREFETCH(from + line);
        for (int i = 0; i < 4; i++) {
            const char *one = from + i * step, *other = from + (i + 4) * step;
            pair[i] = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps((const float *)one)),
                                           _mm_loadu_ps((const float *)other), 1);
        }
        const __m256 xy = _mm256_unpacklo_ps(pair[0], pair[1]), yx = _mm256_unpacklo_ps(pair[2], pair[3]);
        const __m256 zs = _mm256_unpackhi_ps(pair[0], pair[1]), sz = _mm256_unpackhi_ps(pair[2], pair[3]);
        _mm256_storeu_ps(x + taken, _mm256_shuffle_ps(xy, yx, 0x44));
        _mm256_storeu_ps(y + taken, _mm256_shuffle_ps(xy, yx, 0xee));
        _mm256_storeu_ps(z + taken, _mm256_shuffle_ps(zs, sz, 0x44));
    }
    return taken;
}

/* Append points to a scan's, without those that are NaN or too high or low. */
__attribute__((target("avx2,popcnt"))) static void append_eight(Scan *scan, const float *x, const float *y,
                                                                const float *z, int count) {
    const __m256 lowest = _mm256_set1_ps((float)scan->rule.lowest), highest = _mm256_set1_ps((float)scan->rule.highest);
    int64_t nans = 0, kept = 0;
    for (int i = 0; i < count; i += 8) {
        const int lanes = count - i < 8 ? (1 << (count - i)) - 1 : 255;
        const __m256 px = _mm256_loadu_ps(x + i), py = _mm256_loadu_ps(y + i), pz = _mm256_loadu_ps(z + i);
        const __m256 nan = _mm256_or_ps(_mm256_cmp_ps(px, py, _CMP_UNORD_Q), _mm256_cmp_ps(pz, pz, _CMP_UNORD_Q));
        const __m256 inside = _mm256_and_ps(_mm256_cmp_ps(pz, lowest, _CMP_GE_OQ), _mm256_cmp_ps(pz, highest, _CMP_LE_OQ));
        const int keep = _mm256_movemask_ps(_mm256_andnot_ps(nan, inside)) & lanes;
        nans += __builtin_popcount((unsigned)(_mm256_movemask_ps(nan) & lanes));
        if (!keep) continue;
        if (scan->filled > BLOCK - 8) project_block(scan);
        const __m256i to = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128((long long)together[keep]));
        _mm256_storeu_ps(scan->x + scan->filled, _mm256_permutevar8x32_ps(px, to));
        _mm256_storeu_ps(scan->y + scan->filled, _mm256_permutevar8x32_ps(py, to));
        const int more = __builtin_popcount((unsigned)keep);
        scan->filled += more;
        kept += more;
    }
    scan->nan += nans;
    scan->height += count - nans - kept;
}
#endif

/* The same, with any processor, and with the points' numbers if the scan gathers these. */
static void append(Scan *scan, const float *x, const float *y, const float *z, int64_t number, int count) {
#ifdef EIGHT
    if (eight_at_once && scan->smallest) {
        append_eight(scan, x, y, z, count);
        return;
    }
#endif
    while (count > 0) {
        const int filled = scan->filled, take = count < BLOCK - filled ? count : BLOCK - filled;
        memcpy(scan->x + filled, x, (size_t)take * sizeof *x);
        memcpy(scan->y + filled, y, (size_t)take * sizeof *y);
        memcpy(scan->z + filled, z, (size_t)take * sizeof *z);
        if (!scan->smallest)
            for (int i = 0; i < take; i++) scan->number[filled + i] = number + i;
        drop_by_height(scan, filled, take);
        if (scan->filled == BLOCK) project_block(scan);
        x += take, y += take, z += take, number += take, count -= take;
    }
}

/* So many values of any type. */
static void read_values(const Axis *axis, const char *from, int count, double *to) {
    const Py_ssize_t step = axis->step;
    if (axis->swapped || (axis->size != 4 && axis->size != 8))
        for (int i = 0; i < count; i++) to[i] = read_any(from + i * step, axis);
    else if (axis->kind == 'f' && axis->size == 8)
        for (int i = 0; i < count; i++) to[i] = read_double(from + i * step);
    else if (axis->kind == 'f')
        for (int i = 0; i < count; i++) to[i] = read_float(from + i * step);
    else if (axis->kind == 'u')
        for (int i = 0; i < count; i++) to[i] = read_unsigned(from + i * step);
    else
        for (int i = 0; i < count; i++) to[i] = read_any(from + i * step, axis);
}

WIDEST static void to_seconds(double *times, int count, double offset, double unit) {
    for (int i = 0; i < count; i++) times[i] = (times[i] - offset) * unit;
}

/* Read points of one row, and move them. */
static void move_points(Motion *motion, const Axis axis[3], const int common, Py_ssize_t row, Py_ssize_t column, int count,
                        Moved *block) {
    const char *from[3];
    float *to[3] = {block->x, block->y, block->z};
    for (int k = 0; k < 3; k++) from[k] = axis[k].data + row * axis[k].row_step + column * axis[k].step;
    int taken = 0;
#ifdef EIGHT
    if (eight_at_once && common == FLOATS && from[1] - from[0] == 4 && from[2] - from[0] == 8 && axis[0].step >= 12 &&
        axis[1].step == axis[0].step && axis[2].step == axis[0].step)
        taken = transpose_eight(from[0], axis[0].step, count, block->x, block->y, block->z);
#endif
    for (int k = 0; k < 3; k++)
        if (common == FLOATS)
            for (int i = taken; i < count; i++) to[k][i] = read_float(from[k] + i * axis[k].step);
        else
            for (int i = taken; i < count; i++) to[k][i] = (float)read_any(from[k] + i * axis[k].step, &axis[k]);
    const Axis *field = &motion->times;
    const double offset = motion->offset, unit = motion->unit;
    read_values(field, field->data + row * field->row_step + column * field->step, count, block->times);
    to_seconds(block->times, count, offset, unit);
    /* Moved as well, up to eight at a time. */
    for (int i = count; i < count + 8; i++) block->x[i] = block->y[i] = block->z[i] = 0, block->times[i] = 0;
    move_block(motion, block, count);
}

static void load_moving(Scan *scan, const Axis axis[3], Py_ssize_t rows, Py_ssize_t columns, Motion *motion) {
    const int common = in_common(axis);
    Moved block;
    motion->lowest = (float)scan->rule.lowest;
    motion->highest = (float)scan->rule.highest;
    for (Py_ssize_t row = 0; row < rows; row++)
        for (Py_ssize_t column = 0; column < columns; column += BLOCK) {
            const int count = columns - column < BLOCK ? (int)(columns - column) : BLOCK;
            move_points(motion, axis, common, row, column, count, &block);
            append(scan, block.to_x, block.to_y, block.to_z, (int64_t)row * columns + column, count);
        }
    if (scan->filled) project_block(scan);
    /* They have no coordinates any more, and were taken for points without. */
    scan->nan -= motion->untimed + motion->nowhere;
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
    int held, has_transform, has_motion;
    Motion motion;
} Cloud;

static void release_motion(Motion *motion) {
    PyMem_Free(motion->parts);
    if (motion->held > 2) PyBuffer_Release(&motion->rows);
    if (motion->held > 1) PyBuffer_Release(&motion->nodes);
    if (motion->held > 0) PyBuffer_Release(&motion->times_of);
}

static void release(Cloud *cloud) {
    while (cloud->held > 0) PyBuffer_Release(&cloud->coordinates[--cloud->held]);
    if (cloud->rule.obj) PyBuffer_Release(&cloud->rule);
    if (cloud->has_transform) PyBuffer_Release(&cloud->transform);
    if (cloud->has_motion) release_motion(&cloud->motion);
}

/* The type of an array's values, from its dtype; with integers of eight bytes if they may be that wide. */
static int find_type(PyObject *dtype, Axis *axis, Py_ssize_t item, int wide) {
    PyObject *text = PyObject_GetAttrString(dtype, "str");
    if (!text) return -1;
    const char *type = PyUnicode_AsUTF8AndSize(text, NULL);
    int known = type && type[0] && type[1] && strchr("iuf", type[1]) && type[2] && !type[3];
    if (known) {
        axis->kind = type[1];
        axis->size = type[2] - '0';
        known = axis->size == item && (axis->kind == 'f' ? item == 4 || item == 8 : item == 1 || item == 2 || item == 4 || wide);
        axis->swapped = type[0] == (PY_BIG_ENDIAN ? '<' : '>');
    }
    Py_DECREF(text);
    if (type && !known) PyErr_SetString(PyExc_ValueError, "coordinates or times are of a type that no PointField has");
    return known ? 0 : -1;
}

static int take_coordinates(Cloud *cloud, PyObject *xyz[3]) {
    memset(cloud, 0, sizeof *cloud);
    const Py_buffer *like = &cloud->coordinates[0];
    /* As a rule all have one: what NumPy says of it takes as long as projecting 300 points. */
    PyObject *last = NULL;
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
        PyObject *dtype = PyObject_GetAttrString(xyz[cloud->held], "dtype");
        const int known = dtype && dtype == last;
        if (known) *axis = axis[-1];
        Py_XDECREF(last);
        last = dtype;
        if (!dtype || (!known && find_type(dtype, axis, view->itemsize, 0) < 0)) {
            PyBuffer_Release(view);
            goto failed;
        }
        axis->data = view->buf;
        axis->step = view->strides[view->ndim - 1];
        axis->row_step = view->ndim == 2 ? view->strides[0] : 0;
    }
    Py_XDECREF(last);
    cloud->rows = like->ndim == 2 ? like->shape[0] : 1;
    cloud->columns = like->shape[like->ndim - 1];
    return 0;
failed:
    Py_XDECREF(last);
    release(cloud);
    return -1;
}

/* A field of each point, besides the coordinates. */
static int take_field(const Cloud *cloud, PyObject *array, Py_buffer *view, Axis *axis) {
    const Py_buffer *like = &cloud->coordinates[0];
    if (PyObject_GetBuffer(array, view, PyBUF_STRIDES) < 0) return -1;
    int same = view->ndim == like->ndim;
    for (int i = 0; same && i < view->ndim; i++) same = view->shape[i] == like->shape[i];
    if (!same) PyErr_SetString(PyExc_ValueError, "times are not of the coordinates' shape");
    PyObject *dtype = same ? PyObject_GetAttrString(array, "dtype") : NULL;
    const int found = dtype ? find_type(dtype, axis, view->itemsize, 1) : -1;
    Py_XDECREF(dtype);
    if (found < 0) {
        PyBuffer_Release(view);
        return -1;
    }
    axis->data = view->buf;
    axis->step = view->strides[view->ndim - 1];
    axis->row_step = view->ndim == 2 ? view->strides[0] : 0;
    return 0;
}

/* A polynomial through three transforms: at the beginning, in the middle, and at the end of a part. */
static void fit_part(Part *part, double begin, double end, const double *first) {
    const double *middle = first + 12, *last = first + 24;
    part->begin = begin;
    part->end = end;
    part->scale = 1.0 / (end - begin);
    part->known = first[0] == first[0] && middle[0] == middle[0] && last[0] == last[0];
    part->tame = 1;
    for (int k = 0; k < 12; k++) {
        part->start[k] = first[k];
        part->rate[k] = (float)((4 * middle[k] - 3 * first[k]) - last[k]);
        part->bend[k] = (float)(2 * ((first[k] - 2 * middle[k]) + last[k]));
        part->tame &= fabs(part->start[k]) < TAME && fabsf(part->rate[k]) < TAME && fabsf(part->bend[k]) < TAME;
    }
}

/* A motion from Python: (times, offset, unit, node_times, rows); see plain.py. */
static int take_motion(Cloud *cloud, PyObject *tuple) {
    Motion *motion = &cloud->motion;
    PyObject *times, *nodes, *rows;
    if (!PyArg_ParseTuple(tuple, "OddOO", &times, &motion->offset, &motion->unit, &nodes, &rows)) return -1;
    cloud->has_motion = 1;
    if (take_field(cloud, times, &motion->times_of, &motion->times) < 0) return -1;
    motion->held = 1;
    if (contiguous(nodes, &motion->nodes, PyBUF_SIMPLE, 8, -1) < 0) return -1;
    motion->held = 2;
    const Py_ssize_t count = motion->nodes.len / 8 - 1;
    if (count < 1) {
        PyErr_SetString(PyExc_ValueError, "there are fewer than two nodes");
        return -1;
    }
    if (contiguous(rows, &motion->rows, PyBUF_SIMPLE, 8, (2 * count + 1) * 12) < 0) return -1;
    motion->held = 3;
    motion->parts = PyMem_Malloc((size_t)count * sizeof *motion->parts);
    if (!motion->parts) {
        PyErr_NoMemory();
        return -1;
    }
    motion->count = count;
    const double *ends = motion->nodes.buf, *transforms = motion->rows.buf;
    for (Py_ssize_t k = 0; k < count; k++) fit_part(&motion->parts[k], ends[k], ends[k + 1], transforms + 24 * k);
    return 0;
}

static int take(Cloud *cloud, PyObject *xyz[3], PyObject *rule, PyObject *transform) {
    if (take_coordinates(cloud, xyz) < 0) return -1;
    if (contiguous(rule, &cloud->rule, PyBUF_SIMPLE, 8, sizeof(Rule) / 8) < 0) {
        cloud->rule.obj = NULL;
        goto failed;
    }
    if (PyTuple_Check(transform)) {
        if (take_motion(cloud, transform) < 0) goto failed;
    } else if (transform != Py_None) {
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

static void run(Scan *scan, Cloud *cloud) {
    if (cloud->has_motion) load_moving(scan, cloud->axis, cloud->rows, cloud->columns, &cloud->motion);
    else load_rows(scan, cloud->axis, cloud->rows, cloud->columns, cloud->has_transform ? cloud->transform.buf : NULL);
}

/* Let other threads have the interpreter, unless taking turns takes longer than this many points or beams do. */
static PyThreadState *let_others(Py_ssize_t work) { return work > 16384 ? PyEval_SaveThread() : NULL; }

static PyObject *rejection_counts(const Scan *scan, const Cloud *cloud) {
    const long long nan = scan->nan, height = scan->height, range = scan->rejected[TOO_FAR];
    const long long angle = scan->rejected[OUTSIDE], past_end = scan->rejected[PAST_END];
    if (!cloud->has_motion) return Py_BuildValue("(LLLLL)", nan, height, range, angle, past_end);
    const long long untimed = cloud->motion.untimed, nowhere = cloud->motion.nowhere;
    return Py_BuildValue("(LLLLLLL)", nan, height, range, angle, past_end, untimed, nowhere);
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
            result = rejection_counts(scan, &cloud);
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
        result = rejection_counts(scan, &cloud);
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

/* The coordinates of a cloud's points at their own times. */
static void deskew_cloud(Cloud *cloud, float *out) {
    const int common = in_common(cloud->axis);
    Moved block;
    cloud->motion.lowest = -INFINITY;
    cloud->motion.highest = INFINITY;
    for (Py_ssize_t row = 0; row < cloud->rows; row++)
        for (Py_ssize_t column = 0; column < cloud->columns; column += BLOCK) {
            const int count = cloud->columns - column < BLOCK ? (int)(cloud->columns - column) : BLOCK;
            move_points(&cloud->motion, cloud->axis, common, row, column, count, &block);
            for (int i = 0; i < count; i++, out += 3) {
                out[0] = block.to_x[i];
                out[1] = block.to_y[i];
                out[2] = block.to_z[i];
            }
        }
}

static PyObject *deskew(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *xyz[3], *motion, *out_of, *result = NULL;
    if (!PyArg_ParseTuple(args, "OOOO!O", &xyz[0], &xyz[1], &xyz[2], &PyTuple_Type, &motion, &out_of)) return NULL;
    Cloud cloud;
    if (take_coordinates(&cloud, xyz) < 0) return NULL;
    const Py_ssize_t most = cloud.rows * cloud.columns;
    Py_buffer out;
    if (take_motion(&cloud, motion) == 0 && contiguous(out_of, &out, PyBUF_WRITABLE, 4, 3 * most) == 0) {
        PyThreadState *state = let_others(most);
        deskew_cloud(&cloud, out.buf);
        if (state) PyEval_RestoreThread(state);
        result = Py_BuildValue("(LL)", (long long)cloud.motion.untimed, (long long)cloud.motion.nowhere);
        PyBuffer_Release(&out);
    }
    release(&cloud);
    return result;
}

/* The least and the largest value of a field, of the points whose x is not NaN. */
typedef struct {
    double low, high;
    int64_t measured, unknown;
} Span;

static void widen(Span *span, const double *values, const float *x, int count) {
    for (int i = 0; i < count; i++) {
        if (x[i] != x[i]) continue;
        span->measured++;
        if (fabs(values[i]) <= DBL_MAX) {
            span->low = values[i] < span->low ? values[i] : span->low;
            span->high = values[i] > span->high ? values[i] : span->high;
        } else span->unknown++;
    }
}

#ifdef EIGHT
/* The same, four at a time; up to three behind the last one have to be NaN. */
__attribute__((target("avx2,popcnt"))) static void widen_four(Span *span, const double *values, const float *x, int count) {
    __m256d low = _mm256_set1_pd(span->low), high = _mm256_set1_pd(span->high);
    const __m256d largest = _mm256_set1_pd(DBL_MAX), sign = _mm256_set1_pd(-0.0);
    int measured = 0, known = 0;
    for (int i = 0; i < count; i += 4) {
        const __m256d value = _mm256_loadu_pd(values + i), own = _mm256_cvtps_pd(_mm_loadu_ps(x + i));
        const __m256d there = _mm256_cmp_pd(own, own, _CMP_ORD_Q);
        const __m256d finite = _mm256_cmp_pd(_mm256_andnot_pd(sign, value), largest, _CMP_LE_OQ);
        const __m256d taken = _mm256_and_pd(there, finite);
        measured += __builtin_popcount((unsigned)_mm256_movemask_pd(there));
        known += __builtin_popcount((unsigned)_mm256_movemask_pd(taken));
        /* The second one where the first is NaN. */
        const __m256d one = _mm256_blendv_pd(_mm256_set1_pd(NAN), value, taken);
        low = _mm256_min_pd(one, low);
        high = _mm256_max_pd(one, high);
    }
    double lows[4], highs[4];
    _mm256_storeu_pd(lows, low);
    _mm256_storeu_pd(highs, high);
    for (int k = 0; k < 4; k++) {
        span->low = lows[k] < span->low ? lows[k] : span->low;
        span->high = highs[k] > span->high ? highs[k] : span->high;
    }
    span->measured += measured;
    span->unknown += measured - known;
}
#endif

static PyObject *span(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *x_of, *values_of;
    if (!PyArg_ParseTuple(args, "OO", &x_of, &values_of)) return NULL;
    PyObject *xyz[3] = {x_of, x_of, x_of}, *result = NULL;
    Cloud cloud;
    if (take_coordinates(&cloud, xyz) < 0) return NULL;
    Motion motion = {.unit = 1.0};
    if (take_field(&cloud, values_of, &motion.times_of, &motion.times) == 0) {
        Span found = {INFINITY, -INFINITY, 0, 0};
        PyThreadState *state = let_others(cloud.rows * cloud.columns);
        const Axis *axis = &cloud.axis[0], *field = &motion.times;
        const int plain = axis->kind == 'f' && axis->size == 4 && !axis->swapped;
        float x[PADDED];
        double values[PADDED];
        for (Py_ssize_t row = 0; row < cloud.rows; row++)
            for (Py_ssize_t column = 0; column < cloud.columns; column += BLOCK) {
                const int count = cloud.columns - column < BLOCK ? (int)(cloud.columns - column) : BLOCK;
                const char *from = axis->data + row * axis->row_step + column * axis->step;
                if (plain)
                    for (int i = 0; i < count; i++, from += axis->step) {
                        PREFETCH(from);
                        x[i] = read_float(from);
                    }
                else
                    for (int i = 0; i < count; i++, from += axis->step) x[i] = (float)read_any(from, axis);
                read_values(field, field->data + row * field->row_step + column * field->step, count, values);
                for (int i = count; i < count + 8; i++) values[i] = x[i] = NAN;
#ifdef EIGHT
                if (eight_at_once) {
                    widen_four(&found, values, x, count);
                    continue;
                }
#endif
                widen(&found, values, x, count);
            }
        if (state) PyEval_RestoreThread(state);
        result = Py_BuildValue("(ddLL)", found.low, found.high, (long long)found.measured, (long long)found.unknown);
        PyBuffer_Release(&motion.times_of);
    }
    release(&cloud);
    return result;
}

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

static PyObject *follow(PyObject *self, PyObject *args) {
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

/* A grid of log-odds that rays are drawn into; occupancy.py has the numbers. */
enum { UNKNOWN = -128, HIT = 17, MISS = -8, LOWEST = -40, HIGHEST = 70 };

/* A cell's high byte is its log-odds, the low one the mark of the last scan that changed it. */
typedef struct {
    int16_t *cells;
    int mark;
} Grid;

/* A cell takes the first change of each scan. Without branches: whether another beam was here is hard to predict. */
INLINED void observe(const Grid *grid, int64_t place, const int change) {
    const int cell = grid->cells[place], odds = cell >> 8;
    int value = (odds == UNKNOWN ? 0 : odds) + change;
    if (change < 0) value = value < LOWEST ? LOWEST : value;
    else value = value > HIGHEST ? HIGHEST : value;
    const int changed = value * 256 + grid->mark;
    grid->cells[place] = (int16_t)((cell & 255) == grid->mark ? cell : changed);
}

/* The cells of a line, by Bresenham's algorithm; the last one only if nothing was hit there. */
static void draw_free(const Grid *grid, int64_t width, const int32_t *ray, int hit) {
    const int64_t dx = (int64_t)ray[2] - ray[0], dy = (int64_t)ray[3] - ray[1];
    const int64_t across = dx < 0 ? -dx : dx, up = dy < 0 ? -dy : dy;
    const int64_t along_x = dx < 0 ? -1 : 1, along_y = dy < 0 ? -width : width;
    const int64_t length = across > up ? across : up, other = across > up ? up : across;
    const int64_t step = across > up ? along_x : along_y, aside = across > up ? along_y : along_x;
    /* Of each step: what is added if the line goes straight on, and if it also goes aside. */
    const int64_t straight = 2 * other, turned = 2 * other - 2 * length, both = step + aside;
    int64_t place = ray[1] * width + ray[0], error = length;
    for (int64_t left = length + !hit; left > 0; left--) {
        observe(grid, place, MISS);
        const int64_t on = error + straight, off = error + turned;
        place += off >= 0 ? both : step;
        error = off >= 0 ? off : on;
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
     "deskew(x, y, z, motion, out) -> points without a time, and without a transform; see plain.py"},
    {"span", span, METH_VARARGS, "span(x, values) -> (least, largest, measured, unknown); see plain.py"},
    {"follow", follow, METH_VARARGS, "follow(times, stamps, poses, rows): one frame's poses; see plain.py"},
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
