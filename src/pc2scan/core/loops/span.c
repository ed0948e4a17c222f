/* The minimum and the maximum of a field: the time in which the points of a cloud were measured. */

#include "arrays.h"
#include "functions.h"

/* Only points whose x is not NaN count. Values that are NaN or infinite are unknown. */
typedef struct {
    double low, high;
    int64_t measured, unknown;
} Span;

static void widen(Span *span, double low, double high) {
    span->low = low < span->low ? low : span->low;
    span->high = high > span->high ? high : span->high;
}

/* Take points of one row, of any types. */
static void widen_by_each(Span *span, const Axis *axis, const char *x, const Axis *field, const char *values,
                          Py_ssize_t count) {
    for (Py_ssize_t i = 0; i < count; i++, x += axis->step, values += field->step) {
        const double own = read_any(x, axis), value = read_any(values, field);
        if (own != own) continue;
        span->measured++;
        if (fabs(value) <= DBL_MAX) widen(span, value, value);
        else span->unknown++;
    }
}

#ifdef EIGHT
/* Take points of one row, eight at a time, without reading beyond the last one. Returns how many were taken.
   Integers are compared as signed ones: the highest bit of unsigned ones is inverted first. */
EIGHT_WIDE static Py_ssize_t widen_by_integers(Span *span, const char *x, Py_ssize_t dx, const char *values, Py_ssize_t dv,
                                               Py_ssize_t count, int is_signed) {
    const __m256i turn = _mm256_set1_epi32(is_signed ? 0 : INT32_MIN);
    __m256i low = _mm256_set1_epi32(INT32_MAX), high = _mm256_set1_epi32(INT32_MIN);
    Py_ssize_t taken = 0;
    int64_t measured = 0;
    for (; taken + 8 < count; taken += 8, x += 8 * dx, values += 8 * dv) {
        prefetch_points(x, dx);
        const __m256 own = eight_singles(x, dx), there = _mm256_cmp_ps(own, own, _CMP_ORD_Q);
        const __m256i value = _mm256_xor_si256(_mm256_castps_si256(eight_singles(values, dv)), turn);
        const __m256i known = _mm256_castps_si256(there);
        low = _mm256_min_epi32(low, _mm256_blendv_epi8(low, value, known));
        high = _mm256_max_epi32(high, _mm256_blendv_epi8(high, value, known));
        measured += __builtin_popcount((unsigned)_mm256_movemask_ps(there));
    }
    int32_t lows[8], highs[8];
    _mm256_storeu_si256((__m256i *)lows, _mm256_xor_si256(low, turn));
    _mm256_storeu_si256((__m256i *)highs, _mm256_xor_si256(high, turn));
    for (int k = 0; k < 8 && measured; k++)
        /* A lane without a point still has its initial values, of which the minimum is above the maximum. */
        if (is_signed ? lows[k] <= highs[k] : (uint32_t)lows[k] <= (uint32_t)highs[k])
            widen(span, is_signed ? lows[k] : (double)(uint32_t)lows[k], is_signed ? highs[k] : (double)(uint32_t)highs[k]);
    span->measured += measured;
    return taken;
}

EIGHT_WIDE static Py_ssize_t widen_by_floats(Span *span, const char *x, Py_ssize_t dx, const char *values, Py_ssize_t dv,
                                             Py_ssize_t count) {
    __m256 low = _mm256_set1_ps(INFINITY), high = _mm256_set1_ps(-INFINITY);
    const __m256 largest = _mm256_set1_ps(FLT_MAX), sign = _mm256_set1_ps(-0.0f);
    Py_ssize_t taken = 0;
    int64_t measured = 0, known = 0;
    for (; taken + 8 < count; taken += 8, x += 8 * dx, values += 8 * dv) {
        prefetch_points(x, dx);
        const __m256 own = eight_singles(x, dx), there = _mm256_cmp_ps(own, own, _CMP_ORD_Q);
        const __m256 value = eight_singles(values, dv);
        const __m256 finite = _mm256_and_ps(there, _mm256_cmp_ps(_mm256_andnot_ps(sign, value), largest, _CMP_LE_OQ));
        low = _mm256_min_ps(low, _mm256_blendv_ps(low, value, finite));
        high = _mm256_max_ps(high, _mm256_blendv_ps(high, value, finite));
        measured += __builtin_popcount((unsigned)_mm256_movemask_ps(there));
        known += __builtin_popcount((unsigned)_mm256_movemask_ps(finite));
    }
    float lows[8], highs[8];
    _mm256_storeu_ps(lows, low);
    _mm256_storeu_ps(highs, high);
    for (int k = 0; k < 8; k++) widen(span, lows[k], highs[k]);
    span->measured += measured;
    span->unknown += measured - known;
    return taken;
}

