/* The functions of the module that have files of their own. */

#ifndef PC2SCAN_FUNCTIONS_H
#define PC2SCAN_FUNCTIONS_H

#include "portable.h"

HIDDEN PyObject *span(PyObject *self, PyObject *args);
HIDDEN PyObject *follow(PyObject *self, PyObject *args);
HIDDEN PyObject *nodes(PyObject *self, PyObject *args);
HIDDEN PyObject *trace(PyObject *self, PyObject *args);

#endif
