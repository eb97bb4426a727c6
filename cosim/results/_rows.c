/* The rows of a flight's log: what a Sample holds, read in one go, and handed over as columns.
 *
 * Columns are made of a few rows at a time, which are in the processor's nearest cache then: a block of rows that is
 * turned when it is full would push out of it what the flight needs.
 *
 * What is read, and where it goes, is a program: see cosim.results.log.row_program.Program, whose fields these are.
 *
 * A row is read completely before any of it is kept, so that a sample of a wrong kind is refused (TypeError) and leaves
 * no trace.  The rows stay until they are cleared: what could not be written can be tried again.
 *
 * Not of Python's limited API, whose checked functions would make it three times as slow.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
#include <stdbool.h>
#include <string.h>
#include <time.h>

enum { MOST_NODES = 64, MOST_NUMBERS = 4096 }; /* of a program: they stand on the stack while a row is read */
enum { TILE = 8 }; /* rows made columns at once: so many numbers are a line of the processor's cache */

/* --- the program --- */

/* A tuple to open: the element of another, or the sample itself (-1). */
typedef struct {
    PyObject *name;
    Py_ssize_t parent, element;
    Py_ssize_t size; /* negative: at least */
    bool may_be_none;
} Node;

/* So many numbers in a row of a node, to a column and those behind it. */
typedef struct {
    Py_ssize_t node, first, count, column;
    Py_ssize_t unless, other; /* NaN if the element ``other`` of this node is not None; -1: of none */
    bool add;
} Read;

typedef struct {
    Py_ssize_t width, nodes, reads;
    Node *node;
    Read *read;
    double *blank; /* a row before anything is read: NaN */
} Program;

static void forget(Program *p)
{
    for (Py_ssize_t i = 0; p->node && i < p->nodes; i++)
        Py_CLEAR(p->node[i].name);
    PyMem_Free(p->node);
    PyMem_Free(p->read);
    PyMem_Free(p->blank);
    *p = (Program){0};
}

static bool load_nodes(Program *p, PyObject *nodes)
{
    for (Py_ssize_t i = 0; i < PyList_GET_SIZE(nodes); i++, p->nodes++) {
        Node *const n = p->node + i;
        int may_be_none;
        if (!PyArg_ParseTuple(PyList_GET_ITEM(nodes, i), "Unnnp", &n->name, &n->parent, &n->element, &n->size,
                              &may_be_none)) {
            n->name = NULL;
            return false;
        }
        Py_INCREF(n->name);
        n->may_be_none = may_be_none;
        const Py_ssize_t within = n->parent < 0 ? 0 : n->parent < i ? Py_ABS(p->node[n->parent].size) : -1;
        if (n->element < 0 || (n->parent < 0 ? i > 0 : n->element >= within))
            return false;
    }
    return p->nodes > 0;
}

static bool load_reads(Program *p, PyObject *reads)
{
    for (Py_ssize_t i = 0; i < PyList_GET_SIZE(reads); i++, p->reads++) {
        Read *const r = p->read + i;
        int add;
        if (!PyArg_ParseTuple(PyList_GET_ITEM(reads, i), "nnnnnnp", &r->node, &r->first, &r->count, &r->column,
                              &r->unless, &r->other, &add))
            return false;
        r->add = add;
        if (r->node < 0 || r->node >= p->nodes || r->first < 0 || r->count < 0 || r->column < 0 ||
            r->count > Py_ABS(p->node[r->node].size) - r->first || r->count > p->width - r->column ||
            r->unless >= p->nodes || r->other < 0 ||
            (r->unless >= 0 && (p->node[r->unless].may_be_none || r->other >= Py_ABS(p->node[r->unless].size))))
            return false;
    }
    return true;
}

/* ValueError where it does not hold together. */
static bool load(Program *p, Py_ssize_t width, PyObject *nodes, PyObject *reads)
{
    p->width = width;
    if (width > 0 && width <= MOST_NUMBERS && PyList_GET_SIZE(nodes) <= MOST_NODES) {
        p->node = PyMem_Calloc((size_t)PyList_GET_SIZE(nodes) + 1, sizeof(Node));
        p->read = PyMem_Calloc((size_t)PyList_GET_SIZE(reads) + 1, sizeof(Read));
        p->blank = PyMem_Malloc((size_t)width * sizeof(double));
        if (!p->node || !p->read || !p->blank)
            return PyErr_NoMemory() != NULL;
        for (Py_ssize_t i = 0; i < width; i++)
            p->blank[i] = NAN;
        if (load_nodes(p, nodes) && load_reads(p, reads))
            return true;
    }
    if (!PyErr_Occurred())
        PyErr_SetString(PyExc_ValueError, "Rows: no program that holds together");
    return false;
}

/* --- one row --- */

