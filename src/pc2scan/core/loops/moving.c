/* Points at their own times: each is read, transformed by the part of the motion that its time lies in, and projected. */

#include "moving.h"

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

/* The row and the errors of z. A polynomial moves away from its start by at most the sum of its other coefficients. */
static void bound_z(Motion *motion) {
    double widest = 0, largest = 0;
    motion->whole = 1;
    for (Py_ssize_t i = 0; i < motion->count; i++) motion->whole &= motion->parts[i].known & motion->parts[i].tame;
    for (int k = 0; k < 4; k++) {
        const int at = k < 3 ? 6 + k : 11;
        double low = INFINITY, high = -INFINITY;
        for (Py_ssize_t i = 0; i < motion->count && motion->whole; i++) {
            const Part *part = &motion->parts[i];
            const double away = fabs((double)part->rate[at]) + fabs((double)part->bend[at]);
            low = fmin(low, part->start[at] - away);
            high = fmax(high, part->start[at] + away);
        }
        motion->row[k] = (float)((low + high) / 2);
        /* What float32 rounds, here and where points are moved, is far below four millionths of the summands. */
        const double error = (high - low) / 2 + 4e-6 * fmax(fabs(low), fabs(high));
        if (k == 3) motion->level = (float)(1.000001 * error + FLT_MIN);
        widest = k < 3 ? fmax(widest, (high - low) / 2) : widest;
        largest = k < 3 ? fmax(largest, fmax(fabs(low), fabs(high))) : largest;
    }
    motion->slope = (float)(1.000001 * (widest + 4e-6 * largest));
}

int take_motion(Motion *motion, const Cloud *cloud, PyObject *tuple) {
    PyObject *times, *nodes, *rows;
    if (!PyArg_ParseTuple(tuple, "OddOOp", &times, &motion->offset, &motion->unit, &nodes, &rows, &motion->timed)) return -1;
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
    bound_z(motion);
    return 0;
}

