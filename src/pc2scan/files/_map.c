/* A file's bytes where the system keeps them, that survive what happens to the file.

   Where a file has become shorter under a map, or its disk fails, the system has no page to show and sends SIGBUS to the
   thread that looks, which ends the process. For the maps made here, the handler puts a page of zeros in that place and
   takes note; who has used the map asks afterwards whether what was seen was there. Other places' signals go where they
   went before. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#ifdef __linux__
#include <errno.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdint.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#ifndef MADV_POPULATE_READ
#define MADV_POPULATE_READ 22 /* Linux 5.14; refused before */
#endif

enum { PLACES = 256 };

/* What the handler, on any thread, looks at. Written with the interpreter's lock held: `length` while there is no `from`. */
static struct {
    _Atomic uintptr_t from;
    _Atomic size_t length;
    atomic_bool missed;
} guarded[PLACES];

static struct sigaction before;
/* Handlers that come later may have this one for theirs from before, and hand on to it what it has handed to them. */
static atomic_bool handed_on;
static uintptr_t page_size;

static void on_bus_error(int signal, siginfo_t *told, void *context) {
    (void)context;
    const int number = errno;
    const uintptr_t at = (uintptr_t)told->si_addr;
    /* Signals that a process sends have no address. */
    for (int i = 0; told->si_code > 0 && i < PLACES; i++) {
        const uintptr_t from = atomic_load(&guarded[i].from);
        if (!from || at < from || at - from >= atomic_load(&guarded[i].length)) continue;
        void *page = (void *)(at - at % page_size);
        if (mmap(page, page_size, PROT_READ, MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED, -1, 0) == MAP_FAILED) break;
        atomic_store(&guarded[i].missed, 1);
        errno = number;
        return;
    }
    /* What caused it happens again, and meets the handler from before; what was sent is sent again. */
    const struct sigaction standard = {.sa_handler = SIG_DFL};
    sigaction(signal, atomic_exchange(&handed_on, 1) ? &standard : &before, NULL);
    if (told->si_code <= 0) raise(signal);
    errno = number;
}

/* Somebody else's handler may have taken the place of this one since the last use. */
static int guarding(void) {
    struct sigaction now;
    if (sigaction(SIGBUS, NULL, &now) < 0) return 0;
    if ((now.sa_flags & SA_SIGINFO) && now.sa_sigaction == on_bus_error) return 1;
    struct sigaction ours = {.sa_sigaction = on_bus_error, .sa_flags = SA_SIGINFO | SA_ONSTACK};
    sigemptyset(&ours.sa_mask);
    before = now;
    atomic_store(&handed_on, 0);
    return sigaction(SIGBUS, &ours, NULL) == 0;
}

typedef struct {
    char *from;
    size_t length;
} Pages;

enum { FORGOTTEN = 8 };

typedef struct {
    PyObject_HEAD
    char *from;
    Py_ssize_t length;
    int place;
    /* Are given back while the interpreter's lock is not held anyhow. */
    Pages forgotten[FORGOTTEN];
    int forgotten_count;
} Map;

static PyObject *map_new(PyTypeObject *type, PyObject *args, PyObject *kwargs) {
    int descriptor;
    Py_ssize_t length;
    if (kwargs && PyDict_Size(kwargs)) return PyErr_Format(PyExc_TypeError, "arguments have no names");
    if (!PyArg_ParseTuple(args, "in", &descriptor, &length)) return NULL;
    int place = 0;
    while (place < PLACES && atomic_load(&guarded[place].from)) place++;
    errno = EMFILE;
    if (place == PLACES || !guarding()) return PyErr_SetFromErrno(PyExc_OSError);
    void *from = mmap(NULL, (size_t)length, PROT_READ, MAP_SHARED, descriptor, 0);
    if (from == MAP_FAILED) return PyErr_SetFromErrno(PyExc_OSError);
    allocfunc allocate = (allocfunc)PyType_GetSlot(type, Py_tp_alloc);
    Map *self = (Map *)allocate(type, 0);
    if (!self) {
        munmap(from, (size_t)length);
        return NULL;
    }
    self->from = from;
    self->length = length;
    self->place = place;
    self->forgotten_count = 0;
    atomic_store(&guarded[place].missed, 0);
    atomic_store(&guarded[place].length, (size_t)length);
    atomic_store(&guarded[place].from, (uintptr_t)from);
    return (PyObject *)self;
}

