/* The loop over the engines: set throttle, do step, get thrust, for all of them in one call from Python.
 *
 * FMPy loads and instantiates the FMUs; what arrives here are instances and function addresses.  Nothing here reads
 * files or formats messages: a failure is raised as FailureError(index, what, status), and Python says it in words.
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
typedef int (*Set3)(void *, const uint32_t[], size_t, const double[], size_t);
typedef int (*Get3)(void *, const uint32_t[], size_t, double[], size_t);
typedef int (*Step3)(void *, double, double, bool, bool *, bool *, bool *, double *);

enum { OK = 0, WARNING = 1, DISCARD = 2 };

typedef struct {
    int fmi; /* 2 or 3 */
    void *instance;
    uintptr_t set, step, get; /* functions */
    uint32_t throttle, thrust; /* value references */
    long long steps;           /* communication steps done, warming up included: FMU time = steps * step */
} Engine;

/* What went wrong; NULL is nothing. */
typedef struct {
    const char *what;
    int status;
} Fault;

static const Fault NO_FAULT = {NULL, OK};

static Fault advance2(Engine *e, double time, double step, double throttle, double *thrust)
{
    int status = ((Set2)e->set)(e->instance, &e->throttle, 1, &throttle);
    if (status > WARNING)
        return (Fault){"set", status};
    status = ((Step2)e->step)(e->instance, time, step, 1);
    if (status > WARNING)
        return (Fault){"step", status};
    status = ((Get2)e->get)(e->instance, &e->thrust, 1, thrust);
    return status > WARNING ? (Fault){"get", status} : NO_FAULT;
}

static Fault advance3(Engine *e, double time, double step, double throttle, double *thrust)
{
    int status = ((Set3)e->set)(e->instance, &e->throttle, 1, &throttle, 1);
    if (status > WARNING)
        return (Fault){"set", status};
    bool event = false, terminate = false, early = false;
    double reached = time + step;
    status = ((Step3)e->step)(e->instance, time, step, true, &event, &terminate, &early, &reached);
    if (status > WARNING)
        return (Fault){"step", status};
    if (terminate)
        return (Fault){"terminate", status};
    if (early)
        return (Fault){"early", status};
    if (event)
        return (Fault){"event", status};
    status = ((Get3)e->get)(e->instance, &e->thrust, 1, thrust, 1);
    return status > WARNING ? (Fault){"get", status} : NO_FAULT;
}

static Fault advance(Engine *e, double step, double throttle, double *thrust)
{
    if (!isfinite(throttle))
        return (Fault){"throttle", OK};
    const double time = (double)e->steps * step;
    const Fault fault =
        e->fmi == 2 ? advance2(e, time, step, throttle, thrust) : advance3(e, time, step, throttle, thrust);
    e->steps++;
    if (!fault.what && !isfinite(*thrust))
        return (Fault){"nan", OK};
    return fault;
}

#define SLOT(function) ((void *)(uintptr_t)(function)) /* Python keeps functions as void pointers */

/* --- Log: what an FMU said about its errors --- */

typedef struct {
    PyObject_HEAD
    char text[1024];
} Log;

static void append(Log *log, int status, const char *message)
{
    if (!log || status < DISCARD || !message)
        return;
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
    PyObject *text = PyUnicode_DecodeUTF8(self->text, (Py_ssize_t)strlen(self->text), "replace");
    self->text[0] = '\0';
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
    {"take", (PyCFunction)log_take, METH_NOARGS, "take() -> str: the error messages since the last call."},
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
    Py_ssize_t count;
    Engine *engines;
} Bank;

static PyObject *failure_type; /* one module state per process is all that FMUs allow for */

static PyObject *fail(Bank *self, Py_ssize_t index, Fault fault)
{
    self->next = -1;
    PyObject *arguments = Py_BuildValue("(nsi)", index, fault.what, fault.status);
    if (arguments) {
        PyErr_SetObject(failure_type, arguments);
        Py_DECREF(arguments);
    }
    return NULL;
}

