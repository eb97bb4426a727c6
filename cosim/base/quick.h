/* What mypyc's C asks Python for again and again in a step, asked for once.
 *
 * Included behind mypyc's own headers, and in front of the functions that it made of the modules.  Each macro has the
 * name of the function that it answers for, does the same work where nothing has changed since it was done before, and
 * calls that function otherwise.
 */
#ifndef COSIM_QUICK_H
#define COSIM_QUICK_H

#include <Python.h>

#if defined(__GNUC__) && !defined(Py_GIL_DISABLED)

/* A float is no call away. */
static inline double quick_double(PyObject *number)
{
    return PyFloat_CheckExact(number) ? PyFloat_AS_DOUBLE(number) : PyFloat_AsDouble(number);
}
#define PyFloat_AsDouble(number) quick_double(number)

/* What has a vectorcall is called by it.  That it answers NULL with an error, and only then, is not looked at. */
static inline PyObject *quick_call(PyObject *function, PyObject *const *args, size_t count, PyObject *names)
{
    PyTypeObject *const type = Py_TYPE(function);
    if (PyType_HasFeature(type, Py_TPFLAGS_HAVE_VECTORCALL)) {
        const vectorcallfunc call = *(const vectorcallfunc *)((const char *)function + type->tp_vectorcall_offset);
        if (call)
            return call(function, args, count, names);
    }
    return PyObject_Vectorcall(function, args, count, names);
}
#define PyObject_Vectorcall(function, args, count, names) quick_call(function, args, count, names)

#if PY_VERSION_HEX < 0x030C0000 /* Python 3.12 has deprecated the version of a dict (PEP 699) */

/* A name of a module, by the version of its dict, which every change makes another one (PEP 509).  The name is held: at
 * the address of one that is gone another could stand. */
typedef struct {
    uint64_t version;
    PyObject *name, *value; /* the value is the dict's */
} QuickName;

static __attribute__((noinline)) PyObject *quick_look_in(QuickName *last, PyObject *names, PyObject *name)
{
    const uint64_t version = ((PyDictObject *)names)->ma_version_tag;
    PyObject *const value = CPyDict_GetItem(names, name);
    if (value && PyUnicode_CheckExact(name) && version == ((PyDictObject *)names)->ma_version_tag) {
        PyObject *const before = last->name;
        Py_INCREF(name);
        *last = (QuickName){version, name, value};
        Py_XDECREF(before);
    }
    return value;
}

static inline PyObject *quick_name(QuickName *last, PyObject *names, PyObject *name)
{
    if (!PyDict_CheckExact(names))
        return CPyDict_GetItem(names, name);
    if (((PyDictObject *)names)->ma_version_tag != last->version || name != last->name)
        return quick_look_in(last, names, name);
    Py_INCREF(last->value);
    return last->value;
}
#define CPyDict_GetItem(names, name) ({ static QuickName last; quick_name(&last, names, name); })

/* A method, by the version of its type, which every change of it or of what it inherits makes another one.  An object
 * with a dict of its own could have another method in there. */
typedef struct {
    PyTypeObject *type; /* only its address is looked at */
    unsigned int version;
    PyObject *method; /* the type's */
    vectorcallfunc call;
} QuickMethod;

static inline bool quick_known(const QuickMethod *last, PyTypeObject *type)
{
    return type == last->type && PyType_HasFeature(type, Py_TPFLAGS_VALID_VERSION_TAG) &&
           type->tp_version_tag == last->version;
}

static __attribute__((noinline)) void quick_look_up(QuickMethod *last, PyTypeObject *type, PyObject *name)
{
    last->type = NULL;
    if (type->tp_dictoffset || type->tp_getattro != PyObject_GenericGetAttr)
        return;
    PyObject *const method = _PyType_Lookup(type, name); /* borrowed */
    if (!method || !PyType_HasFeature(Py_TYPE(method), Py_TPFLAGS_METHOD_DESCRIPTOR) ||
        !PyType_HasFeature(type, Py_TPFLAGS_VALID_VERSION_TAG))
        return;
    const vectorcallfunc call = PyVectorcall_Function(method);
    if (call)
        *last = (QuickMethod){type, type->tp_version_tag, method, call};
}

static inline PyObject *quick_method(QuickMethod *last, PyObject *name, PyObject *const *args, size_t count,
                                     PyObject *names)
{
    PyTypeObject *const type = Py_TYPE(args[0]);
    if (!quick_known(last, type)) {
        quick_look_up(last, type, name);
        if (!last->type)
            return PyObject_VectorcallMethod(name, args, count, names);
    }
    PyObject *const method = last->method;
    Py_INCREF(method); /* whoever is called may replace it */
    PyObject *const answer = last->call(method, args, count & ~PY_VECTORCALL_ARGUMENTS_OFFSET, names);
    Py_DECREF(method);
    return answer;
}
#define PyObject_VectorcallMethod(name, args, count, names) \
    ({ static QuickMethod last; quick_method(&last, name, args, count, names); })

#endif
#endif
#endif