void release_motion(Motion *motion) {
    PyMem_Free(motion->parts);
    if (motion->held > 2) PyBuffer_Release(&motion->rows);
    if (motion->held > 1) PyBuffer_Release(&motion->nodes);
    if (motion->held > 0) PyBuffer_Release(&motion->times_of);
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
/* A row of twelve numbers times points. */
EIGHT_INLINED __m256d row_four(const double *row, const double *offset, __m256d x, __m256d y, __m256d z) {
    __m256d sum = _mm256_mul_pd(_mm256_broadcast_sd(row), x);
    sum = _mm256_add_pd(sum, _mm256_mul_pd(_mm256_broadcast_sd(row + 1), y));
    sum = _mm256_add_pd(sum, _mm256_mul_pd(_mm256_broadcast_sd(row + 2), z));
    return _mm256_add_pd(sum, _mm256_broadcast_sd(offset));
}

EIGHT_INLINED __m128 upper(__m256 eight) { return _mm256_extractf128_ps(eight, 1); }
EIGHT_INLINED __m128 lower(__m256 eight) { return _mm256_castps256_ps128(eight); }

/* The same as move_one. */
EIGHT_INLINED __m256 move_eight(const Part *part, int axis, __m256 x, __m256 y, __m256 z, __m256 s, const __m256d wide[6]) {
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
EIGHT_WIDE static int move_run_eight(const Part *part, Moved *block, int from, int end, float lowest, float highest) {
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
/* Read points as long as what is read of them stays in front of the last one; returns how many. */
EIGHT_WIDE static int read_eight(const char *from, Py_ssize_t step, int count, float *x, float *y, float *z) {
    int taken = 0;
    for (; taken + 8 < count; taken += 8, from += 8 * step) {
        __m256 px, py, pz;
        prefetch_points(from, step);
        load_points(from, step, &px, &py, &pz);
        _mm256_storeu_ps(x + taken, px);
        _mm256_storeu_ps(y + taken, py);
        _mm256_storeu_ps(z + taken, pz);
    }
    return taken;
}

/* Read values of four bytes as long as what is read of them stays in front of the last one; returns how many. */
EIGHT_WIDE static int read_eight_values(const Axis *axis, const char *from, int count, double *to) {
    const Py_ssize_t step = axis->step;
    /* An unsigned number is a signed one with its highest bit turned, and half of what they have more. */
    const __m256i turn = _mm256_set1_epi32(axis->kind == 'u' ? INT32_MIN : 0);
    const __m256d more = _mm256_set1_pd(axis->kind == 'u' ? 0x1p31 : 0);
    int taken = 0;
    if (axis->size != 4 || axis->swapped || (step != 4 && step < 12)) return 0;
    for (; taken + 8 < count; taken += 8, from += 8 * step) {
        const __m256 eight = eight_singles(from, step);
        __m256d low = _mm256_cvtps_pd(lower(eight)), high = _mm256_cvtps_pd(upper(eight));
        if (axis->kind != 'f') {
            const __m256i whole = _mm256_xor_si256(_mm256_castps_si256(eight), turn);
            low = _mm256_add_pd(_mm256_cvtepi32_pd(_mm256_castsi256_si128(whole)), more);
            high = _mm256_add_pd(_mm256_cvtepi32_pd(_mm256_extracti128_si256(whole, 1)), more);
        }
        _mm256_storeu_pd(to + taken, low);
        _mm256_storeu_pd(to + taken + 4, high);
    }
    return taken;
}

/* Append points to a scan's, without those that are NaN or too high or low. */
EIGHT_WIDE static void append_eight(Scan *scan, const float *x, const float *y, const float *z, int count) {
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
        const __m256i to = lanes_of(keep);
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

WIDEST static void to_seconds(double *times, int count, double offset, double unit) {
    for (int i = 0; i < count; i++) times[i] = (times[i] - offset) * unit;
}

/* Move points that have been read with their times. */
static void move_filled(Motion *motion, Moved *block, int count) {
    to_seconds(block->times, count, motion->offset, motion->unit);
    /* Moved as well, up to eight at a time. */
    for (int i = count; i < count + 8; i++) block->x[i] = block->y[i] = block->z[i] = 0, block->times[i] = 0;
    move_block(motion, block, count);
}

/* Read points of one row, and move them. */
static void move_points(Motion *motion, const Axis axis[3], const int common, Py_ssize_t row, Py_ssize_t column, int count,
                        Moved *block) {
    const char *from[3];
    float *to[3] = {block->x, block->y, block->z};
    for (int k = 0; k < 3; k++) from[k] = axis[k].data + row * axis[k].row_step + column * axis[k].step;
    int taken = 0;
#ifdef EIGHT
    if (eight_at_once && common == FLOATS && are_packed(axis))
        taken = read_eight(from[0], axis[0].step, count, block->x, block->y, block->z);
#endif
    for (int k = 0; k < 3; k++)
        if (common == FLOATS)
            for (int i = taken; i < count; i++) to[k][i] = read_float(from[k] + i * axis[k].step);
        else
            for (int i = taken; i < count; i++) to[k][i] = (float)read_any(from[k] + i * axis[k].step, &axis[k]);
    const Axis *field = &motion->times;
    const char *times = field->data + row * field->row_step + column * field->step;
    int timed = 0;
#ifdef EIGHT
    if (eight_at_once) timed = read_eight_values(field, times, count, block->times);
#endif
    read_values(field, times + timed * field->step, count - timed, block->times + timed);
    move_filled(motion, block, count);
}

/* Points of a row between two decisions whether many of them are too high or too low. */
enum { STRETCH = 8 * BLOCK };

#ifdef EIGHT
/* Move the points that were chosen of a row whose times begin here, and project them. */
static void move_chosen(Scan *scan, Motion *motion, Moved *block, const char *times) {
    const Axis *field = &motion->times;
    const Py_ssize_t step = field->step;
    const int count = block->filled;
    if (field->kind == 'f' && field->size == 8 && !field->swapped)
        for (int i = 0; i < count; i++) block->times[i] = read_double(times + block->number[i] * step);
    else if (field->swapped || field->size != 4 || field->kind == 'i')
        for (int i = 0; i < count; i++) block->times[i] = read_any(times + block->number[i] * step, field);
    else if (field->kind == 'f')
        for (int i = 0; i < count; i++) block->times[i] = read_float(times + block->number[i] * step);
    else
        for (int i = 0; i < count; i++) block->times[i] = read_unsigned(times + block->number[i] * step);
    move_filled(motion, block, count);
    append_eight(scan, block->to_x, block->to_y, block->to_z, count);
    block->filled = 0;
}

/* Project points of one row, eight at a time: a stretch of it, and as long as what is read of them stays in front of the
   last one; returns how many. Those that are too high or too low wherever the sensor was are not moved. */
EIGHT_WIDE static Py_ssize_t load_moving_eight(Scan *scan, Motion *motion, const char *from, Py_ssize_t step,
                                               const char *times, Py_ssize_t count, Moved *block) {
    const __m256 lowest = _mm256_set1_ps((float)scan->rule.lowest), highest = _mm256_set1_ps((float)scan->rule.highest);
    const __m256 absolute = _mm256_castsi256_ps(_mm256_set1_epi32(0x7fffffff)), tame = _mm256_set1_ps(TAME);
    const __m256 slope = _mm256_set1_ps(motion->slope), level = _mm256_set1_ps(motion->level);
    const __m256i lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    Py_ssize_t taken = 0;
    int64_t nans = 0, levels = 0;
    block->filled = 0;
    for (; taken + 8 < count && taken < STRETCH; taken += 8, from += 8 * step) {
        __m256 x, y, z;
        prefetch_points(from, step);
        load_points(from, step, &x, &y, &z);
        const __m256 nan = _mm256_or_ps(_mm256_cmp_ps(x, y, _CMP_UNORD_Q), _mm256_cmp_ps(z, z, _CMP_UNORD_Q));
        const __m256 size = _mm256_add_ps(_mm256_and_ps(x, absolute), _mm256_add_ps(_mm256_and_ps(y, absolute), _mm256_and_ps(z, absolute)));
        const __m256 about = turn_eight(x, y, z, motion->row, motion->row + 3);
        const __m256 error = _mm256_add_ps(_mm256_mul_ps(size, slope), level);
        const __m256 above = _mm256_cmp_ps(_mm256_sub_ps(about, error), highest, _CMP_GT_OQ);
        const __m256 below = _mm256_cmp_ps(_mm256_add_ps(about, error), lowest, _CMP_LT_OQ);
        const __m256 away = _mm256_and_ps(_mm256_or_ps(above, below), _mm256_cmp_ps(size, tame, _CMP_LE_OQ));
        const int gone = _mm256_movemask_ps(_mm256_or_ps(nan, away)), keep = gone ^ 255;
        if (gone) {
            const int unknown = __builtin_popcount((unsigned)_mm256_movemask_ps(nan));
            nans += unknown;
            levels += __builtin_popcount((unsigned)gone) - unknown;
            if (!keep) continue;
        }
        if (block->filled > BLOCK - 8) move_chosen(scan, motion, block, times);
        const int filled = block->filled;
        const __m256i to = lanes_of(keep), number = _mm256_add_epi32(lanes, _mm256_set1_epi32((int32_t)taken));
        _mm256_storeu_ps(block->x + filled, _mm256_permutevar8x32_ps(x, to));
        _mm256_storeu_ps(block->y + filled, _mm256_permutevar8x32_ps(y, to));
        _mm256_storeu_ps(block->z + filled, _mm256_permutevar8x32_ps(z, to));
        _mm256_storeu_si256((__m256i *)(block->number + filled), _mm256_permutevar8x32_epi32(number, to));
        block->filled += __builtin_popcount((unsigned)keep);
    }
    if (block->filled) move_chosen(scan, motion, block, times);
    scan->nan += nans;
    scan->height += levels;
    return taken;
}
#endif

/* Whether points that are too high or too low can be told before they are moved: 1, else 0. */
static int can_choose(const Scan *scan, const Cloud *cloud, const Motion *motion) {
#ifdef EIGHT
    return eight_at_once && in_common(cloud->axis) == FLOATS && scan->smallest && motion->timed && motion->whole &&
           are_packed(cloud->axis);
#else
    (void)scan, (void)cloud, (void)motion;
    return 0;
#endif
}

void load_moving(Scan *scan, const Cloud *cloud, Motion *motion) {
    const int common = in_common(cloud->axis);
    Moved block;
    motion->lowest = (float)scan->rule.lowest;
    motion->highest = (float)scan->rule.highest;
    const Axis *axis = cloud->axis, *field = &motion->times;
    Py_ssize_t rows = cloud->rows, columns = cloud->columns;
    int follow = is_one_row(field, columns);
    for (int k = 0; k < 3; k++) follow &= is_one_row(&axis[k], columns);
    if (follow) columns *= rows, rows = 1;
    int choosing = can_choose(scan, cloud, motion);
    for (Py_ssize_t row = 0; row < rows; row++)
        for (Py_ssize_t column = 0, taken; column < columns; column += taken) {
            const Py_ssize_t left = columns - column;
            const int64_t rejected = scan->height;
            taken = 0;
#ifdef EIGHT
            if (choosing > 0) {
                const char *from = axis[0].data + row * axis[0].row_step + column * axis[0].step;
                const char *times = field->data + row * field->row_step + column * field->step;
                taken = load_moving_eight(scan, motion, from, axis[0].step, times, left, &block);
            }
#endif
            for (; taken < left && taken < STRETCH;) {
                const int count = left - taken < BLOCK ? (int)(left - taken) : BLOCK;
                move_points(motion, axis, common, row, column + taken, count, &block);
                append(scan, block.to_x, block.to_y, block.to_z, (int64_t)row * columns + column + taken, count);
                taken += count;
            }
            /* Choosing points takes time, too. */
            if (choosing) choosing = 4 * (scan->height - rejected) > taken ? 1 : -1;
        }
    if (scan->filled) project_block(scan);
    /* They have no coordinates any more, and were taken for points without. */
    scan->nan -= motion->untimed + motion->nowhere;
}

void deskew_cloud(const Cloud *cloud, Motion *motion, float *out) {
    const int common = in_common(cloud->axis);
    Moved block;
    motion->lowest = -INFINITY;
    motion->highest = INFINITY;
    for (Py_ssize_t row = 0; row < cloud->rows; row++)
        for (Py_ssize_t column = 0; column < cloud->columns; column += BLOCK) {
            const int count = cloud->columns - column < BLOCK ? (int)(cloud->columns - column) : BLOCK;
            move_points(motion, cloud->axis, common, row, column, count, &block);
            for (int i = 0; i < count; i++, out += 3) {
                out[0] = block.to_x[i];
                out[1] = block.to_y[i];
                out[2] = block.to_z[i];
            }
        }
}
