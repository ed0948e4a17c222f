/* Rays into an occupancy grid; occupancy.py describes the rules. */

#include "arrays.h"
#include "functions.h"

/* Constants of a grid of log-odds, the same as in occupancy.py. */
enum { UNKNOWN = -128, HIT = 17, MISS = -8, LOWEST = -40, HIGHEST = 70 };

/* The high byte of a cell is its log-odds, the low byte the mark of the last scan that changed it. */
typedef struct {
    int16_t *cells;
    int mark;
} Grid;

/* Change a cell, unless the same scan has changed it. Without branches, because whether it has is hard to predict. */
INLINED void observe(const Grid *grid, int64_t place, const int change) {
    const int cell = grid->cells[place], odds = cell >> 8;
    int value = (odds == UNKNOWN ? 0 : odds) + change;
    if (change < 0) value = value < LOWEST ? LOWEST : value;
    else value = value > HIGHEST ? HIGHEST : value;
    const int changed = value * 256 + grid->mark;
    grid->cells[place] = (int16_t)((cell & 255) == grid->mark ? cell : changed);
}

/* Draw a line by Bresenham's algorithm. The last cell is free only if nothing was hit there. */
static void draw_free(const Grid *grid, int64_t width, const int32_t *ray, int hit) {
    const int64_t dx = (int64_t)ray[2] - ray[0], dy = (int64_t)ray[3] - ray[1];
    const int64_t across = dx < 0 ? -dx : dx, up = dy < 0 ? -dy : dy;
    const int64_t along_x = dx < 0 ? -1 : 1, along_y = dy < 0 ? -width : width;
    const int64_t length = across > up ? across : up, other = across > up ? up : across;
    const int64_t step = across > up ? along_x : along_y, aside = across > up ? along_y : along_x;
    /* For each step: what is added to the error if the line goes straight on, and if it also goes aside. */
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

PyObject *trace(PyObject *self, PyObject *args) {
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
    if (width < 1 || size % width || mark < 0 || mark > 255) PyErr_SetString(PyExc_ValueError, "the size of the grid is not a multiple of its width, or the mark is not from 0 to 255");
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
