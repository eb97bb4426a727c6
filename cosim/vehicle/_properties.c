/* Many properties of JSBSim read or written in one call, each by the methods that JSBSim's Python module has for it,
 * get_double_value and set_double_value.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdbool.h>

/* --- one property --- */

/* A bound method taken apart, to be called without making it again: JSBSim's module has functions of Cython's. */
typedef struct {
    PyObject *bound, *function, *self; /* the last two borrowed from the first; self is NULL where it is not bound */
    vectorcallfunc call;
} Method;

typedef struct {
    Method get, set;
} Property;

static PyObject *call(const Method *m, PyObject *argument)
{
    PyObject *given[] = {m->self, argument};
    PyObject *const *const first = m->self ? given : given + 1;
    return m->call(m->function, first, (m->self != NULL) + (argument != NULL), NULL);
}

static bool ask(const Property *p, double *value)
{
    PyObject *const answer = call(&p->get, NULL);
    if (!answer)
        return false;
    *value = PyFloat_AsDouble(answer);
    Py_DECREF(answer);
    return *value != -1.0 || !PyErr_Occurred();
}

static bool method(Method *m, PyObject *node, const char *name)
{
    m->bound = PyObject_GetAttrString(node, name);
    if (!m->bound)
        return false;
    const bool bound = PyMethod_Check(m->bound);
    m->function = bound ? PyMethod_GET_FUNCTION(m->bound) : m->bound;
    m->self = bound ? PyMethod_GET_SELF(m->bound) : NULL;
    m->call = PyVectorcall_Function(m->function);
    if (!m->call)
        m->call = PyObject_Vectorcall;
    return true;
}

static bool property(Property *p, PyObject *node)
{
    return method(&p->get, node, "get_double_value") && method(&p->set, node, "set_double_value");
}

/* --- many --- */

enum { MOST_KEPT = 4 }; /* vectors of different jets, of the last of which the numbers are at hand */

typedef struct {
    PyObject_HEAD
    Py_ssize_t groups;  /* of three each */
    Py_ssize_t watched; /* the first so many are to be finite */
    Property (*each)[3];
    double *unit; /* SI, of each group */
    bool sideways; /* something written has had a part along y */
} Properties;

static void properties_dealloc(Properties *self)
{
    for (Py_ssize_t i = 0; self->each && i < self->groups; i++)
        for (int axis = 0; axis < 3; axis++) {
            Py_CLEAR(self->each[i][axis].get.bound);
            Py_CLEAR(self->each[i][axis].set.bound);
        }
    PyMem_Free(self->each);
    PyMem_Free(self->unit);
    PyTypeObject *const type = Py_TYPE((PyObject *)self);
    PyObject_Free(self);
    Py_DECREF(type);
}

static int properties_init(Properties *self, PyObject *args, PyObject *named)
{
    (void)named;
    PyObject *groups;
    Py_ssize_t watched = 0;
    if (!PyArg_ParseTuple(args, "O!|n", &PyList_Type, &groups, &watched))
        return -1;
    if (self->each) {
        PyErr_SetString(PyExc_ValueError, "Properties: made once");
        return -1;
    }
    const Py_ssize_t count = PyList_GET_SIZE(groups);
    self->each = PyMem_Calloc((size_t)count + 1, sizeof *self->each);
    self->unit = PyMem_Calloc((size_t)count + 1, sizeof *self->unit);
    if (!self->each || !self->unit) {
        PyErr_NoMemory();
        return -1;
    }
    self->groups = count;
    self->watched = watched < count ? watched : count;
    for (Py_ssize_t i = 0; i < count; i++) {
        PyObject *node[3];
        if (!PyArg_ParseTuple(PyList_GET_ITEM(groups, i), "OOOd", node, node + 1, node + 2, self->unit + i))
            return -1;
        for (int axis = 0; axis < 3; axis++)
            if (!property(self->each[i] + axis, node[axis]))
                return -1;
    }
    return 0;
}

static PyObject *vector(const double *value)
{
    PyObject *const made = PyTuple_New(3);
    for (int axis = 0; made && axis < 3; axis++) {
        PyObject *const number = PyFloat_FromDouble(value[axis]);
        if (!number) {
            Py_DECREF(made);
            return NULL;
        }
        PyTuple_SET_ITEM(made, axis, number);
    }
    return made;
}

static PyObject *properties_read(Properties *self, PyObject *unused)
{
    (void)unused;
    PyObject *const made = PyTuple_New(self->groups);
    double total = 0.0;
    for (Py_ssize_t i = 0; made && i < self->groups; i++) {
        double value[3];
        PyObject *item = NULL;
        bool good = true;
        for (int axis = 0; good && axis < 3; axis++) {
            good = ask(self->each[i] + axis, value + axis);
            if (good) {
                value[axis] *= self->unit[i];
                if (i < self->watched)
                    total += value[axis];
            }
        }
        if (!good || !(item = vector(value))) {
            Py_DECREF(made);
            return NULL;
        }
        PyTuple_SET_ITEM(made, i, item);
    }
    if (made && total - total != 0.0) { /* NaN or infinite */
        Py_DECREF(made);
        Py_RETURN_NONE;
    }
    return made;
}

