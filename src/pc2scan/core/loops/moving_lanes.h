/* The loops over points at their own times that do LANES points at once. moving.c includes this file twice: for
   eight and for sixteen lanes. Each lane rounds like the loops over single points, so the number of lanes changes no
   bit. */

#if LANES == 8
#define OF_LANES(name) name##_eight
#define LOAD_POINTS load_eight_points
#define LOOP EIGHT_WIDE static
#define INLINED_LOOP EIGHT_INLINED
#define FLOATS_TYPE __m256
#define DOUBLES_TYPE __m256d
#define HALF_TYPE __m128
#define PS(operation) _mm256_##operation##_ps
#define PD(operation) _mm256_##operation##_pd
#define LOWER(floats) _mm256_castps256_ps128(floats)
#define UPPER(floats) _mm256_extractf128_ps(floats, 1)
#define JOINED(low, high) _mm256_set_m128(high, low)
#define WIDENED(half) _mm256_cvtps_pd(half)
#define NARROWED(doubles) _mm256_cvtpd_ps(doubles)
#define ABSOLUTE(floats) _mm256_andnot_ps(_mm256_set1_ps(-0.0f), floats)
#define WHERE_PS(one, other, how) ((unsigned)_mm256_movemask_ps(_mm256_cmp_ps(one, other, how)))
#define WHERE_PD(one, other, how) ((unsigned)_mm256_movemask_pd(_mm256_cmp_pd(one, other, how)))
#else
#define OF_LANES(name) name##_sixteen
#define LOAD_POINTS load_sixteen_points
#define LOOP SIXTEEN_WIDE static
#define INLINED_LOOP SIXTEEN_INLINED
#define FLOATS_TYPE __m512
#define DOUBLES_TYPE __m512d
#define HALF_TYPE __m256
#define PS(operation) _mm512_##operation##_ps
#define PD(operation) _mm512_##operation##_pd
#define LOWER(floats) _mm512_castps512_ps256(floats)
#define UPPER(floats) _mm512_extractf32x8_ps(floats, 1)
#define JOINED(low, high) _mm512_insertf32x8(_mm512_castps256_ps512(low), high, 1)
#define WIDENED(half) _mm512_cvtps_pd(half)
#define NARROWED(doubles) _mm512_cvtpd_ps(doubles)
#define ABSOLUTE(floats) _mm512_abs_ps(floats)
#define WHERE_PS(one, other, how) ((unsigned)_mm512_cmp_ps_mask(one, other, how))
#define WHERE_PD(one, other, how) ((unsigned)_mm512_cmp_pd_mask(one, other, how))
#endif

#define ALL_LANES ((1u << LANES) - 1)

/* Return one coordinate of points, transformed in float64. */
INLINED_LOOP DOUBLES_TYPE OF_LANES(row_of)(const double *row, const double *offset, DOUBLES_TYPE x, DOUBLES_TYPE y,
                                           DOUBLES_TYPE z) {
    DOUBLES_TYPE sum = PD(mul)(PD(set1)(row[0]), x);
    sum = PD(add)(sum, PD(mul)(PD(set1)(row[1]), y));
    sum = PD(add)(sum, PD(mul)(PD(set1)(row[2]), z));
    return PD(add)(sum, PD(set1)(*offset));
}

/* Do the same as move_one. */
INLINED_LOOP FLOATS_TYPE OF_LANES(move)(const Part *part, int axis, FLOATS_TYPE x, FLOATS_TYPE y, FLOATS_TYPE z,
                                        FLOATS_TYPE s, const DOUBLES_TYPE wide[6]) {
    const FLOATS_TYPE along = OF_LANES(turn)(x, y, z, part->rate + 3 * axis, part->rate + 9 + axis);
    const FLOATS_TYPE aside = OF_LANES(turn)(x, y, z, part->bend + 3 * axis, part->bend + 9 + axis);
    const FLOATS_TYPE away = PS(mul)(s, PS(add)(along, PS(mul)(s, aside)));
    const double *row = part->start + 3 * axis, *offset = part->start + 9 + axis;
    const DOUBLES_TYPE low = OF_LANES(row_of)(row, offset, wide[0], wide[1], wide[2]);
    const DOUBLES_TYPE high = OF_LANES(row_of)(row, offset, wide[3], wide[4], wide[5]);
    return JOINED(NARROWED(PD(add)(low, WIDENED(LOWER(away)))), NARROWED(PD(add)(high, WIDENED(UPPER(away)))));
}

/* Return times as shares of a part, from 0 to 1. */
INLINED_LOOP HALF_TYPE OF_LANES(share)(DOUBLES_TYPE times, DOUBLES_TYPE begin, DOUBLES_TYPE scale) {
    return NARROWED(PD(mul)(PD(sub)(times, begin), scale));
}

/* Do the same as move_run. What is written behind the last point is overwritten later. If all lanes are too high or
   too low, their x and y are not needed: they are set to 0, unless they may be NaN, because NaN is counted before
   height. */
