/* The loop over the engines: set inputs, do step, get outputs, for all of them in one call from Python.
 *
 * FMPy loads and instantiates the FMUs; what arrives here are instances and function addresses.  Nothing here reads
 * files or formats messages: a failure is raised as FailureError(index, what, status, port), and Python says it in words.
 *
 * Keeps to Python's limited API, so that one build serves every Python from 3.11 on.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

/* --- the parts of FMI 2.0 and 3.0 that are called in flight --- */

typedef int (*Set2)(void *, const unsigned int[], size_t, const double[]);
typedef int (*Get2)(void *, const unsigned int[], size_t, double[]);
typedef int (*Step2)(void *, double, double, int);
typedef int (*Set64)(void *, const uint32_t[], size_t, const double[], size_t);
typedef int (*Get64)(void *, const uint32_t[], size_t, double[], size_t);
typedef int (*SetAny)(void *, const uint32_t[], size_t, const void *, size_t); /* of any other type of FMI 3.0 */
typedef int (*GetAny)(void *, const uint32_t[], size_t, void *, size_t);
typedef int (*SetInteger2)(void *, const unsigned int[], size_t, const int[]);
typedef int (*GetInteger2)(void *, const unsigned int[], size_t, int[]);
typedef int (*Step3)(void *, double, double, bool, bool *, bool *, bool *, double *);

enum { OK = 0, WARNING = 1, DISCARD = 2 };

/* The ports, in the order of cosim.engine.fmu.port_kinds, INPUTS and OUTPUTS; BASE are given, the others follow from them. */
enum { THROTTLE, PRESSURE, TEMPERATURE, AIR_SPEED, BASE, ALTITUDE = BASE, MACH, DENSITY, TOTAL_PRESSURE,
       TOTAL_TEMPERATURE, INPUTS };
enum { THRUST, OUTPUTS = 7 };

static const char *const INPUT_NAMES[INPUTS] = {"throttle", "ambient_pressure", "ambient_temperature", "air_speed", "altitude", "mach", "density", "total_pressure", "total_temperature"};
static const char *const OUTPUT_NAMES[OUTPUTS] = {"thrust", "spool_speed", "exhaust_temperature", "fuel_flow", "force_forward", "force_right", "torque"};

enum { BLOCKS = 4, MOST_PARTS = 10000 };

/* What values are passed as, in the order of cosim.engine.fmu.instance.VALUE_TYPES. */
typedef enum { DOUBLE, FLOAT, INT8, UINT8, INT16, UINT16, INT32, UINT32, INT64, UINT64, KINDS } Kind;

/* One call that sets or gets variables of one type; an array counts as one reference and several values. */
typedef struct {
    uintptr_t call; /* function; 0: nothing to do */
    Kind kind;
    size_t references, values;
    size_t first_references, first_values; /* the part that is set in every step: the throttles */
    uint32_t *reference;
    double *value;
    void *other_value; /* the same in a kind that is not double */
} Block;

/* Where a port is among the values, and what it is there: value = scale * port + offset for inputs, limited to
 * low..high; port = scale * value + offset for outputs. */
typedef struct {
    int block; /* -1: the engine has no such port */
    size_t index;
    double scale, offset, low, high;
} Place;

/* One instance, which serves one station. */
typedef struct {
    int fmi; /* 2 or 3 */
    void *instance;
    uintptr_t step; /* function */
    bool has_ambient, has_derived;
    int sets, gets; /* blocks that there are */
    Block set[BLOCKS], get[BLOCKS];
    Place input[INPUTS], output[OUTPUTS];
    Place drag;          /* of the ram, taken from a gross thrust */
    double port[INPUTS]; /* what the inputs were last set to */
    long long steps; /* communication steps done, warming up included: FMU time = steps * step */
} Engine;

/* What went wrong; NULL is nothing. */
typedef struct {
    const char *what;
    int status;
    const char *port;
} Fault;

static const Fault NO_FAULT = {NULL, OK, ""};
#define FAULT(what, status) ((Fault){what, status, ""})