static bool as_double(PyObject *item, double *value)
{
    if (PyBool_Check(item))
        *value = item == Py_True;
    else {
        *value = PyFloat_AsDouble(item);
        return *value != -1.0 || !PyErr_Occurred();
    }
    return true;
}

/* Every node's tuple, borrowed from the sample; NULL for one that is None, and for what is in it. */
static bool open_nodes(const Program *p, PyObject *sample, PyObject **opened)
{
    for (Py_ssize_t i = 0; i < p->nodes; i++) {
        const Node *const n = p->node + i;
        PyObject *const within = n->parent < 0 ? NULL : opened[n->parent];
        PyObject *const item = n->parent < 0 ? sample : within ? PyTuple_GET_ITEM(within, n->element) : NULL;
        opened[i] = item;
        if (item && PyTuple_Check(item) &&
            (n->size < 0 ? PyTuple_GET_SIZE(item) >= -n->size : PyTuple_GET_SIZE(item) == n->size))
            continue;
        if (item && !(item == Py_None && n->may_be_none)) {
            PyErr_Format(PyExc_TypeError, "sample: %U is not a tuple of %zd", n->name, Py_ABS(n->size));
            return false;
        }
        opened[i] = NULL;
    }
    return true;
}

/* A row, or false with Python's error set. */
static bool read_sample(const Program *p, PyObject *sample, double *row)
{
    PyObject *opened[MOST_NODES];
    if (!open_nodes(p, sample, opened))
        return false;
    memcpy(row, p->blank, (size_t)p->width * sizeof(double));
    const Read *const end = p->read + p->reads;
    for (const Read *each = p->read; each < end; each++) {
        const Read r = *each; /* a copy: what is written below could be what it points to, for all the compiler knows */
        PyObject *const tuple = opened[r.node];
        if (!tuple || (r.unless >= 0 && PyTuple_GET_ITEM(opened[r.unless], r.other) != Py_None))
            continue;
        PyObject *const *item = ((PyTupleObject *)tuple)->ob_item + r.first, *const *const behind = item + r.count;
        double *to = row + r.column;
        for (; !r.add && item < behind; item++, to++)
            if (PyFloat_CheckExact(*item))
                *to = PyFloat_AS_DOUBLE(*item);
            else if (!as_double(*item, to))
                return false;
        for (double value; item < behind; item++, to++) {
            if (!as_double(*item, &value))
                return false;
            *to += value;
        }
    }
    return true;
}

/* --- Rows --- */

typedef struct {
    PyObject_HEAD
    Program program;
    Py_ssize_t capacity, count, shape[2], strides[2];
    double *tile;      /* the last rows, of the program's width, that are no columns yet or not all of a tile */
    double *columns;   /* of capacity rows each */
    double patience;   /* s */
    double since;      /* s: when it was cleared */
    PyObject *hand_on; /* called with the rows when they are to be taken */
} Rows;

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static int rows_init(Rows *self, PyObject *args, PyObject *kwargs)
{
    (void)kwargs;
    Py_ssize_t capacity, width;
    double patience;
    PyObject *hand_on, *nodes, *reads;
    if (!PyArg_ParseTuple(args, "ndOnO!O!", &capacity, &patience, &hand_on, &width, &PyList_Type, &nodes, &PyList_Type,
                          &reads))
        return -1;
    if (self->columns || capacity < 1 || capacity > PY_SSIZE_T_MAX / (Py_ssize_t)(MOST_NUMBERS * sizeof(double))) {
        PyErr_SetString(PyExc_ValueError, "Rows: made once, for at least one row");
        return -1;
    }
    if (!load(&self->program, width, nodes, reads)) {
        forget(&self->program);
        return -1;
    }
    self->tile = PyMem_Malloc((size_t)(TILE * width) * sizeof(double));
    self->columns = PyMem_Calloc((size_t)(capacity * width), sizeof(double));
    if (!self->tile || !self->columns) {
        PyMem_Free(self->tile);
        PyMem_Free(self->columns);
        self->tile = self->columns = NULL;
        forget(&self->program);
        PyErr_NoMemory();
        return -1;
    }
    self->capacity = capacity;
    self->shape[0] = width;
    self->shape[1] = capacity;
    self->strides[0] = capacity * (Py_ssize_t)sizeof(double);
    self->strides[1] = sizeof(double);
    self->patience = patience;
    self->since = now();
    Py_INCREF(hand_on);
    self->hand_on = hand_on;
    return 0;
}

static int rows_traverse(Rows *self, visitproc visit, void *arg)
{
    Py_VISIT(Py_TYPE((PyObject *)self));
    Py_VISIT(self->hand_on);
    return 0;
}

static int rows_clear(Rows *self)
{
    Py_CLEAR(self->hand_on);
    return 0;
}