static bool floats(PyObject *item, double *value)
{
    if (!PyTuple_Check(item) || PyTuple_GET_SIZE(item) != 3) {
        PyErr_SetString(PyExc_TypeError, "write: vectors are tuples of three floats");
        return false;
    }
    for (int axis = 0; axis < 3; axis++) {
        PyObject *const number = PyTuple_GET_ITEM(item, axis);
        value[axis] = PyFloat_CheckExact(number) ? PyFloat_AS_DOUBLE(number) : PyFloat_AsDouble(number);
        if (value[axis] == -1.0 && PyErr_Occurred())
            return false;
    }
    return true;
}

static bool vectors(const Properties *self, PyObject *given)
{
    if (PyList_Check(given) && PyList_GET_SIZE(given) == self->groups)
        return true;
    PyErr_Format(PyExc_TypeError, "write: takes a list of %zd vectors", self->groups);
    return false;
}

/* Whether two groups get the same objects in the same unit, and change from the same. */
static bool alike(const Properties *self, PyObject *const *args, Py_ssize_t given, Py_ssize_t i, Py_ssize_t j)
{
    return self->unit[i] == self->unit[j] && PyList_GET_ITEM(args[0], i) == PyList_GET_ITEM(args[0], j) &&
           (given == 1 || PyList_GET_ITEM(args[1], i) == PyList_GET_ITEM(args[1], j));
}

/* What is written to group ``i``, as numbers in the properties' unit. */
static bool numbers(const Properties *self, PyObject *const *args, Py_ssize_t given, double share, Py_ssize_t i,
                    double *value)
{
    double old[3];
    if (!floats(PyList_GET_ITEM(args[0], i), value))
        return false;
    if (given == 3) {
        if (!floats(PyList_GET_ITEM(args[1], i), old))
            return false;
        for (int axis = 0; axis < 3; axis++)
            value[axis] += share * (value[axis] - old[axis]);
    }
    for (int axis = 0; axis < 3; axis++)
        value[axis] /= self->unit[i];
    return true;
}

/* Three parts to a group, the second only once anything has had one: jets tilt about y, so most vehicles never do. */
static bool tell_all(Properties *self, Py_ssize_t i, PyObject *const *part)
{
    for (int axis = 0; axis < 3; axis++)
        if (axis != 1 || self->sideways) {
            PyObject *const answer = call(&self->each[i][axis].set, part[axis]);
            if (!answer)
                return false;
            Py_DECREF(answer);
        }
    return true;
}

/* write(vectors) or write(vectors, old, share) */
static PyObject *properties_write(Properties *self, PyObject *const *args, Py_ssize_t given)
{
    if (given != 1 && given != 3)
        return PyErr_Format(PyExc_TypeError, "write: takes vectors, or vectors, old and share");
    const double share = given == 3 ? PyFloat_AsDouble(args[2]) : 0.0;
    if ((share == -1.0 && PyErr_Occurred()) || !vectors(self, args[0]) || (given == 3 && !vectors(self, args[1])))
        return NULL;
    PyObject *part[MOST_KEPT][3]; /* of the groups so far: jets at one throttle push with one object */
    Py_ssize_t kept = 0;
    Py_ssize_t from[MOST_KEPT];
    bool good = true;
    for (Py_ssize_t i = 0; good && i < self->groups; i++) {
        Py_ssize_t at = 0;
        while (at < kept && !alike(self, args, given, i, from[at]))
            at++;
        if (at == kept) {
            if (kept == MOST_KEPT) { /* the last makes room */
                at = --kept;
                for (int axis = 0; axis < 3; axis++)
                    Py_DECREF(part[at][axis]);
            }
            double value[3];
            good = numbers(self, args, given, share, i, value);
            if (!good)
                break;
            self->sideways = self->sideways || value[1] != 0.0;
            for (int axis = 0; axis < 3; axis++) {
                part[at][axis] = PyFloat_FromDouble(value[axis]);
                good = good && part[at][axis];
            }
            from[kept++] = i;
        }
        good = good && tell_all(self, i, part[at]);
    }
    while (kept-- > 0)
        for (int axis = 0; axis < 3; axis++)
            Py_XDECREF(part[kept][axis]);
    if (!good)
        return NULL;
    Py_RETURN_NONE;
}

#define CALLED(function) ((PyCFunction)(void (*)(void))(function)) /* as Python keeps functions of several arguments */

static PyMethodDef properties_methods[] = {
    {"read", CALLED(properties_read), METH_NOARGS,
     "read(): each group in SI units; None where the sum of those that are watched is not finite."},
    {"write", CALLED(properties_write), METH_FASTCALL,
     "write(vectors), or write(vectors, old, share) with so much of the change since old on top: a vector in SI units "
     "to each group.  A second part that has always been zero is not written."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot properties_slots[] = {
    {Py_tp_doc, "Properties(groups, watched=0): groups of three nodes and their unit, whose sum over the first so many "
                "is watched."},
    {Py_tp_init, properties_init},
    {Py_tp_dealloc, properties_dealloc},
    {Py_tp_methods, properties_methods},
    {0, NULL},
};

static PyType_Spec properties_spec = {
    "cosim.vehicle._properties.Properties", sizeof(Properties), 0, Py_TPFLAGS_DEFAULT, properties_slots,
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "cosim.vehicle._properties", "Many properties of JSBSim in one call.", -1, NULL,
    NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__properties(void)
{
    PyObject *const module = PyModule_Create(&definition);
    PyObject *const type = module ? PyType_FromSpec(&properties_spec) : NULL;
    if (!type || PyModule_AddObject(module, "Properties", type) < 0) {
        Py_XDECREF(type);
        Py_XDECREF(module);
        return NULL;
    }
    return module;
}
