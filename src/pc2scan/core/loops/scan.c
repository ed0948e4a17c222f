/* Project a block of points to the beams of a scan. Loops without branches compute squares, angles and bins, so that
   compilers use vector instructions. Then the minimum of each bin is taken. */

#include "angles.h"
#include "scan.h"

/* Inlined, so that each rounding of angles has a function of its own: a common one took 4 % longer. */
INLINED void project_with(Scan *scan, const int glibc) {
    const Rule rule = scan->rule;
    const int count = scan->filled;
    const int32_t beams = scan->beams, behind = rule.closed ? beams - 1 : beams + PAST_END;
    const float first = (float)rule.first, last = (float)rule.last;
    double squares[BLOCK];
    float angle[BLOCK];
    int32_t bin[BLOCK], lost[REASONS] = {0, 0, 0};
    /* float64 represents squares of float32 exactly, and libm's hypotf adds them in float64. */
    for (int i = 0; i < count; i++) squares[i] = (double)scan->x[i] * scan->x[i] + (double)scan->y[i] * scan->y[i];
    if (glibc) glibc_angles_of(scan->x, scan->y, angle, count);
    else angles_of(scan->x, scan->y, angle, count);
    for (int i = 0; i < count; i++) {
        double turned = angle[i] + rule.offset;
        turned = turned >= rule.turn ? turned - rule.turn : turned;
        /* The angles from -float32(pi) to float32(pi) are more than one turn. */
        turned = turned >= rule.turn ? turned - rule.turn : turned;
        double quotient = (turned + rule.skew) / rule.increment;
        /* Outside the sector, the quotient may exceed the integers. */
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

void project_block(Scan *scan) {
    if (scan->rule.glibc) project_glibc(scan);
    else project_correct(scan);
}

/* Drop the points from index `from` on that are NaN, too high or too low, in place. */
WIDEST static void keep_level(Scan *scan, const int from, const int count) {
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

void drop_by_height(Scan *scan, int from, int count) { keep_level(scan, from, count); }
