/* Many properties of JSBSim read or written in one call, each by the methods that JSBSim's Python module has for it,
 * get_double_value and set_double_value.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdbool.h>

/* --- one property --- */

typedef struct {
    PyObject *get, *set; /* bound methods */
} Property;

static bool ask(const Property *p, double *value)
{
    PyObject *const answer = PyObject_CallNoArgs(p->get);
    if (!answer)
        return false;
    *value = PyFloat_AsDouble(answer);
    Py_DECREF(answer);
    return *value != -1.0 || !PyErr_Occurred();
}

static bool tell(const Property *p, double value)
{
    PyObject *const number = PyFloat_FromDouble(value);
    PyObject *const answer = number ? PyObject_CallOneArg(p->set, number) : NULL;
    Py_XDECREF(number);
    Py_XDECREF(answer);
    return answer != NULL;
}

static bool property(Property *p, PyObject *node)
{
    p->get = PyObject_GetAttrString(node, "get_double_value");
    p->set = p->get ? PyObject_GetAttrString(node, "set_double_value") : NULL;
    return p->set != NULL;
}

/* --- many --- */

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
            Py_CLEAR(self->each[i][axis].get);
            Py_CLEAR(self->each[i][axis].set);
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

/* write(vectors) or write(vectors, old, share) */
static PyObject *properties_write(Properties *self, PyObject *const *args, Py_ssize_t given)
{
    if (given != 1 && given != 3)
        return PyErr_Format(PyExc_TypeError, "write: takes vectors, or vectors, old and share");
    const double share = given == 3 ? PyFloat_AsDouble(args[2]) : 0.0;
    if ((share == -1.0 && PyErr_Occurred()) || !vectors(self, args[0]) || (given == 3 && !vectors(self, args[1])))
        return NULL;
    for (Py_ssize_t i = 0; i < self->groups; i++) {
        double value[3], old[3];
        if (!floats(PyList_GET_ITEM(args[0], i), value))
            return NULL;
        if (given == 3) {
            if (!floats(PyList_GET_ITEM(args[1], i), old))
                return NULL;
            for (int axis = 0; axis < 3; axis++)
                value[axis] += share * (value[axis] - old[axis]);
        }
        /* jets tilt about y, so most vehicles never get there */
        self->sideways = self->sideways || value[1] != 0.0;
        for (int axis = 0; axis < 3; axis++)
            if ((axis != 1 || self->sideways) && !tell(self->each[i] + axis, value[axis] / self->unit[i]))
                return NULL;
    }
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
