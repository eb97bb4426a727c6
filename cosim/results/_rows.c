/* The rows of a flight's log: what a Sample holds, read in one go, and handed over as columns.
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

/* The records of cosim.base.signals, field by field. */
enum { K, TIME, COMMAND, STATE, MEASURED, RATE_SETPOINT, RATE_PREDICTED, TORQUE_COMMAND, COLLECTIVE, ACTUATION, TILT,
       ENGINES, DISTURBANCE, FUEL, SPOOL_MOMENT, FAULTS, HEALTH, SAMPLE };
enum { COMMAND_ATTITUDE, COMMAND_ALTITUDE, COMMAND_RATE, COMMAND_COLLECTIVE, COMMAND_PLACE,
       COMMAND_FIELDS };
enum { POSITION, VELOCITY, ATTITUDE, EULER, RATE, SPECIFIC_FORCE, ALTITUDE, WIND, MASS, ON_GROUND, HULL_CONTACT,
       AIR_RATE, STATE_FIELDS };
enum { MEASURED_RATE, MEASURED_ATTITUDE, MEASURED_POSITION, MEASURED_VELOCITY, MEASURED_ALTITUDE,
       MEASURED_FORCE, MEASURED_FIELDS };
enum { THROTTLE, TILT_COMMAND, UNALLOCATED, OFF, ACTUATION_FIELDS };
enum { THRUST, SPOOL_SPEED, EXHAUST_TEMPERATURE, FUEL_FLOW, ENGINE_FIELDS };
enum { FORCE, MOMENT, TORQUE_ADDED, DISTURBING_WIND, PAYLOAD, GUST, TORQUE_OUTPUT, TORQUE_SEEN, DISTURBANCE_FIELDS };

enum { JETS = 6, SERVOS = 2, SENSORS = 4, AXES = 3, PLACE = 2, QUATERNION = 4 };

/* The columns of cosim.results.columns, and behind them what the angles of the measured quaternion are made from: opposite and
 * adjacent of roll, of yaw, and the sine of pitch.  The angles are numpy's, whose functions are not the C library's. */
enum { COLUMNS = 131, ANGLES = 5, WIDTH = COLUMNS + ANGLES };

/* --- one row --- */

/* The records of one sample, borrowed from it; ``jets`` is how many the vehicle has. */
typedef struct {
    PyObject *sample, *command, *state, *measured, *actuation, *engines, *disturbance;
    Py_ssize_t jets;
} Parts;

/* After an error, which is then set as Python's, nothing more is added. */
typedef struct {
    double value[WIDTH];
    int count;
    bool good;
} Row;

static bool refuse(const char *what, Py_ssize_t count)
{
    PyErr_Format(PyExc_TypeError, "sample: %s is not a tuple of %zd", what, count);
    return false;
}

static bool is_record(PyObject *item, Py_ssize_t fields, const char *what)
{
    return (PyTuple_Check(item) && PyTuple_GET_SIZE(item) == fields) || refuse(what, fields);
}

static bool take_apart(PyObject *sample, Parts *p)
{
    if (!is_record(sample, SAMPLE, "it"))
        return false;
    *p = (Parts){
        .sample = sample,
        .command = PyTuple_GET_ITEM(sample, COMMAND),
        .state = PyTuple_GET_ITEM(sample, STATE),
        .measured = PyTuple_GET_ITEM(sample, MEASURED),
        .actuation = PyTuple_GET_ITEM(sample, ACTUATION),
        .engines = PyTuple_GET_ITEM(sample, ENGINES),
        .disturbance = PyTuple_GET_ITEM(sample, DISTURBANCE),
    };
    if (!is_record(p->command, COMMAND_FIELDS, "command") || !is_record(p->state, STATE_FIELDS, "state") ||
        !is_record(p->measured, MEASURED_FIELDS, "measured") ||
        !is_record(p->actuation, ACTUATION_FIELDS, "actuation") ||
        !is_record(p->engines, ENGINE_FIELDS, "engines") ||
        !is_record(p->disturbance, DISTURBANCE_FIELDS, "disturbance"))
        return false;
    PyObject *const throttle = PyTuple_GET_ITEM(p->actuation, THROTTLE);
    p->jets = PyTuple_Check(throttle) ? PyTuple_GET_SIZE(throttle) : 0;
    return (p->jets > 0 && p->jets <= JETS) || refuse("actuation.throttle", JETS);
}