static bool read_engine(PyObject *row, Engine *e)
{
    unsigned long long instance, set, step, get;
    unsigned int throttle, thrust;
    long long steps;
    PyObject *tuple = PySequence_Tuple(row);
    const bool good = tuple && PyArg_ParseTuple(tuple, "iKKKKIIL", &e->fmi, &instance, &set, &step, &get, &throttle, &thrust,
                                             &steps);
    Py_XDECREF(tuple);
    if (!good)
        return false;
    if ((e->fmi != 2 && e->fmi != 3) || !instance || !set || !step || !get) {
        PyErr_SetString(PyExc_ValueError, "an engine is (2 or 3, instance, set, step, get, throttle, thrust, steps)");
        return false;
    }
    e->instance = (void *)(uintptr_t)instance;
    e->set = (uintptr_t)set;
    e->step = (uintptr_t)step;
    e->get = (uintptr_t)get;
    e->throttle = throttle;
    e->thrust = thrust;
    e->steps = steps;
    return true;
}

static int bank_init(Bank *self, PyObject *args, PyObject *kwargs)
{
    (void)kwargs;
    PyObject *rows;
    double step;
    if (!PyArg_ParseTuple(args, "Od", &rows, &step))
        return -1;
    const Py_ssize_t count = PySequence_Size(rows);
    if (count < 0)
        return -1;
    Engine *engines = PyMem_Calloc((size_t)count + 1, sizeof(Engine));
    if (!engines) {
        PyErr_NoMemory();
        return -1;
    }
    for (Py_ssize_t i = 0; i < count; i++) {
        PyObject *row = PySequence_GetItem(rows, i);
        const bool good = row && read_engine(row, &engines[i]);
        Py_XDECREF(row);
        if (!good) {
            PyMem_Free(engines);
            return -1;
        }
    }
    PyMem_Free(self->engines);
    self->engines = engines;
    self->count = count;
    self->step = step;
    self->next = 0;
    return 0;
}

static void bank_dealloc(PyObject *self)
{
    PyMem_Free(((Bank *)self)->engines);
    plain_dealloc(self);
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
    PyObject *list = PyList_New(count);
    for (Py_ssize_t i = 0; list && i < count; i++) {
        double thrust = NAN;
        const Fault fault = advance(&self->engines[index], self->step, throttle, &thrust);
        PyObject *item = fault.what ? fail(self, index, fault) : PyFloat_FromDouble(thrust);
        if (!item || PyList_SetItem(list, i, item) < 0) {
            Py_DECREF(list);
            return NULL;
        }
    }
    return list;
}

/* step(k, throttles) -> (thrust, ...) */
static PyObject *bank_step(Bank *self, PyObject *const *args, Py_ssize_t nargs)
{
    if (nargs != 2 || !PyTuple_Check(args[1]) || PyTuple_Size(args[1]) != self->count)
        return PyErr_Format(PyExc_TypeError, "step: needs k and a tuple of %zd throttles", self->count);
    const long long k = PyLong_AsLongLong(args[0]);
    if (k == -1 && PyErr_Occurred())
        return NULL;
    if (k != self->next || k < 0)
        return PyErr_Format(PyExc_ValueError, self->next < 0 ? "step %lld after a failure" : "step %lld, but %lld is next", k,
                            self->next);
    PyObject *thrusts = PyTuple_New(self->count);
    for (Py_ssize_t i = 0; thrusts && i < self->count; i++) {
        double thrust = NAN;
        const double throttle = PyFloat_AsDouble(PyTuple_GetItem(args[1], i));
        if (throttle == -1.0 && PyErr_Occurred()) {
            Py_DECREF(thrusts);
            return NULL;
        }
        const Fault fault = advance(&self->engines[i], self->step, throttle, &thrust);
        PyObject *item = fault.what ? fail(self, i, fault) : PyFloat_FromDouble(thrust);
        if (!item || PyTuple_SetItem(thrusts, i, item) < 0) {
            Py_DECREF(thrusts);
            return NULL;
        }
    }
    self->next++;
    return thrusts;
}

static PyMethodDef bank_methods[] = {
    {"hold", (PyCFunction)bank_hold, METH_VARARGS, "hold(index, throttle, count): step one engine, return its thrusts [N]."},
    {"step", (PyCFunction)(void (*)(void))bank_step, METH_FASTCALL, "step(k, throttles): flight step k of all engines."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot bank_slots[] = {
    {Py_tp_doc, "Bank(engines, step): engines are (fmi, instance, set, step, get, throttle, thrust, steps done)."},
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