/* The values of a block, from doubles to its kind and back; a whole number arrives here as one. */
static void convert(const Block *b, size_t count, bool out)
{
#define CASE(kind, type)                                \
    case kind:                                          \
        for (size_t i = 0; i < count; i++)              \
            if (out)                                    \
                ((type *)b->other_value)[i] = (type)b->value[i]; \
            else                                        \
                b->value[i] = (double)((type *)b->other_value)[i]; \
        break;
    switch (b->kind) {
    CASE(FLOAT, float)
    CASE(INT8, int8_t)
    CASE(UINT8, uint8_t)
    CASE(INT16, int16_t)
    CASE(UINT16, uint16_t)
    CASE(INT32, int32_t)
    CASE(UINT32, uint32_t)
    CASE(INT64, int64_t)
    CASE(UINT64, uint64_t)
    default: break;
    }
#undef CASE
}

static int set_block(const Engine *e, const Block *b, bool all)
{
    const size_t references = all ? b->references : b->first_references;
    const size_t values = all ? b->values : b->first_values;
    if (!references)
        return OK;
    if (b->kind == DOUBLE) {
        if (e->fmi == 2)
            return ((Set2)b->call)(e->instance, b->reference, references, b->value);
        return ((Set64)b->call)(e->instance, b->reference, references, b->value, values);
    }
    convert(b, values, true);
    if (e->fmi == 2)
        return ((SetInteger2)b->call)(e->instance, b->reference, references, b->other_value);
    return ((SetAny)b->call)(e->instance, b->reference, references, b->other_value, values);
}

static int get_block(const Engine *e, const Block *b)
{
    if (!b->references)
        return OK;
    if (b->kind == DOUBLE) {
        if (e->fmi == 2)
            return ((Get2)b->call)(e->instance, b->reference, b->references, b->value);
        return ((Get64)b->call)(e->instance, b->reference, b->references, b->value, b->values);
    }
    const int status = e->fmi == 2
        ? ((GetInteger2)b->call)(e->instance, b->reference, b->references, b->other_value)
        : ((GetAny)b->call)(e->instance, b->reference, b->references, b->other_value, b->values);
    convert(b, b->values, false);
    return status;
}

/* The same air in other words: cosim.engine.fmu.air.Air.derive, whose constants these are. */
static void derive(double port[INPUTS])
{
    const double gamma = 1.4, gas = 287.05287, gravity = 9.80665, p0 = 101325.0, t0 = 288.15, lapse = 0.0065;
    const double tropopause = 11000.0, stratosphere = 216.65;
    const double p = port[PRESSURE], t = port[TEMPERATURE];
    double altitude = t0 / lapse * (1.0 - pow(p / p0, gas * lapse / gravity));
    if (altitude > tropopause) {
        const double there = pow(stratosphere / t0, gravity / (gas * lapse)) * p0;
        altitude = tropopause + gas * stratosphere / gravity * log(there / p);
    }
    const double mach = port[AIR_SPEED] / sqrt(gamma * gas * t), ram = 1.0 + 0.5 * (gamma - 1.0) * mach * mach;
    port[ALTITUDE] = altitude;
    port[MACH] = mach;
    port[DENSITY] = p / (gas * t);
    port[TOTAL_PRESSURE] = p * pow(ram, gamma / (gamma - 1.0));
    port[TOTAL_TEMPERATURE] = t * ram;
}

static void place_input(Engine *e, int port, double wanted)
{
    const Place *p = &e->input[port];
    e->port[port] = wanted;
    if (p->block < 0)
        return;
    double value = p->scale * wanted;
    if (p->offset != 0.0) /* adding 0 would lose the sign of -0 */
        value += p->offset;
    if (value < p->low)
        value = p->low;
    if (value > p->high)
        value = p->high;
    if (e->set[p->block].kind >= INT8)
        value = floor(value + 0.5);
    e->set[p->block].value[p->index] = value;
}

static Fault place_throttle(Engine *e, double throttle)
{
    if (!isfinite(throttle))
        return (Fault){"input", OK, INPUT_NAMES[THROTTLE]};
    place_input(e, THROTTLE, throttle);
    return NO_FAULT;
}