static bool as_double(PyObject *item, double *value)
{
    if (PyFloat_CheckExact(item))
        *value = PyFloat_AS_DOUBLE(item);
    else if (PyBool_Check(item))
        *value = item == Py_True;
    else {
        *value = PyFloat_AsDouble(item);
        return *value != -1.0 || !PyErr_Occurred();
    }
    return true;
}

static void number(Row *row, PyObject *record, int field)
{
    if (row->good)
        row->good = as_double(PyTuple_GET_ITEM(record, field), &row->value[row->count++]);
}

static void nothing(Row *row, Py_ssize_t count)
{
    for (; row->good && count > 0; count--)
        row->value[row->count++] = NAN;
}

/* The first ``count`` numbers of a tuple of at least as many. */
static void first_numbers(Row *row, PyObject *record, int field, Py_ssize_t count, const char *what)
{
    PyObject *const tuple = PyTuple_GET_ITEM(record, field);
    if (row->good && (!PyTuple_Check(tuple) || PyTuple_GET_SIZE(tuple) < count))
        row->good = refuse(what, count);
    for (int i = 0; i < count; i++)
        number(row, tuple, i);
}

static void numbers(Row *row, PyObject *record, int field, Py_ssize_t count, const char *what)
{
    if (row->good)
        row->good = is_record(PyTuple_GET_ITEM(record, field), count, what);
    first_numbers(row, record, field, count, what);
}

static void vector(Row *row, PyObject *record, int field, const char *what)
{
    numbers(row, record, field, AXES, what);
}

/* A number for each jet, and NaN for those that the vehicle does not have. */
static void jets(Row *row, PyObject *record, int field, Py_ssize_t count, const char *what)
{
    numbers(row, record, field, count, what);
    nothing(row, JETS - count);
}

/* What is added to the torque before and after the added delay.  Neither is ever -0, so that zeros change nothing. */
static void torques(Row *row, PyObject *disturbance)
{
    double *const sum = row->value + row->count, before[AXES];
    vector(row, disturbance, TORQUE_OUTPUT, "disturbance.torque_output");
    memcpy(before, sum, sizeof before);
    row->count -= row->good ? AXES : 0;
    vector(row, disturbance, TORQUE_ADDED, "disturbance.torque_command");
    for (int i = 0; row->good && i < AXES; i++)
        sum[i] += before[i];
}

/* See cosim.base.frames.to_euler. */
static void angles(Row *row, PyObject *measured)
{
    const double *const q = row->value + row->count;
    numbers(row, measured, MEASURED_ATTITUDE, QUATERNION, "measured.attitude");
    if (!row->good)
        return;
    const double w = q[0], x = q[1], y = q[2], z = q[3], sine = 2.0 * (w * y - x * z);
    const double found[ANGLES] = {
        2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y),
        2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z),
        sine < -1.0 ? -1.0 : sine > 1.0 ? 1.0 : sine,
    };
    memcpy(row->value + COLUMNS, found, sizeof found);
}