static void map_dealloc(PyObject *object) {
    Map *self = (Map *)object;
    PyTypeObject *type = Py_TYPE(object);
    atomic_store(&guarded[self->place].from, 0);
    munmap(self->from, (size_t)self->length);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(object);
    Py_DECREF(type);
}

static int map_getbuffer(PyObject *object, Py_buffer *view, int flags) {
    Map *self = (Map *)object;
    return PyBuffer_FillInfo(view, object, self->from, self->length, 1, flags);
}

/* The pages around bytes of it; a place outside is an error. */
static int pages_of(Map *self, PyObject *args, Pages *pages) {
    Py_ssize_t offset, count;
    if (!PyArg_ParseTuple(args, "nn", &offset, &count)) return 0;
    if (offset < 0 || count < 0 || offset > self->length || count > self->length - offset) {
        PyErr_SetString(PyExc_ValueError, "that is outside the map");
        return 0;
    }
    const size_t more = (size_t)offset % page_size;
    pages->from = self->from + offset - more;
    pages->length = (size_t)count + more;
    return 1;
}

static PyObject *map_fetch(PyObject *object, PyObject *args) {
    Map *self = (Map *)object;
    Pages wanted, forgotten[FORGOTTEN];
    if (!pages_of(self, args, &wanted)) return NULL;
    if (!guarding()) return PyErr_SetFromErrno(PyExc_OSError);
    const int count = self->forgotten_count;
    memcpy(forgotten, self->forgotten, sizeof forgotten);
    self->forgotten_count = 0;
    int failed;
    Py_BEGIN_ALLOW_THREADS
    for (int i = 0; i < count; i++) madvise(forgotten[i].from, forgotten[i].length, MADV_DONTNEED);
    /* Not known to older systems: pages then come when they are looked at. */
    failed = madvise(wanted.from, wanted.length, MADV_POPULATE_READ) < 0 && errno != EINVAL;
    Py_END_ALLOW_THREADS
    if (failed) atomic_store(&guarded[self->place].missed, 1);
    return Py_NewRef(Py_None);
}

static PyObject *map_forget(PyObject *object, PyObject *args) {
    Map *self = (Map *)object;
    Pages pages;
    if (!pages_of(self, args, &pages)) return NULL;
    if (self->forgotten_count < FORGOTTEN) self->forgotten[self->forgotten_count++] = pages;
    else madvise(pages.from, pages.length, MADV_DONTNEED);
    return Py_NewRef(Py_None);
}

static PyObject *map_missed(PyObject *object, void *unused) {
    (void)unused;
    return PyBool_FromLong(atomic_load(&guarded[((Map *)object)->place].missed));
}

static PyMethodDef map_methods[] = {
    {"fetch", map_fetch, METH_VARARGS, "fetch(offset, length): bring these bytes in before they are used"},
    {"forget", map_forget, METH_VARARGS, "forget(offset, length): they count as the process's memory until the next fetch"},
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef map_attributes[] = {
    {"missed", map_missed, NULL, "whether something was not there when it was fetched or looked at", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyType_Slot map_slots[] = {
    {Py_tp_doc, "Map(descriptor, length): the first bytes of an open file"},
    {Py_tp_new, map_new},
    {Py_tp_dealloc, map_dealloc},
    {Py_tp_methods, map_methods},
    {Py_tp_getset, map_attributes},
    {Py_bf_getbuffer, map_getbuffer},
    {0, NULL},
};

static PyType_Spec map_spec = {"pc2scan.files._map.Map", sizeof(Map), 0, Py_TPFLAGS_DEFAULT, map_slots};

static int prepare(PyObject *self) {
    page_size = (uintptr_t)sysconf(_SC_PAGESIZE);
    PyObject *type = PyType_FromModuleAndSpec(self, &map_spec, NULL);
    if (!type) return -1;
    const int failed = PyModule_AddType(self, (PyTypeObject *)type);
    Py_DECREF(type);
    return failed;
}
#else
static int prepare(PyObject *self) {
    (void)self;
    PyErr_SetString(PyExc_ImportError, "what this system does about missing pages is not known");
    return -1;
}
#endif

static PyModuleDef_Slot slots[] = {{Py_mod_exec, prepare}, {0, NULL}};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_map", NULL, 0, NULL, slots, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__map(void) { return PyModuleDef_Init(&module); }
