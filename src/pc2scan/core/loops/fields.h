/* Values of points: any of PointField's datatypes, strided, unaligned and in either byte order. */

#ifndef PC2SCAN_FIELDS_H
#define PC2SCAN_FIELDS_H

#include "portable.h"

/* One coordinate of a cloud: rows of columns, strided and unaligned, of any of PointField's datatypes. */
typedef struct {
    const char *data;
    Py_ssize_t row_step, step;
    char kind; /* NumPy's code: i, u or f */
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

static inline uint32_t read_unsigned(const char *from) {
    uint32_t value;
    memcpy(&value, from, sizeof value);
    return value;
}

/* Read a value of any type, as float64. */
static inline double read_any(const char *from, const Axis *axis) {
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

/* The type that the three axes share. */
enum { FLOATS, DOUBLES, MIXED };

static inline double read_as(const char *from, const Axis *axis, const int common) {
    return common == FLOATS ? read_float(from) : common == DOUBLES ? read_double(from) : read_any(from, axis);
}

/* Whether there are no gaps between rows. They are then read as one row, so that only its last points are read one
   at a time. */
static inline int is_one_row(const Axis *axis, Py_ssize_t columns) { return axis->row_step == columns * axis->step; }

/* Whether x, y and z are float32 that follow each other, with four bytes of the same or the next point behind them. */
static inline int are_packed(const Axis axis[3]) {
    return axis[1].data - axis[0].data == 4 && axis[2].data - axis[0].data == 8 && axis[0].step >= 12 &&
           axis[1].step == axis[0].step && axis[2].step == axis[0].step && axis[1].row_step == axis[0].row_step &&
           axis[2].row_step == axis[0].row_step;
}

static inline int in_common(const Axis axis[3]) {
    int floats = 1, doubles = 1;
    for (int i = 0; i < 3; i++) {
        floats &= axis[i].kind == 'f' && axis[i].size == 4 && !axis[i].swapped;
        doubles &= axis[i].kind == 'f' && axis[i].size == 8 && !axis[i].swapped;
    }
    return floats ? FLOATS : doubles ? DOUBLES : MIXED;
}

/* Read `count` values of any type, as float64. */
static inline void read_values(const Axis *axis, const char *from, int count, double *to) {
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

#endif