LOOP int OF_LANES(move_run)(const Part *part, Moved *block, int from, int end, float lowest, float highest) {
    const DOUBLES_TYPE begin = PD(set1)(part->begin), scale = PD(set1)(part->scale);
    const DOUBLES_TYPE after = PD(set1)(part->after), close = PD(set1)(part->end);
    const FLOATS_TYPE least = PS(set1)(lowest), most = PS(set1)(highest), tame = PS(set1)(TAME);
    for (int i = from; i < end; i += LANES) {
        const DOUBLES_TYPE first = PD(loadu)(block->times + i), second = PD(loadu)(block->times + i + LANES / 2);
        const unsigned own_first = WHERE_PD(first, after, _CMP_GT_OQ) & WHERE_PD(first, close, _CMP_LE_OQ);
        const unsigned own_second = WHERE_PD(second, after, _CMP_GT_OQ) & WHERE_PD(second, close, _CMP_LE_OQ);
        /* The very first point belongs to this part. */
        const unsigned own = own_first | own_second << LANES / 2 | (i == from);
        const FLOATS_TYPE s = JOINED(OF_LANES(share)(first, begin, scale), OF_LANES(share)(second, begin, scale));
        const FLOATS_TYPE x = PS(loadu)(block->x + i), y = PS(loadu)(block->y + i), z = PS(loadu)(block->z + i);
        const DOUBLES_TYPE wide[6] = {WIDENED(LOWER(x)), WIDENED(LOWER(y)), WIDENED(LOWER(z)),
                                      WIDENED(UPPER(x)), WIDENED(UPPER(y)), WIDENED(UPPER(z))};
        const FLOATS_TYPE to_z = OF_LANES(move)(part, 2, x, y, z, s, wide);
        PS(storeu)(block->to_z + i, to_z);
        const FLOATS_TYPE sum = PS(add)(ABSOLUTE(x), PS(add)(ABSOLUTE(y), ABSOLUTE(z)));
        const unsigned beside = WHERE_PS(to_z, least, _CMP_LT_OQ) | WHERE_PS(to_z, most, _CMP_GT_OQ);
        if (part->tame && (beside & WHERE_PS(sum, tame, _CMP_LE_OQ)) == ALL_LANES) {
            PS(storeu)(block->to_x + i, PS(setzero)());
            PS(storeu)(block->to_y + i, PS(setzero)());
        } else {
            PS(storeu)(block->to_x + i, OF_LANES(move)(part, 0, x, y, z, s, wide));
            PS(storeu)(block->to_y + i, OF_LANES(move)(part, 1, x, y, z, s, wide));
        }
        if (own != ALL_LANES) return i + __builtin_ctz(~own) < end ? i + __builtin_ctz(~own) : end;
    }
    return end;
}

/* Project a stretch of points of one row, without reading beyond its last one. Returns how many were projected.
   Points that are too high or too low at any time of the cloud are not moved. */
LOOP Py_ssize_t OF_LANES(load_moving)(Scan *scan, Motion *motion, const char *from, Py_ssize_t step, const char *times,
                                      Py_ssize_t count, Moved *block) {
    const FLOATS_TYPE lowest = PS(set1)((float)scan->rule.lowest), highest = PS(set1)((float)scan->rule.highest);
    const FLOATS_TYPE slope = PS(set1)(motion->slope), level = PS(set1)(motion->level), tame = PS(set1)(TAME);
    Py_ssize_t taken = 0;
    int64_t nans = 0, levels = 0;
    block->filled = 0;
    for (; taken + LANES < count && taken < STRETCH; taken += LANES, from += LANES * step) {
        FLOATS_TYPE x, y, z;
        LOAD_POINTS(from, step, &x, &y, &z);
        const unsigned nan = WHERE_PS(x, y, _CMP_UNORD_Q) | WHERE_PS(z, z, _CMP_UNORD_Q);
        const FLOATS_TYPE size = PS(add)(ABSOLUTE(x), PS(add)(ABSOLUTE(y), ABSOLUTE(z)));
        const FLOATS_TYPE about = OF_LANES(turn)(x, y, z, motion->row, motion->row + 3);
        const FLOATS_TYPE error = PS(add)(PS(mul)(size, slope), level);
        const unsigned above = WHERE_PS(PS(sub)(about, error), highest, _CMP_GT_OQ);
        const unsigned below = WHERE_PS(PS(add)(about, error), lowest, _CMP_LT_OQ);
        const unsigned gone = nan | ((above | below) & WHERE_PS(size, tame, _CMP_LE_OQ));
        if (gone) {
            const int unknown = __builtin_popcount(nan);
            nans += unknown;
            levels += __builtin_popcount(gone) - unknown;
            if (gone == ALL_LANES) continue;
        }
        if (block->filled > BLOCK - LANES) move_chosen(scan, motion, block, times);
        OF_LANES(keep)(block, x, y, z, (int32_t)taken, gone ^ ALL_LANES);
    }
    if (block->filled) move_chosen(scan, motion, block, times);
    scan->nan += nans;
    scan->height += levels;
    return taken;
}

#undef LANES
#undef OF_LANES
#undef LOAD_POINTS
#undef LOOP
#undef INLINED_LOOP
#undef FLOATS_TYPE
#undef DOUBLES_TYPE
#undef HALF_TYPE
#undef PS
#undef PD
#undef LOWER
#undef UPPER
#undef JOINED
#undef WIDENED
#undef NARROWED
#undef ABSOLUTE
#undef WHERE_PS
#undef WHERE_PD
#undef ALL_LANES
