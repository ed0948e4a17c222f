/* Differences of compilers and processors, and the size of the blocks in which points are processed. */

#ifndef PC2SCAN_PORTABLE_H
#define PC2SCAN_PORTABLE_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(__GNUC__)
/* Only PyInit__kernel is visible outside the module: calls between its files need no table. */
#define HIDDEN __attribute__((visibility("hidden")))
#else
#define HIDDEN
#endif

#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && __GNUC__ >= 12 && !defined(__clang__)
/* Also compile the function for wider vectors. Which version runs is decided when the module is loaded. */
#define WIDEST __attribute__((target_clones("default", "arch=x86-64-v3", "arch=x86-64-v4")))
#else
#define WIDEST
#endif

#if defined(__GNUC__)
/* Inline the function into its callers, also into their versions for wider vectors. */
#define INLINED static inline __attribute__((always_inline))
#else
#define INLINED static inline
#endif

/* Points in a block, which fits into the first-level cache. Some loops write up to sixteen points behind the last one. */
enum { BLOCK = 256, PADDED = BLOCK + 16 };

#if defined(__GNUC__)
/* A cloud is larger than a core's own caches, and the processor's own prefetching ends at each page. */
#define PREFETCH(from) __builtin_prefetch((const void *)((uintptr_t)(from) + 2048))
#else
#define PREFETCH(from)
#endif

#if defined(__x86_64__) && defined(__GNUC__)
#include <immintrin.h>

/* Loops over eight points at a time. Call them only if eight_at_once is set. */
#define EIGHT
#define EIGHT_WIDE __attribute__((target("avx2,popcnt")))
#define EIGHT_INLINED __attribute__((target("avx2,popcnt"), always_inline)) static inline

/* Loops over sixteen points at a time. Call them only if sixteen_at_once is set. */
#define SIXTEEN "avx512f,avx512dq,avx512vl,avx512bw,avx2,popcnt"
#define SIXTEEN_WIDE __attribute__((target(SIXTEEN)))
#define SIXTEEN_INLINED __attribute__((target(SIXTEEN), always_inline)) static inline

/* For each set of eight lanes: the numbers of its lanes, one in each byte. */
HIDDEN extern uint64_t together[256];
HIDDEN extern int eight_at_once, sixteen_at_once;

/* Prepare these loops, which then use at most `most` lanes. Returns how many they use. */
HIDDEN int prepare_lanes(int most);

/* Return the permutation that moves the lanes of a set to the beginning. */
EIGHT_INLINED __m256i lanes_of(int set) {
    return _mm256_cvtepu8_epi32(_mm_cvtsi64_si128((long long)together[set]));
}

/* Return one coordinate of eight points, transformed by a row of the rotation and its offset. */
EIGHT_INLINED __m256 turn_eight(__m256 x, __m256 y, __m256 z, const float *row, const float *offset) {
    __m256 sum = _mm256_mul_ps(x, _mm256_broadcast_ss(row));
    sum = _mm256_add_ps(sum, _mm256_mul_ps(y, _mm256_broadcast_ss(row + 1)));
    sum = _mm256_add_ps(sum, _mm256_mul_ps(z, _mm256_broadcast_ss(row + 2)));
    return _mm256_add_ps(sum, _mm256_broadcast_ss(offset));
}

SIXTEEN_INLINED __m512 turn_sixteen(__m512 x, __m512 y, __m512 z, const float *row, const float *offset) {
    __m512 sum = _mm512_mul_ps(x, _mm512_set1_ps(row[0]));
    sum = _mm512_add_ps(sum, _mm512_mul_ps(y, _mm512_set1_ps(row[1])));
    sum = _mm512_add_ps(sum, _mm512_mul_ps(z, _mm512_set1_ps(row[2])));
    return _mm512_add_ps(sum, _mm512_set1_ps(*offset));
}

/* Prefetch points. Two points of 32 bytes share a cache line of 64. */
EIGHT_INLINED void prefetch_points(const char *from, Py_ssize_t step) {
    const Py_ssize_t lines = step < 64 ? 64 : step;
    for (Py_ssize_t line = 0; line < 8 * step; line += lines) PREFETCH(from + line);
}

EIGHT_INLINED __m256 load_two(const char *one, const char *other) {
    return _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps((const float *)one)),
                                _mm_loadu_ps((const float *)other), 1);
}

/* Load consecutive x, y and z of eight points. The four bytes behind each z are read as well. */
EIGHT_INLINED void load_eight_points(const char *from, Py_ssize_t step, __m256 *x, __m256 *y, __m256 *z) {
    prefetch_points(from, step);
    __m256 pair[4];
    for (int i = 0; i < 4; i++) pair[i] = load_two(from + i * step, from + (i + 4) * step);
    const __m256 xy = _mm256_unpacklo_ps(pair[0], pair[1]), yx = _mm256_unpacklo_ps(pair[2], pair[3]);
    const __m256 zs = _mm256_unpackhi_ps(pair[0], pair[1]), sz = _mm256_unpackhi_ps(pair[2], pair[3]);
    *x = _mm256_shuffle_ps(xy, yx, 0x44);
    *y = _mm256_shuffle_ps(xy, yx, 0xee);
    *z = _mm256_shuffle_ps(zs, sz, 0x44);
}

SIXTEEN_INLINED void load_sixteen_points(const char *from, Py_ssize_t step, __m512 *x, __m512 *y, __m512 *z) {
    __m256 low[3], high[3];
    load_eight_points(from, step, &low[0], &low[1], &low[2]);
    load_eight_points(from + 8 * step, step, &high[0], &high[1], &high[2]);
    *x = _mm512_insertf32x8(_mm512_castps256_ps512(low[0]), high[0], 1);
    *y = _mm512_insertf32x8(_mm512_castps256_ps512(low[1]), high[1], 1);
    *z = _mm512_insertf32x8(_mm512_castps256_ps512(low[2]), high[2], 1);
}

/* Load eight numbers of four bytes. If there are gaps between them, twelve bytes behind each are read as well. */
EIGHT_INLINED __m256 eight_singles(const char *from, Py_ssize_t step) {
    if (step == 4) return _mm256_loadu_ps((const float *)from);
    __m256 pair[4];
    for (int i = 0; i < 4; i++) pair[i] = load_two(from + i * step, from + (i + 4) * step);
    return _mm256_shuffle_ps(_mm256_unpacklo_ps(pair[0], pair[1]), _mm256_unpacklo_ps(pair[2], pair[3]), 0x44);
}

EIGHT_INLINED __m256d four_doubles(const char *from, Py_ssize_t step) {
    if (step == 8) return _mm256_loadu_pd((const double *)from);
    double number[4];
    for (int i = 0; i < 4; i++) memcpy(number + i, from + i * step, sizeof *number);
    return _mm256_set_pd(number[3], number[2], number[1], number[0]);
}
#endif

#endif