/* What has changed of the ambient (pressure, temperature, air speed) of one engine. */
static Fault place_ambient(Engine *e, const double *ambient, bool *changed)
{
    bool here = false;
    for (int i = PRESSURE; i < BASE; i++) {
        const double wanted = ambient[i - PRESSURE];
        if (wanted == e->port[i] || (e->input[i].block < 0 && !e->has_derived))
            continue;
        if (!isfinite(wanted))
            return (Fault){"input", OK, INPUT_NAMES[i]};
        place_input(e, i, wanted);
        here = true;
    }
    if (here && e->has_derived) {
        derive(e->port);
        for (int i = BASE; i < INPUTS; i++) {
            if (!isfinite(e->port[i]))
                return (Fault){"input", OK, INPUT_NAMES[i]};
            place_input(e, i, e->port[i]);
        }
    }
    *changed = *changed || here;
    return NO_FAULT;
}

/* One call for each type: the throttle, or with ``all`` the ambient too. */
static Fault set_inputs(const Engine *e, bool all)
{
    for (int i = 0; i < e->sets; i++) {
        const int status = set_block(e, &e->set[i], all);
        if (status > WARNING)
            return FAULT("set", status);
    }
    return NO_FAULT;
}

static Fault get_outputs(const Engine *e)
{
    for (int i = 0; i < e->gets; i++) {
        const int status = get_block(e, &e->get[i]);
        if (status > WARNING)
            return FAULT("get", status);
    }
    return NO_FAULT;
}

/* One communication step, in as many parts as an FMU that returns early makes of it. */
static Fault step3(const Engine *e, double time, double step)
{
    const double end = time + step, close = 1e-9 * step;
    double now = time, length = step;
    for (int i = 0; i < MOST_PARTS; i++) {
        bool event = false, terminate = false, early = false;
        double reached = now + length;
        const int status =
            ((Step3)e->step)(e->instance, now, length, true, &event, &terminate, &early, &reached);
        if (status > WARNING)
            return FAULT("step", status);
        if (terminate)
            return FAULT("terminate", status);
        if (event)
            return FAULT("event", OK);
        if (!early || reached >= end - close)
            return NO_FAULT;
        if (!(reached > now))
            return FAULT("early", status);
        now = reached;
        length = end - now;
    }
    return FAULT("parts", OK);
}

/* Set what was placed, make one step, and get what is given at its end. */
static Fault advance(Engine *e, double step, bool all)
{
    Fault fault = set_inputs(e, all);
    if (fault.what)
        return fault;
    const double time = (double)e->steps * step;
    if (e->fmi == 2) {
        const int status = ((Step2)e->step)(e->instance, time, step, 1);
        if (status > WARNING)
            fault = FAULT("step", status);
    } else {
        fault = step3(e, time, step);
    }
    e->steps++;
    return fault.what ? fault : get_outputs(e);
}

#define SLOT(function) ((void *)(uintptr_t)(function)) /* Python keeps functions as void pointers */

/* --- Log: what an FMU said about its errors --- */

typedef struct {
    PyObject_HEAD
    char text[1024]; /* errors */
    char last[512];  /* the last message that is none: some FMUs say in it why they discard a step */
} Log;

static void append(Log *log, int status, const char *message)
{
    if (!log || !message)
        return;
    if (status < DISCARD) {
        snprintf(log->last, sizeof(log->last), "%s", message);
        return;
    }
    const size_t used = strlen(log->text);
    snprintf(log->text + used, sizeof(log->text) - used, "%s%s", used ? "; " : "", message);
}

