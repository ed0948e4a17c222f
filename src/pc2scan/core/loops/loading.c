/* Project points that share one transform: read and transform them in one loop, or eight at a time, then project
   them block by block. Transforms are in float32; every product and every sum is rounded, from left to right, as in
   tf2_sensor_msgs. */

#include "scan.h"

#ifdef EIGHT
/* Take points of one row, eight at a time, without reading beyond the last one. x, y and z must be consecutive
   float32, with four bytes behind them. Returns how many points were taken. Inlined, so that compilers generate a
   loop of its own for points that need no transform. */
EIGHT_INLINED Py_ssize_t load_eight(Scan *scan, const char *from, Py_ssize_t step, Py_ssize_t count,
                                    const float *transform) {
    const __m256 lowest = _mm256_set1_ps((float)scan->rule.lowest), highest = _mm256_set1_ps((float)scan->rule.highest);
    Py_ssize_t taken = 0;
    int64_t nans = 0, kept = 0;
    for (; taken + 8 < count; taken += 8, from += 8 * step) {
        __m256 x, y, z;
        load_eight_points(from, step, &x, &y, &z);
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
        const __m256i to = lanes_of(keep);
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

EIGHT_WIDE static Py_ssize_t load_eight_untransformed(Scan *scan, const char *from, Py_ssize_t step, Py_ssize_t count) {
    return load_eight(scan, from, step, count, NULL);
}

EIGHT_WIDE static Py_ssize_t load_eight_transformed(Scan *scan, const char *from, Py_ssize_t step, Py_ssize_t count,
                                                    const float *transform) {
    return load_eight(scan, from, step, count, transform);
}
#endif

/* Take points of one row. Inlined, so that compilers generate a loop for each type and for points that need no
   transform. */
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

void load_rows(Scan *scan, const Axis axis[3], Py_ssize_t rows, Py_ssize_t columns, const float *transform) {
    const int common = in_common(axis);
    int follow = 1;
    for (int k = 0; k < 3; k++) follow &= is_one_row(&axis[k], columns);
    if (follow) columns *= rows, rows = 1;
    for (Py_ssize_t row = 0; row < rows; row++) {
        const char *x = axis[0].data + row * axis[0].row_step;
        const char *y = axis[1].data + row * axis[1].row_step;
        const char *z = axis[2].data + row * axis[2].row_step;
        int64_t number = (int64_t)row * columns;
        Py_ssize_t taken = 0;
#ifdef EIGHT
        /* Behind a point of twelve bytes, the bytes of the next one are read. */
        if (eight_at_once && common == FLOATS && scan->smallest && are_packed(axis))
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

