/* Records made in one go, and what somebody else's code answers looked at in one go.
 *
 * A named tuple called with all its fields in order skips its __new__, which is Python.  A type's own vectorcall serves
 * type(...) and is not inherited; whatever is not all fields in order goes the way it always went.
 * https://docs.python.org/3/c-api/typeobj.html#c.PyTypeObject.tp_vectorcall
 *
 * A step makes as many records as the one before it lets go of.  So the memory of some is kept, as Python keeps that of
 * its own tuples, for the next with as many fields.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdbool.h>
#include <string.h>

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

enum { MOST_FIELDS = 24, MOST_KEPT = 8 };

/* Records without type and fields, by how many fields they have room for. */
static struct {
    int count;
    PyObject *record[MOST_KEPT];
} kept[MOST_FIELDS + 1];

/* What a record of a type that is quick itself, not of one that inherits, is freed by. */
static void let_go(PyObject *record)
{
    PyTypeObject *const type = Py_TYPE(record);
    const Py_ssize_t fields = Py_SIZE(record);
    PyObject_GC_UnTrack(record);
    for (Py_ssize_t i = fields; i-- > 0;)
        Py_XDECREF(PyTuple_GET_ITEM(record, i));
#ifndef Py_GIL_DISABLED
    if (type->tp_dealloc == let_go && fields <= MOST_FIELDS && kept[fields].count < MOST_KEPT)
        kept[fields].record[kept[fields].count++] = record;
    else
#endif
        type->tp_free(record);
    Py_DECREF(type);
}

static inline PyObject *make(PyObject *type, PyObject *const *args, size_t nargsf, PyObject *names, Py_ssize_t fields)
{
    if (names || PyVectorcall_NARGS(nargsf) != fields)
        return usual_way(type, args, nargsf, names);
    const bool again = kept[fields].count > 0;
    PyObject *record;
    if (again)
        record = (PyObject *)PyObject_InitVar((PyVarObject *)kept[fields].record[--kept[fields].count],
                                              (PyTypeObject *)type, fields);
    else
        record = ((PyTypeObject *)type)->tp_alloc((PyTypeObject *)type, fields);
    if (!record)
        return NULL;
#if PY_VERSION_HEX >= 0x030E0000
    ((PyTupleObject *)record)->ob_hash = -1; /* not computed yet */
#endif
    for (Py_ssize_t i = 0; i < fields; i++) {
        Py_INCREF(args[i]);
        PyTuple_SET_ITEM(record, i, args[i]);
    }
    if (again)
        PyObject_GC_Track(record);
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
    if (count == 0 || count > MOST_FIELDS)
        return PyErr_Format(PyExc_TypeError, "quick: %R has %zd fields, 1 to %d are provided for", type, count,
                            MOST_FIELDS);
    ((PyTypeObject *)type)->tp_vectorcall = MAKERS[count];
    ((PyTypeObject *)type)->tp_dealloc = let_go;
    Py_INCREF(type);
    return type;
}

enum { MOST_NUMBERS = 64 };

/* So many floats of a tuple or a list; false where one is anything else. ``same``: it is a tuple of them already. */
static bool read_items(PyObject *given, Py_ssize_t count, double *to, bool *same)
{
    if (PySequence_Fast_GET_SIZE(given) != count)
        return false;
    PyObject *const *const items = PySequence_Fast_ITEMS(given);
    *same = PyTuple_CheckExact(given);
    for (Py_ssize_t i = 0; i < count; i++) {
        if (!PyFloat_Check(items[i]))
            return false;
        *same = *same && PyFloat_CheckExact(items[i]);
        to[i] = PyFloat_AS_DOUBLE(items[i]);
    }
    return true;
}

/* So many numbers of an array of float64. */
static bool read_array(PyObject *given, Py_ssize_t count, double *to)
{
    Py_buffer view;
    if (!PyObject_CheckBuffer(given))
        return false;
    if (PyObject_GetBuffer(given, &view, PyBUF_FORMAT | PyBUF_C_CONTIGUOUS) < 0) {
        PyErr_Clear(); /* an array that is not contiguous, say */
        return false;
    }
    const bool good = view.ndim == 1 && view.shape[0] == count && view.format && strcmp(view.format, "d") == 0;
    if (good)
        memcpy(to, view.buf, (size_t)count * sizeof(double));
    PyBuffer_Release(&view);
    return good;
}

/* within(values, count, low, high) */
static PyObject *within(PyObject *module, PyObject *const *args, Py_ssize_t given)
{
    (void)module;
    if (given != 4)
        return PyErr_Format(PyExc_TypeError, "within: takes values, count, low and high");
    PyObject *const values = args[0];
    const Py_ssize_t count = PyLong_AsSsize_t(args[1]);
    const double low = PyFloat_AsDouble(args[2]), high = PyFloat_AsDouble(args[3]);
    double numbers[MOST_NUMBERS];
    bool same = false;
    if (PyErr_Occurred())
        return NULL;
    if (count < 0 || count > MOST_NUMBERS)
        Py_RETURN_NONE;
    const bool items = PyTuple_Check(values) || PyList_CheckExact(values);
    if (items ? !read_items(values, count, numbers, &same) : !read_array(values, count, numbers))
        Py_RETURN_NONE;
    for (Py_ssize_t i = 0; i < count; i++)
        if (!(low <= numbers[i] && numbers[i] <= high)) /* NaN is not */
            Py_RETURN_NONE;
    if (same) {
        Py_INCREF(values);
        return values;
    }
    PyObject *made = PyTuple_New(count);
    for (Py_ssize_t i = 0; made && i < count; i++) {
        PyObject *number = PyFloat_FromDouble(numbers[i]);
        if (number)
            PyTuple_SET_ITEM(made, i, number);
        else
            Py_CLEAR(made);
    }
    return made;
}

#define CALLED(function) ((PyCFunction)(void (*)(void))(function)) /* as Python keeps functions of several arguments */

static PyMethodDef methods[] = {
    {"within", CALLED(within), METH_FASTCALL,
     "within(values, count, low, high): the values as a tuple of so many floats from low to high, or None."},
    {"quick", quick, METH_O, "quick(type): make the named tuple's records at once when all fields are given in order."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "cosim.base._records", "Named tuples made in one go.", -1, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__records(void) { return PyModule_Create(&definition); }