static void logger2(void *environment, const char *name, int status, const char *category, const char *format, ...)
{
    (void)name, (void)category;
    char message[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(message, sizeof(message), format ? format : "", arguments);
    va_end(arguments);
    append(environment, status, message);
}

static void logger3(void *environment, int status, const char *category, const char *message)
{
    (void)category;
    append(environment, status, message);
}

static PyObject *log_take(Log *self, PyObject *unused)
{
    (void)unused;
    const char *said = *self->text ? self->text : self->last;
    PyObject *text = PyUnicode_DecodeUTF8(said, (Py_ssize_t)strlen(said), "replace");
    self->text[0] = self->last[0] = '\0';
    return text;
}

static PyObject *log_address(Log *self, void *unused)
{
    (void)unused;
    return PyLong_FromVoidPtr(self);
}

static void plain_dealloc(PyObject *self)
{
    PyTypeObject *type = Py_TYPE(self);
    freefunc release = (freefunc)(uintptr_t)PyType_GetSlot(type, Py_tp_free);
    release(self);
    Py_DECREF(type);
}

static PyMethodDef log_methods[] = {
    {"take", (PyCFunction)log_take, METH_NOARGS, "take() -> str: the error messages since the last call, or else the last message."},
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef log_getset[] = {
    {"address", (getter)log_address, NULL, "What to hand to the FMU as the environment of its logger.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyType_Slot log_slots[] = {
    {Py_tp_doc, "Log(): catches the error messages of one FMU instance and must outlive it."},
    {Py_tp_new, SLOT(PyType_GenericNew)},
    {Py_tp_dealloc, SLOT(plain_dealloc)},
    {Py_tp_methods, log_methods},
    {Py_tp_getset, log_getset},
    {0, NULL},
};

static PyType_Spec log_spec = {"cosim.engine._bank.Log", sizeof(Log), 0, Py_TPFLAGS_DEFAULT, log_slots};

/* --- Bank --- */

typedef struct {
    PyObject_HEAD
    double step; /* s */
    long long next; /* the flight step that comes next; -1 after a failure */
    Py_ssize_t count; /* of stations */
    Engine *engines;  /* by station */
    PyObject *record;           /* the type of what step returns: a tuple of as many tuples as there are outputs */
    PyObject *silent[OUTPUTS];  /* NaN for every engine, where no engine has the output; else NULL */
    int reported[OUTPUTS], reports; /* the outputs that some engine has, thrust first, and how many */
} Bank;

static PyObject *failure_type; /* one module state per process is all that FMUs allow for */

static PyObject *fail(Bank *self, Py_ssize_t index, Fault fault)
{
    self->next = -1;
    PyObject *arguments = Py_BuildValue("(nsis)", index, fault.what, fault.status, fault.port);
    if (arguments) {
        PyErr_SetObject(failure_type, arguments);
        Py_DECREF(arguments);
    }
    return NULL;
}

/* (function, kind, (reference, ...), (value, ...), first references, first values) */
static bool read_block(PyObject *row, Block *b)
{
    PyObject *references, *values;
    unsigned long long call;
    int kind;
    Py_ssize_t first_references, first_values;
    if (!PyTuple_Check(row)) {
        PyErr_SetString(PyExc_TypeError, "a block is a tuple");
        return false;
    }
    if (!PyArg_ParseTuple(row, "KiO!O!nn", &call, &kind, &PyTuple_Type, &references, &PyTuple_Type, &values,
                          &first_references, &first_values))
        return false;
    const Py_ssize_t n = PyTuple_Size(references), m = PyTuple_Size(values);
    if (!call || kind < DOUBLE || kind >= KINDS || m < n || first_references < 0 || first_references > n || first_values < first_references ||
        first_values > m) {
        PyErr_SetString(PyExc_ValueError, "a block needs a function and at least as many values as references");
        return false;
    }
    b->reference = PyMem_Calloc((size_t)n + 1, sizeof(uint32_t));
    b->value = PyMem_Calloc((size_t)m + 1, sizeof(double));
    b->other_value = PyMem_Calloc((size_t)m + 1, sizeof(uint64_t));
    if (!b->reference || !b->value || !b->other_value) {
        PyErr_NoMemory();
        return false;
    }
    b->call = (uintptr_t)call;
    b->kind = (Kind)kind;
    b->references = (size_t)n;
    b->values = (size_t)m;
    b->first_references = (size_t)first_references;
    b->first_values = (size_t)first_values;
    for (Py_ssize_t i = 0; i < n; i++)
        b->reference[i] = (uint32_t)PyLong_AsUnsignedLong(PyTuple_GetItem(references, i));
    for (Py_ssize_t i = 0; i < m; i++)
        b->value[i] = PyFloat_AsDouble(PyTuple_GetItem(values, i));
    return !PyErr_Occurred();
}

/* None, or (block, index, scale, offset, low, high) */
static bool read_place(PyObject *row, const Block blocks[BLOCKS], Place *p)
{
    p->block = -1;
    if (row == Py_None)
        return true;
    Py_ssize_t index;
    if (!PyTuple_Check(row) ||
        !PyArg_ParseTuple(row, "indddd", &p->block, &index, &p->scale, &p->offset, &p->low, &p->high)) {
        if (!PyErr_Occurred())
            PyErr_SetString(PyExc_TypeError, "a place is None or a tuple");
        return false;
    }
    p->index = (size_t)index;
    if (p->block < 0 || p->block >= BLOCKS || index < 0 || p->index >= blocks[p->block].values) {
        PyErr_SetString(PyExc_ValueError, "a place is outside its block");
        return false;
    }
    return true;
}

static bool read_ports(PyObject *inputs, PyObject *outputs, Engine *e)
{
    if (PyTuple_Size(inputs) != INPUTS || PyTuple_Size(outputs) != OUTPUTS + 1) {
        PyErr_SetString(PyExc_ValueError, "an engine needs all its ports");
        return false;
    }
    bool good = true;
    for (int i = 0; good && i < INPUTS; i++)
        good = read_place(PyTuple_GetItem(inputs, i), e->set, &e->input[i]);
    for (int i = 0; good && i < OUTPUTS; i++)
        good = read_place(PyTuple_GetItem(outputs, i), e->get, &e->output[i]);
    good = good && read_place(PyTuple_GetItem(outputs, OUTPUTS), e->get, &e->drag);
    for (int i = PRESSURE; good && i < INPUTS; i++)
        e->has_ambient = e->has_ambient || e->input[i].block >= 0;
    for (int i = BASE; good && i < INPUTS; i++)
        e->has_derived = e->has_derived || e->input[i].block >= 0;
    if (good && (e->input[THROTTLE].block < 0 || e->output[THRUST].block < 0)) {
        PyErr_SetString(PyExc_ValueError, "an engine needs a throttle and a thrust");
        good = false;
    }
    return good;
}

/* (fmi, instance, step, steps done, set blocks, get blocks, inputs, outputs, port values) */
static bool read_engine(PyObject *row, Engine *e)
{
    unsigned long long instance, step;
    PyObject *sets, *gets, *inputs, *outputs;
    if (!PyTuple_Check(row)) {
        PyErr_SetString(PyExc_TypeError, "an instance is a tuple");
        return false;
    }
    if (!PyArg_ParseTuple(row, "iKKLO!O!O!O!(dddd)", &e->fmi, &instance, &step, &e->steps, &PyTuple_Type, &sets,
                          &PyTuple_Type, &gets, &PyTuple_Type, &inputs, &PyTuple_Type, &outputs, &e->port[THROTTLE],
                          &e->port[PRESSURE], &e->port[TEMPERATURE], &e->port[AIR_SPEED]))
        return false;
    if ((e->fmi != 2 && e->fmi != 3) || !instance || !step || PyTuple_Size(sets) > BLOCKS ||
        PyTuple_Size(gets) > BLOCKS) {
        PyErr_SetString(PyExc_ValueError, "an instance needs FMI 2 or 3, an address and a function");
        return false;
    }
    e->instance = (void *)(uintptr_t)instance;
    e->step = (uintptr_t)step;
    e->sets = (int)PyTuple_Size(sets);
    e->gets = (int)PyTuple_Size(gets);
    bool good = true;
    for (int i = 0; good && i < e->sets; i++)
        good = read_block(PyTuple_GetItem(sets, i), &e->set[i]);
    for (int i = 0; good && i < e->gets; i++)
        good = read_block(PyTuple_GetItem(gets, i), &e->get[i]);
    return good && read_ports(inputs, outputs, e);
}

static void free_engines(Engine *engines, Py_ssize_t count)
{
    for (Py_ssize_t i = 0; engines && i < count; i++) {
        for (int j = 0; j < 2 * BLOCKS; j++) {
            Block *b = j < BLOCKS ? &engines[i].set[j] : &engines[i].get[j - BLOCKS];
            PyMem_Free(b->reference);
            PyMem_Free(b->value);
            PyMem_Free(b->other_value);
        }
    }
    PyMem_Free(engines);
}

static void bank_clear(Bank *self)
{
    free_engines(self->engines, self->count);
    self->engines = NULL;
    self->count = 0;
    Py_CLEAR(self->record);
    for (int i = 0; i < OUTPUTS; i++)
        Py_CLEAR(self->silent[i]);
}

/* Which outputs are reported, and the shared tuples of NaN for what no engine reports. */
static bool make_silent(Bank *self)
{
    self->reports = 0;
    for (int i = 0; i < OUTPUTS; i++) {
        bool reported = false;
        for (Py_ssize_t j = 0; j < self->count; j++)
            reported = reported || self->engines[j].output[i].block >= 0;
        if (reported) {
            self->reported[self->reports++] = i;
            continue;
        }
        self->silent[i] = PyTuple_New(self->count);
        for (Py_ssize_t j = 0; self->silent[i] && j < self->count; j++)
            if (PyTuple_SetItem(self->silent[i], j, PyFloat_FromDouble(NAN)) < 0)
                return false;
        if (!self->silent[i])
            return false;
    }
    return true;
}

static int bank_init(Bank *self, PyObject *args, PyObject *kwargs)
{
    (void)kwargs;
    PyObject *given, *record = (PyObject *)&PyTuple_Type;
    double step;
    if (!PyArg_ParseTuple(args, "Od|O!", &given, &step, &PyType_Type, &record))
        return -1;
    if (!PyType_IsSubtype((PyTypeObject *)record, &PyTuple_Type)) {
        PyErr_SetString(PyExc_TypeError, "the record must be a kind of tuple");
        return -1;
    }
    PyObject *rows = PySequence_Tuple(given);
    if (!rows)
        return -1;
    bank_clear(self);
    const Py_ssize_t count = PyTuple_Size(rows);
    self->engines = PyMem_Calloc((size_t)count + 1, sizeof(Engine));
    bool good = self->engines != NULL;
    if (!good)
        PyErr_NoMemory();
    self->count = good ? count : 0;
    self->step = step;
    self->next = 0;
    Py_INCREF(record);
    self->record = record;
    for (Py_ssize_t i = 0; good && i < count; i++)
        good = read_engine(PyTuple_GetItem(rows, i), &self->engines[i]);
    Py_DECREF(rows);
    if (!good) {
        bank_clear(self);
        return -1;
    }
    return make_silent(self) ? 0 : -1;
}

static void bank_dealloc(PyObject *self)
{
    bank_clear((Bank *)self);
    plain_dealloc(self);
}

/* What one engine gives, of what was got: those of the reported outputs, NaN for one that it has not. */
static Fault read_outputs(const Bank *self, const Engine *e, double ports[OUTPUTS])
{
    for (int n = 0; n < self->reports; n++) {
        const int i = self->reported[n];
        const Place *p = &e->output[i];
        ports[i] = NAN;
        if (p->block < 0)
            continue;
        double value = p->scale * e->get[p->block].value[p->index];
        if (p->offset != 0.0)
            value += p->offset;
        if (!isfinite(value))
            return (Fault){"nan", OK, OUTPUT_NAMES[i]};
        ports[i] = value;
    }
    const Place *drag = &e->drag;
    if (drag->block >= 0) {
        ports[THRUST] -= drag->scale * e->get[drag->block].value[drag->index] + drag->offset;
        if (!isfinite(ports[THRUST]))
            return (Fault){"nan", OK, "ram_drag"};
    }
    return NO_FAULT;
}

/* hold(index, throttle, count) -> [thrust, ...] */
static PyObject *bank_hold(Bank *self, PyObject *args)
{
    Py_ssize_t index, count;
    double throttle;
    if (!PyArg_ParseTuple(args, "ndn", &index, &throttle, &count))
        return NULL;
    if (index < 0 || index >= self->count || count < 0) {
        PyErr_SetString(PyExc_IndexError, "hold: no such engine, or a negative count");
        return NULL;
    }
    Engine *e = &self->engines[index];
    PyObject *list = PyList_New(count);
    for (Py_ssize_t i = 0; list && i < count; i++) {
        double ports[OUTPUTS];
        Fault fault = place_throttle(e, throttle);
        if (!fault.what)
            fault = advance(e, self->step, false);
        if (!fault.what)
            fault = read_outputs(self, e, ports);
        PyObject *item = fault.what ? fail(self, index, fault) : PyFloat_FromDouble(ports[THRUST]);
        if (!item || PyList_SetItem(list, i, item) < 0) {
            Py_DECREF(list);
            return NULL;
        }
    }
    return list;
}

/* One empty tuple an output that some engine has, and the shared one for the others. */
static PyObject *new_output(const Bank *self)
{
    PyObject *output = PyTuple_New(OUTPUTS);
    for (int i = 0; output && i < OUTPUTS; i++) {
        PyObject *each = self->silent[i];
        if (each)
            Py_INCREF(each);
        else
            each = PyTuple_New(self->count);
        if (!each || PyTuple_SetItem(output, i, each) < 0) {
            Py_DECREF(output);
            return NULL;
        }
    }
    return output;
}

static bool put_output(const Bank *self, PyObject *output, Py_ssize_t index, const double ports[OUTPUTS])
{
    for (int n = 0; n < self->reports; n++) {
        const int i = self->reported[n];
        PyObject *item = PyFloat_FromDouble(ports[i]);
        if (!item || PyTuple_SetItem(PyTuple_GetItem(output, i), index, item) < 0)
            return false;
    }
    return true;
}

/* The output as the record that was asked for, whose fields it has; takes the reference to ``output``. */
static PyObject *as_record(const Bank *self, PyObject *output)
{
    PyObject *record = PyObject_Call(self->record, output, NULL);
    Py_DECREF(output);
    return record;
}

/* Read what the engine of a station gives into the output; false: an error is set. */
static bool take_outputs(Bank *self, Py_ssize_t station, PyObject *output)
{
    double ports[OUTPUTS];
    const Fault fault = read_outputs(self, &self->engines[station], ports);
    if (fault.what)
        fail(self, station, fault);
    return !fault.what && put_output(self, output, station, ports);
}

/* outputs() -> record */
static PyObject *bank_outputs(Bank *self, PyObject *unused)
{
    (void)unused;
    PyObject *output = new_output(self);
    for (Py_ssize_t i = 0; output && i < self->count; i++) {
        const Fault fault = get_outputs(&self->engines[i]);
        if (fault.what)
            fail(self, i, fault);
        if (fault.what || !take_outputs(self, i, output)) {
            Py_DECREF(output);
            return NULL;
        }
    }
    return output ? as_record(self, output) : NULL;
}

static bool read_air(PyObject *ambient, Py_ssize_t count, double *pressure, double *temperature, PyObject **speeds)
{
    if (!PyTuple_Check(ambient) || PyTuple_Size(ambient) != 3 || !PyTuple_Check(PyTuple_GetItem(ambient, 2)) ||
        PyTuple_Size(PyTuple_GetItem(ambient, 2)) != count) {
        PyErr_Format(PyExc_TypeError, "step: the ambient is pressure, temperature and %zd air speeds, or None", count);
        return false;
    }
    *pressure = PyFloat_AsDouble(PyTuple_GetItem(ambient, 0));
    *temperature = PyFloat_AsDouble(PyTuple_GetItem(ambient, 1));
    *speeds = PyTuple_GetItem(ambient, 2);
    return !PyErr_Occurred();
}

/* Place throttle and ambient, and make the step, of one station; false: an error is set.  The air is pressure,
 * temperature and room for a speed. */
static bool step_engine(Bank *self, Py_ssize_t station, PyObject *throttles, PyObject *speeds, double *air)
{
    Engine *e = &self->engines[station];
    bool changed = false;
    const bool aired = speeds && e->has_ambient;
    const double throttle = PyFloat_AsDouble(PyTuple_GetItem(throttles, station));
    if (aired)
        air[2] = PyFloat_AsDouble(PyTuple_GetItem(speeds, station));
    if ((throttle == -1.0 || air[2] == -1.0) && PyErr_Occurred())
        return false;
    Fault fault = place_throttle(e, throttle);
    if (aired && !fault.what)
        fault = place_ambient(e, air, &changed);
    if (!fault.what)
        fault = advance(e, self->step, changed);
    return fault.what ? fail(self, station, fault) != NULL : true;
}

/* step(k, throttles, ambient) -> record */
static PyObject *bank_step(Bank *self, PyObject *const *args, Py_ssize_t nargs)
{
    if (nargs != 3 || !PyTuple_Check(args[1]) || PyTuple_Size(args[1]) != self->count)
        return PyErr_Format(PyExc_TypeError, "step: needs k, a tuple of %zd throttles and the ambient", self->count);
    const long long k = PyLong_AsLongLong(args[0]);
    if (k == -1 && PyErr_Occurred())
        return NULL;
    if (k != self->next || k < 0)
        return PyErr_Format(PyExc_ValueError, self->next < 0 ? "step %lld after a failure" : "step %lld, but %lld is next", k,
                            self->next);
    double air[BASE - 1] = {0.0};
    PyObject *speeds = NULL;
    if (args[2] != Py_None && !read_air(args[2], self->count, &air[0], &air[1], &speeds))
        return NULL;
    PyObject *output = new_output(self);
    for (Py_ssize_t i = 0; output && i < self->count; i++) {
        if (!step_engine(self, i, args[1], speeds, air) || !take_outputs(self, i, output)) {
            Py_DECREF(output);
            return NULL;
        }
    }
    if (!output)
        return NULL;
    self->next++;
    return as_record(self, output);
}

static PyObject *bank_stop(Bank *self, PyObject *unused)
{
    (void)unused;
    self->next = -1;
    Py_RETURN_NONE;
}

static PyMethodDef bank_methods[] = {
    {"hold", (PyCFunction)bank_hold, METH_VARARGS, "hold(index, throttle, count): step one engine, return its thrusts [N]."},
    {"outputs", (PyCFunction)bank_outputs, METH_NOARGS, "outputs(): what the engines report now."},
    {"step", (PyCFunction)(void (*)(void))bank_step, METH_FASTCALL,
     "step(k, throttles, ambient): flight step k of all engines."},
    {"stop", (PyCFunction)bank_stop, METH_NOARGS, "stop(): an engine failed outside; no step may follow."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot bank_slots[] = {
    {Py_tp_doc, "Bank(engines, step, record): engines are as cosim.engine.fmu.instance.FmuInstance.make_row() makes them."},
    {Py_tp_new, SLOT(PyType_GenericNew)},
    {Py_tp_init, SLOT(bank_init)},
    {Py_tp_dealloc, SLOT(bank_dealloc)},
    {Py_tp_methods, bank_methods},
    {0, NULL},
};

static PyType_Spec bank_spec = {"cosim.engine._bank.Bank", sizeof(Bank), 0, Py_TPFLAGS_DEFAULT, bank_slots};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "cosim.engine._bank", "The loop over the engines.", -1, NULL, NULL, NULL, NULL, NULL,
};

static bool add(PyObject *module, const char *name, PyObject *object)
{
    const bool good = object && PyModule_AddObjectRef(module, name, object) == 0;
    Py_XDECREF(object);
    return good;
}

PyMODINIT_FUNC PyInit__bank(void)
{
    PyObject *module = PyModule_Create(&definition);
    if (!module)
        return NULL;
    failure_type = PyErr_NewException("cosim.engine._bank.FailureError", NULL, NULL);
    Py_XINCREF(failure_type);
    if (!add(module, "FailureError", failure_type) || !add(module, "Log", PyType_FromSpec(&log_spec)) ||
        !add(module, "Bank", PyType_FromSpec(&bank_spec)) ||
        !add(module, "LOGGER2", PyLong_FromVoidPtr((void *)(uintptr_t)logger2)) ||
        !add(module, "LOGGER3", PyLong_FromVoidPtr((void *)(uintptr_t)logger3))) {
        Py_DECREF(module);
        return NULL;
    }
    return module;
}