/* A row, in the order of cosim.results.columns. */
static bool read_sample(Row *row, PyObject *sample)
{
    Parts p;
    row->count = 0;
    row->good = take_apart(sample, &p);
    if (!row->good)
        return false;
    number(row, p.sample, TIME);
    vector(row, p.state, EULER, "state.euler");
    if (PyTuple_GET_ITEM(p.command, COMMAND_RATE) == Py_None)
        vector(row, p.command, COMMAND_ATTITUDE, "command.attitude");
    else
        nothing(row, AXES);
    nothing(row, AXES); /* the angles of the measured quaternion */
    vector(row, p.state, RATE, "state.rate");
    vector(row, p.measured, MEASURED_RATE, "measured.rate");
    vector(row, p.sample, RATE_PREDICTED, "rate_predicted");
    vector(row, p.sample, RATE_SETPOINT, "rate_setpoint");
    vector(row, p.sample, TORQUE_COMMAND, "torque_command");
    numbers(row, p.actuation, UNALLOCATED, AXES + 1, "actuation.unallocated");
    number(row, p.sample, COLLECTIVE);
    jets(row, p.actuation, THROTTLE, p.jets, "actuation.throttle");
    jets(row, p.engines, THRUST, p.jets, "engines.thrust");
    numbers(row, p.sample, TILT, SERVOS, "tilt");
    numbers(row, p.actuation, TILT_COMMAND, SERVOS, "actuation.tilt");
    vector(row, p.state, POSITION, "state.position");
    number(row, p.state, ALTITUDE);
    if (PyTuple_GET_ITEM(p.command, COMMAND_COLLECTIVE) == Py_None)
        number(row, p.command, COMMAND_ALTITUDE);
    else
        nothing(row, 1);
    number(row, p.measured, MEASURED_ALTITUDE);
    if (PyTuple_GET_ITEM(p.command, COMMAND_PLACE) == Py_None)
        nothing(row, PLACE);
    else
        numbers(row, p.command, COMMAND_PLACE, PLACE, "command.place");
    vector(row, p.state, VELOCITY, "state.velocity");
    vector(row, p.measured, MEASURED_POSITION, "measured.position");
    vector(row, p.measured, MEASURED_VELOCITY, "measured.velocity");
    vector(row, p.state, SPECIFIC_FORCE, "state.specific_force");
    vector(row, p.measured, MEASURED_FORCE, "measured.specific_force");
    vector(row, p.state, WIND, "state.wind");
    vector(row, p.state, AIR_RATE, "state.air_rate");
    number(row, p.state, MASS);
    number(row, p.state, ON_GROUND);
    number(row, p.state, HULL_CONTACT);
    vector(row, p.disturbance, FORCE, "disturbance.force");
    vector(row, p.disturbance, MOMENT, "disturbance.moment");
    torques(row, p.disturbance);
    numbers(row, p.disturbance, PAYLOAD, 1 + AXES, "disturbance.payload");
    jets(row, p.engines, SPOOL_SPEED, p.jets, "engines.spool_speed");
    jets(row, p.engines, EXHAUST_TEMPERATURE, p.jets, "engines.exhaust_temperature");
    jets(row, p.engines, FUEL_FLOW, p.jets, "engines.fuel_flow");
    number(row, p.sample, FUEL);
    vector(row, p.sample, SPOOL_MOMENT, "spool_moment");
    first_numbers(row, p.sample, HEALTH, p.jets, "health");
    nothing(row, JETS - p.jets);
    numbers(row, p.sample, FAULTS, JETS + SERVOS + SENSORS, "faults");
    angles(row, p.measured);
    return row->good;
}

/* --- Rows --- */

