/* Records made in one go: a named tuple called with all its fields in order skips its __new__, which is Python.
 *
 * A type's own vectorcall serves type(...) and is not inherited; whatever is not all fields in order goes the way it
 * always went.  https://docs.python.org/3/c-api/typeobj.html#c.PyTypeObject.tp_vectorcall
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

static PyObject *usual_way(PyObject *type, PyObject *const *args, size_t nargsf, PyObject *names)
{
    const Py_ssize_t count = PyVectorcall_NARGS(nargsf);
    PyObject *given = PyTuple_New(count), *named = names ? PyDict_New() : NULL, *made = NULL;
    if (!given || (names && !named))
        goto done;
    for (Py_ssize_t i = 0; i < count; i++) {
        Py_INCREF(args[i]);
        PyTuple_SET_ITEM(given, i, args[i]);
    }
    for (Py_ssize_t i = 0; names && i < PyTuple_GET_SIZE(names); i++)
        if (PyDict_SetItem(named, PyTuple_GET_ITEM(names, i), args[count + i]) < 0)
            goto done;
    made = PyType_Type.tp_call(type, given, named);
done:
    Py_XDECREF(given);
    Py_XDECREF(named);
    return made;
}

static inline PyObject *make(PyObject *type, PyObject *const *args, size_t nargsf, PyObject *names, Py_ssize_t fields)
{
    if (names || PyVectorcall_NARGS(nargsf) != fields)
        return usual_way(type, args, nargsf, names);
    PyObject *record = ((PyTypeObject *)type)->tp_alloc((PyTypeObject *)type, fields);
    if (!record)
        return NULL;
#if PY_VERSION_HEX >= 0x030E0000
    ((PyTupleObject *)record)->ob_hash = -1; /* not computed yet */
#endif
    for (Py_ssize_t i = 0; i < fields; i++) {
        Py_INCREF(args[i]);
        PyTuple_SET_ITEM(record, i, args[i]);
    }
    return record;
}

/* One function a number of fields: a type has no room to keep that number, and to look it up would cost more. */
#define EACH(X) X(1) X(2) X(3) X(4) X(5) X(6) X(7) X(8) X(9) X(10) X(11) X(12) X(13) X(14) X(15) X(16) X(17) X(18) \
    X(19) X(20) X(21) X(22) X(23) X(24)
#define MAKE(n) \
    static PyObject *make_##n(PyObject *type, PyObject *const *args, size_t nargsf, PyObject *names) \
    { \
        return make(type, args, nargsf, names, n); \
    }
EACH(MAKE)
#define NAME(n) make_##n,
static const vectorcallfunc MAKERS[] = {NULL, EACH(NAME)};

static PyObject *quick(PyObject *module, PyObject *type)
{
    (void)module;
    if (!PyType_Check(type) || ((PyTypeObject *)type)->tp_base != &PyTuple_Type ||
        ((PyTypeObject *)type)->tp_basicsize != PyTuple_Type.tp_basicsize)
        return PyErr_Format(PyExc_TypeError, "quick: %R is not a named tuple", type);
    PyObject *fields = PyObject_GetAttrString(type, "_fields");
    const Py_ssize_t count = fields ? PyObject_Size(fields) : -1;
    Py_XDECREF(fields);
    if (count < 0)
        return NULL;
    if (count == 0 || count >= (Py_ssize_t)(sizeof(MAKERS) / sizeof(MAKERS[0])))
        return PyErr_Format(PyExc_TypeError, "quick: %R has %zd fields, 1 to 24 are provided for", type, count);
    ((PyTypeObject *)type)->tp_vectorcall = MAKERS[count];
    Py_INCREF(type);
    return type;
}

static PyMethodDef methods[] = {
    {"quick", quick, METH_O, "quick(type): make the named tuple's records at once when all fields are given in order."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "cosim.base._records", "Named tuples made in one go.", -1, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__records(void) { return PyModule_Create(&definition); }
