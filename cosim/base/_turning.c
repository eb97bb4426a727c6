/* Vectors turned by hinges, and thrust along them: what every control step of a vehicle with jets asks for.
 *
 * The formulas and their order are those of cosim.base.layout.rotate_about, so that both give the same bits.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
#include <stdbool.h>

typedef struct {
    double axis[3], point[3], effect;
    Py_ssize_t number; /* of the hinge */
    bool moves;        /* about an axis through the point; else the vector turns as a direction does */
} Turn;

typedef struct {
    PyObject *vector; /* with all hinges at zero */
    double start[3];
    Py_ssize_t first, count; /* turns, the outermost first */
} Item;

typedef struct {
    PyObject_HEAD
    Py_ssize_t items, turns, angles; /* so many angles are asked for at least */
    Item *item;
    Turn *turn;
} Turning;

static bool three(PyObject *from, double *to)
{
    if (!PyTuple_Check(from) || PyTuple_GET_SIZE(from) != 3) {
        PyErr_SetString(PyExc_TypeError, "vectors are tuples of three floats");
        return false;
    }
    for (int axis = 0; axis < 3; axis++) {
        to[axis] = PyFloat_AsDouble(PyTuple_GET_ITEM(from, axis));
        if (to[axis] == -1.0 && PyErr_Occurred())
            return false;
    }
    return true;
}