EIGHT_WIDE static Py_ssize_t widen_by_doubles(Span *span, const char *x, Py_ssize_t dx, const char *values, Py_ssize_t dv,
                                              Py_ssize_t count) {
    __m256d low = _mm256_set1_pd(INFINITY), high = _mm256_set1_pd(-INFINITY);
    const __m256d largest = _mm256_set1_pd(DBL_MAX), sign = _mm256_set1_pd(-0.0);
    Py_ssize_t taken = 0;
    int64_t measured = 0, known = 0;
    for (; taken + 8 < count; taken += 8, x += 8 * dx) {
        prefetch_points(x, dx);
        const __m256 own = eight_singles(x, dx);
        const __m256i there = _mm256_castps_si256(_mm256_cmp_ps(own, own, _CMP_ORD_Q));
        measured += __builtin_popcount((unsigned)_mm256_movemask_ps(_mm256_castsi256_ps(there)));
        const __m128i halves[2] = {_mm256_castsi256_si128(there), _mm256_extracti128_si256(there, 1)};
        for (int half = 0; half < 2; half++, values += 4 * dv) {
            const __m256d value = four_doubles(values, dv);
            const __m256d small = _mm256_cmp_pd(_mm256_andnot_pd(sign, value), largest, _CMP_LE_OQ);
            const __m256d finite = _mm256_and_pd(_mm256_castsi256_pd(_mm256_cvtepi32_epi64(halves[half])), small);
            low = _mm256_min_pd(low, _mm256_blendv_pd(low, value, finite));
            high = _mm256_max_pd(high, _mm256_blendv_pd(high, value, finite));
            known += __builtin_popcount((unsigned)_mm256_movemask_pd(finite));
        }
    }
    double lows[4], highs[4];
    _mm256_storeu_pd(lows, low);
    _mm256_storeu_pd(highs, high);
    for (int k = 0; k < 4; k++) widen(span, lows[k], highs[k]);
    span->measured += measured;
    span->unknown += measured - known;
    return taken;
}

static Py_ssize_t widen_by_eight(Span *span, const Axis *axis, const char *x, const Axis *field, const char *values,
                                 Py_ssize_t count) {
    const Py_ssize_t dx = axis->step, dv = field->step;
    if (!eight_at_once || axis->kind != 'f' || axis->size != 4 || axis->swapped || field->swapped) return 0;
    if (dx != 4 && dx < 12) return 0;
    if (field->kind == 'f' && field->size == 8) return dv >= 8 ? widen_by_doubles(span, x, dx, values, dv, count) : 0;
    if (field->size != 4 || (dv != 4 && dv < 12)) return 0;
    if (field->kind == 'f') return widen_by_floats(span, x, dx, values, dv, count);
    return widen_by_integers(span, x, dx, values, dv, count, field->kind == 'i');
}
#endif

static Span span_of(const Cloud *cloud, const Axis *field) {
    Span span = {INFINITY, -INFINITY, 0, 0};
    const Axis *axis = &cloud->axis[0];
    Py_ssize_t rows = cloud->rows, columns = cloud->columns;
    if (is_one_row(axis, columns) && is_one_row(field, columns)) columns *= rows, rows = 1;
    for (Py_ssize_t row = 0; row < rows; row++) {
        const char *x = axis->data + row * axis->row_step, *values = field->data + row * field->row_step;
        Py_ssize_t taken = 0;
#ifdef EIGHT
        taken = widen_by_eight(&span, axis, x, field, values, columns);
#endif
        widen_by_each(&span, axis, x + taken * axis->step, field, values + taken * field->step, columns - taken);
    }
    return span;
}

PyObject *span(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *x_of, *values_of;
    if (!PyArg_ParseTuple(args, "OO", &x_of, &values_of)) return NULL;
    PyObject *xyz[3] = {x_of, x_of, x_of}, *result = NULL;
    Cloud cloud;
    if (take_coordinates(&cloud, xyz) < 0) return NULL;
    Py_buffer view;
    Axis field;
    if (take_field(&cloud, values_of, &view, &field) == 0) {
        PyThreadState *state = let_others(cloud.rows * cloud.columns);
        const Span found = span_of(&cloud, &field);
        if (state) PyEval_RestoreThread(state);
        result = Py_BuildValue("(ddLL)", found.low, found.high, (long long)found.measured, (long long)found.unknown);
        PyBuffer_Release(&view);
    }
    release_cloud(&cloud);
    return result;
}
