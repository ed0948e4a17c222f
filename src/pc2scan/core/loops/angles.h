/* The arctangents of many points, with the results of fdlibm.py and NumPy. */

#ifndef PC2SCAN_ANGLES_H
#define PC2SCAN_ANGLES_H

#include "portable.h"

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
        /* NaN, the result of 0 / 0 and inf / inf, is unsure as well. */
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

/* fdlibm's argument reduction, for quotients t of at least `from`: atan(t) = high + low + atan((a * t + b) / (c * t
   + d)). */
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
        /* On the axes and at infinity, the quotient does not determine the angle. */
        const float along = back < 0 ? pi : 0, diagonal = back < 0 ? 3 * quarter_pi : quarter_pi;
        turn = (across == 0) | (up == INFINITY) ? half_pi : turn;
        turn = (across == INFINITY) & (up == INFINITY) ? diagonal : turn;
        turn = up == 0 ? along : turn;
        turn = (across != across) | (up != up) ? across + up : turn;
        angle[i] = copysignf(turn, y[i]);
    }
}

#endif