typedef struct {
    PyObject_HEAD
    Py_ssize_t capacity, count;
    double *rows;      /* count rows of WIDTH */
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
    Py_ssize_t capacity;
    double patience;
    PyObject *hand_on;
    if (!PyArg_ParseTuple(args, "ndO", &capacity, &patience, &hand_on))
        return -1;
    if (self->rows || capacity < 1 || capacity > PY_SSIZE_T_MAX / (Py_ssize_t)(WIDTH * sizeof(double))) {
        PyErr_SetString(PyExc_ValueError, "Rows: made once, for at least one row");
        return -1;
    }
    self->rows = PyMem_Malloc((size_t)capacity * WIDTH * sizeof(double));
    if (!self->rows) {
        PyErr_NoMemory();
        return -1;
    }
    self->capacity = capacity;
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
    PyMem_Free(self->rows);
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

/* add(sample) */
static PyObject *rows_add(Rows *self, PyObject *sample)
{
    Row row;
    if (!read_sample(&row, sample))
        return NULL;
    if (self->count == self->capacity && !hand_on(self)) /* could not be handed on when it became full */
        return NULL;
    if (self->count == self->capacity) {
        PyErr_SetString(PyExc_BufferError, "the rows were not cleared");
        return NULL;
    }
    memcpy(self->rows + self->count * WIDTH, row.value, sizeof row.value);
    self->count++;
    if ((self->count == self->capacity || now() - self->since >= self->patience) && !hand_on(self))
        return NULL;
    Py_RETURN_NONE;
}

/* Columns of ``count`` rows; in tiles, because a line of the processor's cache holds eight numbers. */
static void transpose(const double *rows, Py_ssize_t count, Py_ssize_t columns, double *to)
{
    enum { TILE = 8 };
    for (Py_ssize_t c = 0; c < columns; c += TILE)
        for (Py_ssize_t r = 0; r < count; r += TILE)
            for (Py_ssize_t i = c; i < columns && i < c + TILE; i++)
                for (Py_ssize_t j = r; j < count && j < r + TILE; j++)
                    to[i * count + j] = rows[j * WIDTH + i];
}

/* read(first, out) */
static PyObject *rows_read(Rows *self, PyObject *args)
{
    Py_ssize_t first;
    PyObject *out;
    Py_buffer to;
    if (!PyArg_ParseTuple(args, "nO", &first, &out))
        return NULL;
    if (PyObject_GetBuffer(out, &to, PyBUF_WRITABLE | PyBUF_FORMAT | PyBUF_C_CONTIGUOUS) < 0)
        return NULL;
    const Py_ssize_t columns = to.ndim == 2 ? to.shape[0] : 0;
    const bool good = columns && to.shape[1] == self->count && to.itemsize == sizeof(double) && to.format &&
                      strcmp(to.format, "d") == 0 && first >= 0 && columns <= WIDTH && first <= WIDTH - columns;
    if (good)
        transpose(self->rows + first, self->count, columns, to.buf);
    PyBuffer_Release(&to);
    if (!good)
        return PyErr_Format(PyExc_ValueError, "read: needs float64, at most %d columns of %zd rows", WIDTH,
                            self->count);
    Py_RETURN_NONE;
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
    {"read", (PyCFunction)rows_read, METH_VARARGS, "read(first, out): columns from ``first`` on into an array."},
    {"clear", (PyCFunction)rows_forget, METH_NOARGS, "clear(): forget the rows; patience begins anew."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot rows_slots[] = {
    {Py_tp_doc, "Rows(capacity, patience, hand_on): hand_on(rows) is called for so many rows, or after so many seconds."},
    {Py_tp_new, SLOT(PyType_GenericNew)},
    {Py_tp_init, SLOT(rows_init)},
    {Py_tp_traverse, SLOT(rows_traverse)},
    {Py_tp_clear, SLOT(rows_clear)},
    {Py_tp_dealloc, SLOT(rows_dealloc)},
    {Py_tp_methods, rows_methods},
    {Py_sq_length, SLOT(rows_length)},
    {0, NULL},
};

static PyType_Spec rows_spec = {
    "cosim.results._rows.Rows", sizeof(Rows), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC, rows_slots,
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "cosim.results._rows", "The rows of a flight's log.", -1, NULL, NULL, NULL, NULL, NULL,
};

static bool add(PyObject *module, const char *name, PyObject *object)
{
    const bool good = object && PyModule_AddObjectRef(module, name, object) == 0;
    Py_XDECREF(object);
    return good;
}

PyMODINIT_FUNC PyInit__rows(void)
{
    PyObject *module = PyModule_Create(&definition);
    if (module && (!add(module, "Rows", PyType_FromSpec(&rows_spec)) ||
                   PyModule_AddIntConstant(module, "COLUMNS", COLUMNS) < 0)) {
        Py_DECREF(module);
        return NULL;
    }
    return module;
}
