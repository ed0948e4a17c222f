/* Project points at their own times: read each point, transform it by the part of the motion that contains its time,
   and project it. */

#include "moving.h"

/* Fit a polynomial to three transforms: at the beginning, in the middle, and at the end of a part. */
static void fit_part(Part *part, double begin, double end, const double *first) {
    const double *middle = first + 12, *last = first + 24;
    part->begin = part->after = begin;
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

/* Compute the row for z and its errors. A polynomial differs from its start by at most the sum of its other
   coefficients. */
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
        /* The rounding errors of float32, here and where points are moved, are far below four millionths of the
           summands. */
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
    motion->parts[0].after = nextafter(ends[0], -INFINITY);
    bound_z(motion);
    return 0;
}

void release_motion(Motion *motion) {
    PyMem_Free(motion->parts);
    if (motion->held > 2) PyBuffer_Release(&motion->rows);
    if (motion->held > 1) PyBuffer_Release(&motion->nodes);
    if (motion->held > 0) PyBuffer_Release(&motion->times_of);
}

/* Return the part that contains a time; -1 if there is none, or the time is NaN. */
static Py_ssize_t part_at(const Motion *motion, double time) {
    const Part *parts = motion->parts;
    Py_ssize_t part = motion->part, last = motion->count - 1;
    if (!(time >= parts[0].begin && time <= parts[last].end)) return -1;
    if (!(time > parts[part].after && time <= parts[part].end)) {
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
    /* The first transform after a gap is valid at its own time. */
    if (!parts[part].known && part < last && time == parts[part].end) part++;
    return part;
}

/* Return one coordinate of a moved point. Its row starts at 3 * axis, its translation is at 9 + axis. */
static inline float move_one(const Part *part, int axis, float x, float y, float z, float s) {
    const double *start = part->start + 3 * axis;
    const float *rate = part->rate + 3 * axis, *bend = part->bend + 3 * axis;
    const float along = rate[0] * x + rate[1] * y + rate[2] * z + part->rate[9 + axis];
    const float aside = bend[0] * x + bend[1] * y + bend[2] * z + part->bend[9 + axis];
    const double place = start[0] * x + start[1] * y + start[2] * z + part->start[9 + axis];
    return (float)(place + s * (along + s * aside));
}

/* Transform points until one belongs to another part. Returns the index of that one. */
static int move_run(const Part *part, Moved *block, int from, int end) {
    int i = from;
    for (; i < end && (i == from || (block->times[i] > part->after && block->times[i] <= part->end)); i++) {
        const float s = (float)((block->times[i] - part->begin) * part->scale);
        const float x = block->x[i], y = block->y[i], z = block->z[i];
        block->to_x[i] = move_one(part, 0, x, y, z, s);
        block->to_y[i] = move_one(part, 1, x, y, z, s);
        block->to_z[i] = move_one(part, 2, x, y, z, s);
    }
    return i;
}

/* The number of points of a row after which it is decided anew whether to drop points before they are moved. */
enum { STRETCH = 8 * BLOCK };

#ifdef EIGHT
static void move_chosen(Scan *scan, Motion *motion, Moved *block, const char *times);

/* Append the points of a set of lanes to the chosen points. `number` is the number of the first lane's point. */
EIGHT_INLINED void keep_eight(Moved *block, __m256 x, __m256 y, __m256 z, int32_t number, unsigned keep) {
    const int filled = block->filled;
    const __m256i to = lanes_of((int)keep), lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    const __m256i numbers = _mm256_add_epi32(lanes, _mm256_set1_epi32(number));
    _mm256_storeu_ps(block->x + filled, _mm256_permutevar8x32_ps(x, to));
    _mm256_storeu_ps(block->y + filled, _mm256_permutevar8x32_ps(y, to));
    _mm256_storeu_ps(block->z + filled, _mm256_permutevar8x32_ps(z, to));
    _mm256_storeu_si256((__m256i *)(block->number + filled), _mm256_permutevar8x32_epi32(numbers, to));
    block->filled += __builtin_popcount(keep);
}

SIXTEEN_INLINED void keep_sixteen(Moved *block, __m512 x, __m512 y, __m512 z, int32_t number, unsigned keep) {
    const int filled = block->filled;
    const __mmask16 set = (__mmask16)keep;
    const __m512i lanes = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    const __m512i numbers = _mm512_add_epi32(lanes, _mm512_set1_epi32(number));
    _mm512_storeu_ps(block->x + filled, _mm512_maskz_compress_ps(set, x));
    _mm512_storeu_ps(block->y + filled, _mm512_maskz_compress_ps(set, y));
    _mm512_storeu_ps(block->z + filled, _mm512_maskz_compress_ps(set, z));
    _mm512_storeu_si512(block->number + filled, _mm512_maskz_compress_epi32(set, numbers));
    block->filled += __builtin_popcount(keep);
}

#define LANES 8
#include "moving_lanes.h"
#define LANES 16
#include "moving_lanes.h"
#endif

/* Do the same as move_run, with as many lanes as the processor has. */
static int move_run_at_once(const Motion *motion, const Part *part, Moved *block, int from, int end) {
#ifdef EIGHT
    if (sixteen_at_once) return move_run_sixteen(part, block, from, end, motion->lowest, motion->highest);
    if (eight_at_once) return move_run_eight(part, block, from, end, motion->lowest, motion->highest);
#else
    (void)motion;
#endif
    return move_run(part, block, from, end);
}

static void move_block(Motion *motion, Moved *block, const int count) {
    for (int i = 0; i < count;) {
        const double time = block->times[i];
        const Py_ssize_t number = part_at(motion, time);
        if (number >= 0 && motion->parts[number].known) {
            const Part *part = &motion->parts[number];
            motion->part = number;
            i = move_run_at_once(motion, part, block, i, count);
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
/* Read points, eight at a time, without reading beyond the last one. Returns how many were read. */
EIGHT_WIDE static int read_eight(const char *from, Py_ssize_t step, int count, float *x, float *y, float *z) {
    int taken = 0;
    for (; taken + 8 < count; taken += 8, from += 8 * step) {
        __m256 px, py, pz;
        load_eight_points(from, step, &px, &py, &pz);
        _mm256_storeu_ps(x + taken, px);
        _mm256_storeu_ps(y + taken, py);
        _mm256_storeu_ps(z + taken, pz);
    }
    return taken;
}

/* Read values of four bytes, eight at a time, without reading beyond the last one. Returns how many were read. */
EIGHT_WIDE static int read_eight_values(const Axis *axis, const char *from, int count, double *to) {
    const Py_ssize_t step = axis->step;
    /* An unsigned number is the signed one with the highest bit inverted, plus 2**31. */
    const __m256i turn = _mm256_set1_epi32(axis->kind == 'u' ? INT32_MIN : 0);
    const __m256d more = _mm256_set1_pd(axis->kind == 'u' ? 0x1p31 : 0);
    int taken = 0;
    if (axis->size != 4 || axis->swapped || (step != 4 && step < 12)) return 0;
    for (; taken + 8 < count; taken += 8, from += 8 * step) {
        const __m256 eight = eight_singles(from, step);
        __m256d low = _mm256_cvtps_pd(_mm256_castps256_ps128(eight));
        __m256d high = _mm256_cvtps_pd(_mm256_extractf128_ps(eight, 1));
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

/* Append points to a scan's block, except those that are NaN, too high or too low. */
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

/* The same for any processor, and with the points' numbers if the scan gathers them. */
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

/* Move points that have been read, with their times. */
static void move_filled(Motion *motion, Moved *block, int count) {
    to_seconds(block->times, count, motion->offset, motion->unit);
    /* Loops that do several points at once also move up to 15 points behind the last one. */
    for (int i = count; i < count + 16; i++) block->x[i] = block->y[i] = block->z[i] = 0, block->times[i] = 0;
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

#ifdef EIGHT
/* Move the chosen points of a row, and project them. `times` is where the row's times begin. */
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

#endif

/* Whether points that are too high or too low can be dropped before they are moved: 1 or 0. */
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
                taken = sixteen_at_once ? load_moving_sixteen(scan, motion, from, axis[0].step, times, left, &block)
                                        : load_moving_eight(scan, motion, from, axis[0].step, times, left, &block);
            }
#endif
            for (; taken < left && taken < STRETCH;) {
                const int count = left - taken < BLOCK ? (int)(left - taken) : BLOCK;
                move_points(motion, axis, common, row, column + taken, count, &block);
                append(scan, block.to_x, block.to_y, block.to_z, (int64_t)row * columns + column + taken, count);
                taken += count;
            }
            /* Choosing points takes time as well: it is worth it if more than a quarter of them is dropped. */
            if (choosing) choosing = 4 * (scan->height - rejected) > taken ? 1 : -1;
        }
    if (scan->filled) project_block(scan);
    /* These points were made NaN above, and counted as NaN. */
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
