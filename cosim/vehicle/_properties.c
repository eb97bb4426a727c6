/* Many properties of JSBSim read or written in one call.
 *
 * Each is read or written by the method that JSBSim's Python module has for it, get_double_value and set_double_value.
 * Where that module gives its own functions of the same work away by name (Itanium C++ ABI, as compilers on Linux have
 * it), and a property's pointer stands where Cython puts it, they are called themselves: no float is made and no method
 * looked up.  That is looked at for each property: the object's size, that what the pointer leads to is JSBSim's class
 * by its table of virtual functions, and that both ways read the same bits.  Otherwise the method is called.
 */
#define _GNU_SOURCE
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#ifdef __linux__
#include <dlfcn.h>
#endif

typedef double (*Get)(const void *);
typedef bool (*Set)(void *, double);

/* --- JSBSim's own functions --- */

static struct {
    Get get;
    Set set;
    const char *table; /* of virtual functions: where an object of the class points to */
} own;

/* How Cython keeps an object that holds one C++ pointer and has methods of C. */
typedef struct {
    PyObject_HEAD
    void *methods;
    void *held;
} Holder;

/* use(library): look for JSBSim's own functions in its module's file; whether they are there. */
static PyObject *use(PyObject *module, PyObject *library)
{
    (void)module;
    memset(&own, 0, sizeof own);
#ifdef __linux__
    PyObject *path;
    if (library == Py_None)
        Py_RETURN_FALSE;
    if (!PyUnicode_FSConverter(library, &path))
        return NULL;
    void *const loaded = dlopen(PyBytes_AS_STRING(path), RTLD_LAZY | RTLD_NOLOAD);
    Py_DECREF(path);
    if (loaded) {
        void *const get = dlsym(loaded, "_ZNK14SGPropertyNode14getDoubleValueEv");
        void *const set = dlsym(loaded, "_ZN14SGPropertyNode14setDoubleValueEd");
        void *const table = dlsym(loaded, "_ZTV14SGPropertyNode");
        if (get && set && table) {
            memcpy(&own.get, &get, sizeof get);
            memcpy(&own.set, &set, sizeof set);
            own.table = (const char *)table + 2 * sizeof(void *); /* behind offset and type */
        }
        dlclose(loaded); /* its module keeps it */
    }
#endif
    return PyBool_FromLong(own.get != NULL);
}

/* --- one property --- */

typedef struct {
    PyObject *node, *get, *set; /* the object and its bound methods */
    void *direct;               /* JSBSim's own, or NULL: call the methods */
    Get own_get;
    Set own_set;
} Property;

static bool ask(const Property *p, double *value)
{
    if (p->direct) {
        *value = p->own_get(p->direct);
        return true;
    }
    PyObject *const answer = PyObject_CallNoArgs(p->get);
    if (!answer)
        return false;
    *value = PyFloat_AsDouble(answer);
    Py_DECREF(answer);
    return *value != -1.0 || !PyErr_Occurred();
}

static bool tell(const Property *p, double value)
{
    if (p->direct) {
        p->own_set(p->direct, value);
        return true;
    }
    PyObject *const number = PyFloat_FromDouble(value);
    PyObject *const answer = number ? PyObject_CallOneArg(p->set, number) : NULL;
    Py_XDECREF(number);
    Py_XDECREF(answer);
    return answer != NULL;
}

static bool property(Property *p, PyObject *node)
{
    Py_INCREF(node);
    p->node = node;
    p->get = PyObject_GetAttrString(node, "get_double_value");
    p->set = p->get ? PyObject_GetAttrString(node, "set_double_value") : NULL;
    double value, straight;
    if (!p->set || !ask(p, &value))
        return false;
    if (!own.get || Py_TYPE(node)->tp_basicsize != sizeof(Holder) || Py_TYPE(node)->tp_itemsize)
        return true;
    void *const held = ((Holder *)node)->held;
    if (!held || (uintptr_t)held % sizeof(void *) || *(const char *const *)held != own.table)
        return true;
    straight = own.get(held);
    if (memcmp(&straight, &value, sizeof value) == 0) {
        p->direct = held;
        p->own_get = own.get;
        p->own_set = own.set;
    }
    return true;
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
            Py_CLEAR(self->each[i][axis].node);
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

static PyObject *properties_direct(Properties *self, void *unused)
{
    (void)unused;
    Py_ssize_t count = 0;
    for (Py_ssize_t i = 0; i < self->groups; i++)
        for (int axis = 0; axis < 3; axis++)
            count += self->each[i][axis].direct != NULL;
    return PyLong_FromSsize_t(count);
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

static PyGetSetDef properties_values[] = {
    {"direct", (getter)properties_direct, NULL, "How many of them are reached by JSBSim's own functions.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyType_Slot properties_slots[] = {
    {Py_tp_doc, "Properties(groups, watched=0): groups of three nodes and their unit, whose sum over the first so many "
                "is watched."},
    {Py_tp_init, properties_init},
    {Py_tp_dealloc, properties_dealloc},
    {Py_tp_methods, properties_methods},
    {Py_tp_getset, properties_values},
    {0, NULL},
};

static PyType_Spec properties_spec = {
    "cosim.vehicle._properties.Properties", sizeof(Properties), 0, Py_TPFLAGS_DEFAULT, properties_slots,
};

static PyMethodDef methods[] = {
    {"use", use, METH_O, "use(library): whether JSBSim's module gives its own functions away; None: they are not used."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "cosim.vehicle._properties", "Many properties of JSBSim in one call.", -1, methods,
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