static void rows_dealloc(Rows *self)
{
    PyTypeObject *type = Py_TYPE((PyObject *)self);
    PyObject_GC_UnTrack(self);
    rows_clear(self);
    forget(&self->program);
    PyMem_Free(self->tile);
    PyMem_Free(self->columns);
    PyObject_GC_Del(self);
    Py_DECREF(type);
}

static bool hand_on(Rows *self)
{
    if (!self->hand_on) {
        PyErr_SetString(PyExc_ValueError, "Rows: not initialised");
        return false;
    }
    PyObject *answer = PyObject_CallFunctionObjArgs(self->hand_on, (PyObject *)self, NULL);
    Py_XDECREF(answer);
    return answer != NULL;
}

/* The last rows of the tile, columns of which are complete up to them afterwards. */
static void transpose(Rows *self)
{
    const Py_ssize_t width = self->program.width, rows = self->count ? (self->count - 1) % TILE + 1 : 0;
    double *to = self->columns + self->count - rows;
    for (Py_ssize_t c = 0; c < width; c++, to += self->capacity)
        for (Py_ssize_t r = 0; r < rows; r++)
            to[r] = self->tile[r * width + c];
}

/* add(sample) */
static PyObject *rows_add(Rows *self, PyObject *sample)
{
    double row[MOST_NUMBERS];
    if (!self->columns) {
        PyErr_SetString(PyExc_ValueError, "Rows: not initialised");
        return NULL;
    }
    const Py_ssize_t width = self->program.width;
    if (!read_sample(&self->program, sample, row))
        return NULL;
    if (self->count == self->capacity && !hand_on(self)) /* could not be handed on when it became full */
        return NULL;
    if (self->count == self->capacity) {
        PyErr_SetString(PyExc_BufferError, "the rows were not cleared");
        return NULL;
    }
    memcpy(self->tile + self->count % TILE * width, row, (size_t)width * sizeof(double));
    self->count++;
    if (self->count % TILE == 0 || self->count == self->capacity)
        transpose(self);
    if ((self->count == self->capacity || now() - self->since >= self->patience) && !hand_on(self))
        return NULL;
    Py_RETURN_NONE;
}

/* The columns as they are, of as many rows as there is room for; rows behind the last are of earlier blocks. */
static int rows_buffer(Rows *self, Py_buffer *view, int flags)
{
    if (!self->columns) {
        PyErr_SetString(PyExc_BufferError, "Rows: not initialised");
        return -1;
    }
    transpose(self);
    const Py_ssize_t bytes = self->shape[0] * self->strides[0];
    if (PyBuffer_FillInfo(view, (PyObject *)self, self->columns, bytes, false, flags) < 0)
        return -1;
    view->itemsize = sizeof(double);
    view->ndim = 2;
    view->format = flags & PyBUF_FORMAT ? "d" : NULL;
    view->shape = self->shape;
    view->strides = self->strides;
    return 0;
}

/* clear() */
static PyObject *rows_forget(Rows *self, PyObject *unused)
{
    (void)unused;
    self->count = 0;
    self->since = now();
    Py_RETURN_NONE;
}

static Py_ssize_t rows_length(Rows *self)
{
    return self->count;
}

#define SLOT(function) ((void *)(uintptr_t)(function)) /* Python keeps functions as void pointers */

static PyMethodDef rows_methods[] = {
    {"add", (PyCFunction)rows_add, METH_O, "add(sample): one more row."},
    {"clear", (PyCFunction)rows_forget, METH_NOARGS, "clear(): forget the rows; patience begins anew."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot rows_slots[] = {
    {Py_tp_doc, "Rows(capacity, patience, hand_on, width, nodes, reads): hand_on(rows) is called for so many rows, or "
                "after so many seconds; the rest is the program.  Its buffer is the columns, of shape (width, capacity), "
                "the first len(rows) of each filled; it is good until the next row."},
    {Py_tp_new, SLOT(PyType_GenericNew)},
    {Py_tp_init, SLOT(rows_init)},
    {Py_tp_traverse, SLOT(rows_traverse)},
    {Py_tp_clear, SLOT(rows_clear)},
    {Py_tp_dealloc, SLOT(rows_dealloc)},
    {Py_tp_methods, rows_methods},
    {Py_sq_length, SLOT(rows_length)},
    {Py_bf_getbuffer, SLOT(rows_buffer)},
    {0, NULL},
};

static PyType_Spec rows_spec = {
    "cosim.results._rows.Rows", sizeof(Rows), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC, rows_slots,
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "cosim.results._rows", "The rows of a flight's log.", -1, NULL, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__rows(void)
{
    PyObject *module = PyModule_Create(&definition), *type = module ? PyType_FromSpec(&rows_spec) : NULL;
    const bool good = type && PyModule_AddObjectRef(module, "Rows", type) == 0;
    Py_XDECREF(type);
    if (!good)
        Py_CLEAR(module);
    return module;
}
