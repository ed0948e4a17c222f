#include "arrays.h"

int contiguous(PyObject *object, Py_buffer *view, int flags, Py_ssize_t item, Py_ssize_t count) {
    if (PyObject_GetBuffer(object, view, flags | PyBUF_C_CONTIGUOUS) < 0) return -1;
    if (view->itemsize == item && (count < 0 || view->len == count * item)) return 0;
    PyBuffer_Release(view);
    PyErr_SetString(PyExc_ValueError, "an array has another length or item size than expected");
    return -1;
}

void release_cloud(Cloud *cloud) {
    while (cloud->held > 0) PyBuffer_Release(&cloud->coordinates[--cloud->held]);
}

/* Set the type of an array's values from its dtype. Integers of eight bytes are refused unless `wide` is set. */
static int find_type(PyObject *dtype, Axis *axis, Py_ssize_t item, int wide) {
    PyObject *text = PyObject_GetAttrString(dtype, "str");
    if (!text) return -1;
    const char *type = PyUnicode_AsUTF8AndSize(text, NULL);
    int known = type && type[0] && type[1] && strchr("iuf", type[1]) && type[2] && !type[3];
    if (known) {
        axis->kind = type[1];
        axis->size = type[2] - '0';
        known = axis->size == item && (axis->kind == 'f' ? item == 4 || item == 8 : item == 1 || item == 2 || item == 4 || wide);
        axis->swapped = type[0] == (PY_BIG_ENDIAN ? '<' : '>');
    }
    Py_DECREF(text);
    if (type && !known) PyErr_SetString(PyExc_ValueError, "coordinates or times are of a type that no PointField has");
    return known ? 0 : -1;
}

int take_coordinates(Cloud *cloud, PyObject *xyz[3]) {
    memset(cloud, 0, sizeof *cloud);
    const Py_buffer *like = &cloud->coordinates[0];
    /* Usually all three have the same dtype. Asking NumPy for its name takes as long as projecting 300 points. */
    PyObject *last = NULL;
    for (; cloud->held < 3; cloud->held++) {
        Py_buffer *view = &cloud->coordinates[cloud->held];
        if (PyObject_GetBuffer(xyz[cloud->held], view, PyBUF_STRIDES) < 0) goto failed;
        Axis *axis = &cloud->axis[cloud->held];
        int same = view->ndim == like->ndim;
        for (int i = 0; same && i < view->ndim; i++) same = view->shape[i] == like->shape[i];
        if (!same || view->ndim < 1 || view->ndim > 2) {
            PyBuffer_Release(view);
            PyErr_SetString(PyExc_ValueError, "coordinates are not three arrays of one shape");
            goto failed;
        }
        PyObject *dtype = PyObject_GetAttrString(xyz[cloud->held], "dtype");
        const int known = dtype && dtype == last;
        if (known) *axis = axis[-1];
        Py_XDECREF(last);
        last = dtype;
        if (!dtype || (!known && find_type(dtype, axis, view->itemsize, 0) < 0)) {
            PyBuffer_Release(view);
            goto failed;
        }
        axis->data = view->buf;
        axis->step = view->strides[view->ndim - 1];
        axis->row_step = view->ndim == 2 ? view->strides[0] : 0;
    }
    Py_XDECREF(last);
    cloud->rows = like->ndim == 2 ? like->shape[0] : 1;
    cloud->columns = like->shape[like->ndim - 1];
    return 0;
failed:
    Py_XDECREF(last);
    release_cloud(cloud);
    return -1;
}

int take_field(const Cloud *cloud, PyObject *array, Py_buffer *view, Axis *axis) {
    const Py_buffer *like = &cloud->coordinates[0];
    if (PyObject_GetBuffer(array, view, PyBUF_STRIDES) < 0) return -1;
    int same = view->ndim == like->ndim;
    for (int i = 0; same && i < view->ndim; i++) same = view->shape[i] == like->shape[i];
    if (!same) PyErr_SetString(PyExc_ValueError, "times are not of the coordinates' shape");
    PyObject *dtype = same ? PyObject_GetAttrString(array, "dtype") : NULL;
    const int found = dtype ? find_type(dtype, axis, view->itemsize, 1) : -1;
    Py_XDECREF(dtype);
    if (found < 0) {
        PyBuffer_Release(view);
        return -1;
    }
    axis->data = view->buf;
    axis->step = view->strides[view->ndim - 1];
    axis->row_step = view->ndim == 2 ? view->strides[0] : 0;
    return 0;
}