static PyObject *vector(double x, double y, double z)
{
    const double value[] = {x, y, z};
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

static void turning_dealloc(Turning *self)
{
    for (Py_ssize_t i = 0; self->item && i < self->items; i++)
        Py_CLEAR(self->item[i].vector);
    PyMem_Free(self->item);
    PyMem_Free(self->turn);
    PyTypeObject *const type = Py_TYPE((PyObject *)self);
    PyObject_Free(self);
    Py_DECREF(type);
}

static bool load_turn(Turning *self, PyObject *stated)
{
    Turn *const t = self->turn + self->turns;
    PyObject *axis, *point;
    if (!PyArg_ParseTuple(stated, "OndO", &axis, &t->number, &t->effect, &point) || !three(axis, t->axis))
        return false;
    t->moves = point != Py_None;
    if (t->moves && !three(point, t->point))
        return false;
    if (t->number < 0) {
        PyErr_SetString(PyExc_ValueError, "Turning: hinges are counted from 0");
        return false;
    }
    if (t->number >= self->angles)
        self->angles = t->number + 1;
    self->turns++;
    return true;
}

static int turning_init(Turning *self, PyObject *args, PyObject *named)
{
    (void)named;
    PyObject *vectors, *chains;
    if (!PyArg_ParseTuple(args, "O!O!", &PyList_Type, &vectors, &PyList_Type, &chains))
        return -1;
    const Py_ssize_t count = PyList_GET_SIZE(vectors);
    if (self->item || PyList_GET_SIZE(chains) != count) {
        PyErr_SetString(PyExc_ValueError, "Turning: made once, of as many chains as vectors");
        return -1;
    }
    Py_ssize_t turns = 0;
    for (Py_ssize_t i = 0; i < count; i++) {
        if (!PyList_Check(PyList_GET_ITEM(chains, i))) {
            PyErr_SetString(PyExc_TypeError, "Turning: a chain is a list");
            return -1;
        }
        turns += PyList_GET_SIZE(PyList_GET_ITEM(chains, i));
    }
    self->item = PyMem_Calloc((size_t)count + 1, sizeof *self->item);
    self->turn = PyMem_Calloc((size_t)turns + 1, sizeof *self->turn);
    if (!self->item || !self->turn) {
        PyErr_NoMemory();
        return -1;
    }
    for (; self->items < count; self->items++) {
        Item *const item = self->item + self->items;
        PyObject *const chain = PyList_GET_ITEM(chains, self->items);
        if (!three(PyList_GET_ITEM(vectors, self->items), item->start))
            return -1;
        item->first = self->turns;
        item->count = PyList_GET_SIZE(chain);
        for (Py_ssize_t i = 0; i < item->count; i++)
            if (!load_turn(self, PyList_GET_ITEM(chain, i)))
                return -1;
        item->vector = Py_NewRef(PyList_GET_ITEM(vectors, self->items));
    }
    return 0;
}

/* v as Turn t leaves it, by Rodrigues' formula */
static void turn(const Turn *t, double angle, double *v)
{
    const double *const a = t->axis, c = cos(angle), s = sin(angle);
    double x = v[0], y = v[1], z = v[2];
    if (t->moves) {
        x -= t->point[0];
        y -= t->point[1];
        z -= t->point[2];
    }
    const double along = (a[0] * x + a[1] * y + a[2] * z) * (1.0 - c);
    v[0] = x * c + (a[1] * z - a[2] * y) * s + a[0] * along;
    v[1] = y * c + (a[2] * x - a[0] * z) * s + a[1] * along;
    v[2] = z * c + (a[0] * y - a[1] * x) * s + a[2] * along;
    if (t->moves)
        for (int axis = 0; axis < 3; axis++)
            v[axis] = t->point[axis] + v[axis];
}

/* turned(angles) */
static PyObject *turning_turned(Turning *self, PyObject *angles)
{
    PyObject *const given = PySequence_Fast(angles, "turned: angles are a sequence of floats");
    if (!given)
        return NULL;
    PyObject *made = NULL;
    if (PySequence_Fast_GET_SIZE(given) < self->angles) {
        PyErr_Format(PyExc_IndexError, "turned: needs %zd angles", self->angles);
        goto done;
    }
    made = PyList_New(self->items);
    for (Py_ssize_t i = 0; made && i < self->items; i++) {
        const Item *const item = self->item + i;
        double v[] = {item->start[0], item->start[1], item->start[2]};
        for (const Turn *t = self->turn + item->first; t < self->turn + item->first + item->count; t++) {
            PyObject *const number = PySequence_Fast_GET_ITEM(given, t->number);
            if (!PyFloat_Check(number) && !PyLong_Check(number)) { /* whose value takes no code that could change the list */
                PyErr_Format(PyExc_TypeError, "turned: angles are numbers, not %s", Py_TYPE(number)->tp_name);
                Py_CLEAR(made);
                goto done;
            }
            const double angle = PyFloat_Check(number) ? PyFloat_AS_DOUBLE(number) : PyLong_AsDouble(number);
            if (angle == -1.0 && PyErr_Occurred()) {
                Py_CLEAR(made);
                goto done;
            }
            turn(t, t->effect * angle, v);
        }
        PyObject *const one = item->count ? vector(v[0], v[1], v[2]) : Py_NewRef(item->vector);
        if (!one)
            Py_CLEAR(made);
        else
            PyList_SET_ITEM(made, i, one);
    }
done:
    Py_DECREF(given);
    return made;
}

/* along(axes, groups, sizes) */
static PyObject *along(PyObject *module, PyObject *const *args, Py_ssize_t given)
{
    (void)module;
    if (given != 3 || !PyList_Check(args[0]) || !PyList_Check(args[1]) || !PyTuple_Check(args[2]))
        return PyErr_Format(PyExc_TypeError, "along: takes a list of axes, a list of groups and a tuple of sizes");
    const Py_ssize_t count = PyList_GET_SIZE(args[1]), axes = PyList_GET_SIZE(args[0]);
    if (PyTuple_GET_SIZE(args[2]) < count)
        return PyErr_Format(PyExc_IndexError, "along: needs %zd sizes", count);
    PyObject *const made = PyList_New(count);
    for (Py_ssize_t i = 0; made && i < count; i++) {
        const Py_ssize_t group = PyLong_AsSsize_t(PyList_GET_ITEM(args[1], i));
        const double size = PyFloat_AsDouble(PyTuple_GET_ITEM(args[2], i));
        double axis[3];
        if ((size == -1.0 || group < 0) && PyErr_Occurred())
            goto failed;
        PyObject *one = NULL;
        /* the last of the same group with the same size is the same object; zeros have signs */
        for (Py_ssize_t j = i; !one && size != 0.0 && j-- > 0;)
            if (PyList_GET_ITEM(args[1], j) == PyList_GET_ITEM(args[1], i)) {
                if (PyFloat_AsDouble(PyTuple_GET_ITEM(args[2], j)) == size)
                    one = Py_NewRef(PyList_GET_ITEM(made, j));
                break;
            }
        if (!one) {
            if (group < 0 || group >= axes) {
                PyErr_SetString(PyExc_IndexError, "along: no such group");
                goto failed;
            }
            if (!three(PyList_GET_ITEM(args[0], group), axis))
                goto failed;
            one = vector(size * axis[0], size * axis[1], size * axis[2]);
        }
        if (!one)
            goto failed;
        PyList_SET_ITEM(made, i, one);
    }
    return made;
failed:
    Py_DECREF(made);
    return NULL;
}

#define CALLED(function) ((PyCFunction)(void (*)(void))(function)) /* as Python keeps functions of several arguments */

static PyMethodDef turning_methods[] = {
    {"turned", (PyCFunction)turning_turned, METH_O,
     "turned(angles): every vector with the hinges at these angles [rad]; one that none turns as it is."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot turning_slots[] = {
    {Py_tp_doc, "Turning(vectors, chains): vectors with all hinges at zero, and for each the hinges that turn it from "
                "the outermost inwards: axis, number, effect, and the point that it turns about, None for a direction."},
    {Py_tp_init, turning_init},
    {Py_tp_dealloc, turning_dealloc},
    {Py_tp_methods, turning_methods},
    {0, NULL},
};

static PyType_Spec turning_spec = {
    "cosim.base._turning.Turning", sizeof(Turning), 0, Py_TPFLAGS_DEFAULT, turning_slots,
};

static PyMethodDef functions[] = {
    {"along", CALLED(along), METH_FASTCALL,
     "along(axes, groups, sizes): each size times the axis of its group; neighbours in a group with one size share one "
     "vector."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "cosim.base._turning", "Vectors turned by hinges.", -1, functions, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__turning(void)
{
    PyObject *const module = PyModule_Create(&definition);
    PyObject *const type = module ? PyType_FromSpec(&turning_spec) : NULL;
    if (!type || PyModule_AddObject(module, "Turning", type) < 0) {
        Py_XDECREF(type);
        Py_XDECREF(module);
        return NULL;
    }
    return module;
}
