/* What allocation by effectiveness solves in each step, for Python: effectiveness.h has the equations and their sources.
 *
 * Lists and tuples of floats come in and lists go out; in between no number is an object.  The one implementation, which
 * flies where HEXJET_PURE is set too.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>

typedef double Real;
#define R(x) ((Real)(x))
#define SIN sin
#define COS cos
#define SQRT sqrt
enum { MOST_JETS = 16, MOST_MOVERS = 32, MOST_LINKS = 16 }; /* as cosim.spec.vehicle allows */
#define RANK 1e-20
#define DONE 1e-13
#define LET_GO 1e-9
#define SETTLED 1e-9
#include "effectiveness.h"

/* --- numbers from Python --- */

/* Whether it is a list or tuple of so many items; an exception says what it is otherwise. */
static bool has_items(PyObject *given, Py_ssize_t count, const char *name)
{
    if (!PyList_Check(given) && !PyTuple_Check(given)) {
        PyErr_Format(PyExc_TypeError, "%s: takes a list or a tuple", name);
        return false;
    }
    if (PySequence_Fast_GET_SIZE(given) != count) {
        PyErr_Format(PyExc_ValueError, "%s: has %zd items, must have %zd", name, PySequence_Fast_GET_SIZE(given), count);
        return false;
    }
    return true;
}

/* A float or an int, whose value takes no code of anybody's, which could change the list that it stands in; NaN is
 * refused, infinite ones where `bounded`. */
static bool number_of(PyObject *item, double *to, bool bounded, const char *name)
{
    if (PyFloat_Check(item))
        *to = PyFloat_AS_DOUBLE(item);
    else if (PyLong_Check(item)) {
        *to = PyLong_AsDouble(item);
        if (*to == -1.0 && PyErr_Occurred())
            return false;
    } else {
        PyErr_Format(PyExc_TypeError, "%s: takes numbers, not %s", name, Py_TYPE(item)->tp_name);
        return false;
    }
    if (bounded ? isfinite(*to) : !isnan(*to))
        return true;
    PyObject *const value = PyFloat_FromDouble(*to);
    if (value)
        PyErr_Format(PyExc_ValueError, "%s: %R is not a %snumber", name, value, bounded ? "finite " : "");
    Py_XDECREF(value);
    return false;
}

static bool numbers_of(PyObject *given, Py_ssize_t count, double *to, bool bounded, const char *name)
{
    if (!has_items(given, count, name))
        return false;
    for (Py_ssize_t i = 0; i < count; i++)
        if (!number_of(PySequence_Fast_GET_ITEM(given, i), to + i, bounded, name))
            return false;
    return true;
}

/* So many pairs of a lower and an upper limit. */
static bool limits_of(PyObject *given, Py_ssize_t count, double *low, double *high, const char *name)
{
    if (!has_items(given, count, name))
        return false;
    for (Py_ssize_t i = 0; i < count; i++) {
        PyObject *const pair = PySequence_Fast_GET_ITEM(given, i);
        if (!has_items(pair, 2, name) || !number_of(PySequence_Fast_GET_ITEM(pair, 0), low + i, false, name) ||
            !number_of(PySequence_Fast_GET_ITEM(pair, 1), high + i, false, name))
            return false;
    }
    return true;
}

/* Levels of one row or two, each row once; their number, or -1. */
static int levels_of(PyObject *given, RowLevel *levels, int rows)
{
    bool taken[ROWS] = {false};
    if (!PyList_Check(given) && !PyTuple_Check(given)) {
        PyErr_SetString(PyExc_TypeError, "levels: takes a list or a tuple");
        return -1;
    }
    const Py_ssize_t count = PySequence_Fast_GET_SIZE(given);
    for (Py_ssize_t i = 0; i < count; i++) {
        PyObject *const level = PySequence_Fast_GET_ITEM(given, i);
        const Py_ssize_t size = PyTuple_Check(level) ? PyTuple_GET_SIZE(level) : -1;
        if (i >= ROWS || size < 1 || size > 2) {
            PyErr_SetString(PyExc_ValueError, "levels: takes tuples of one row or two");
            return -1;
        }
        levels[i].rows = (int)size;
        for (int j = 0; j < size; j++) {
            if (!PyLong_Check(PyTuple_GET_ITEM(level, j))) {
                PyErr_SetString(PyExc_TypeError, "levels: rows are whole numbers");
                return -1;
            }
            const long row = PyLong_AsLong(PyTuple_GET_ITEM(level, j));
            if (row == -1 && PyErr_Occurred())
                return -1;
            if (row < 0 || row >= rows || taken[row]) {
                PyErr_Format(PyExc_ValueError, "levels: row %ld is not there, or there twice", row);
                return -1;
            }
            taken[row] = true;
            levels[i].row[j] = (int)row;
        }
    }
    return (int)count;
}

static PyObject *list_of(const double *values, Py_ssize_t count)
{
    PyObject *const made = PyList_New(count);
    for (Py_ssize_t i = 0; made && i < count; i++) {
        PyObject *const number = PyFloat_FromDouble(values[i]);
        if (!number) {
            Py_DECREF(made);
            return NULL;
        }
        PyList_SET_ITEM(made, i, number);
    }
    return made;
}

/* --- a vehicle --- */

typedef struct {
    PyObject_HEAD
    Effectors known;
    Tangent tangent; /* where the last problem ended: it saves work and changes no bit */
} Solver;

static bool vector_of(PyObject *given, Vector *to, const char *name)
{
    double value[3];
    if (!numbers_of(given, 3, value, true, name))
        return false;
    *to = (Vector){value[0], value[1], value[2]};
    return true;
}

/* (place, axis, twist, chain), the chain of (hinge, effect, carries) from the body outwards. */
static bool station_of(PyObject *given, JetStation *jet, int hinges)
{
    PyObject *place, *axis, *chain;
    if (!PyArg_ParseTuple(given, "OOdO!", &place, &axis, &jet->twist, &PyList_Type, &chain) ||
        !vector_of(place, &jet->place, "place") || !vector_of(axis, &jet->axis, "axis"))
        return false;
    const Py_ssize_t links = PyList_GET_SIZE(chain);
    if (links > MOST_LINKS) {
        PyErr_Format(PyExc_ValueError, "chain: has %zd hinges, may have %d", links, MOST_LINKS);
        return false;
    }
    jet->links = (int)links;
    for (int i = 0; i < jet->links; i++) {
        Link *const link = &jet->chain[i];
        int carries;
        if (!PyArg_ParseTuple(PyList_GET_ITEM(chain, i), "idp", &link->hinge, &link->effect, &carries))
            return false;
        link->carries = carries;
        if (link->hinge < 0 || link->hinge >= hinges || (carries && link->effect != 1.0)) {
            PyErr_Format(PyExc_ValueError, "chain: there is no hinge %d, or it carries by another angle", link->hinge);
            return false;
        }
    }
    return true;
}

/* (point, axis, least, most, step, lead) of a hinge, (wrench, least, most, step, lead) of a surface. */
static bool mover_of(PyObject *given, ServoMover *mover, bool hinge)
{
    PyObject *first, *second = NULL;
    const bool good = hinge ? PyArg_ParseTuple(given, "OOdddd", &first, &second, &mover->least, &mover->most,
                                               &mover->step, &mover->lead) &&
            vector_of(first, &mover->point, "point") && vector_of(second, &mover->axis, "axis")
                            : PyArg_ParseTuple(given, "Odddd", &first, &mover->least, &mover->most, &mover->step,
                                               &mover->lead) &&
            numbers_of(first, ROWS, mover->wrench, true, "wrench");
    if (good && !(mover->least < mover->most))
        PyErr_SetString(PyExc_ValueError, "movers: the upper limit must be above the lower one");
    return good && !PyErr_Occurred();
}

static int solver_init(Solver *self, PyObject *args, PyObject *named)
{
    (void)named;
    PyObject *stations, *hinges, *surfaces, *scales, *norms;
    Effectors *const e = &self->known;
    if (!PyArg_ParseTuple(args, "O!O!O!OOdd", &PyList_Type, &stations, &PyList_Type, &hinges, &PyList_Type, &surfaces,
                          &scales, &norms, &e->weight, &e->given))
        return -1;
    const Py_ssize_t jets = PyList_GET_SIZE(stations), turns = PyList_GET_SIZE(hinges);
    const Py_ssize_t movers = turns + PyList_GET_SIZE(surfaces);
    if (jets < 1 || jets > MOST_JETS || movers > MOST_MOVERS) {
        PyErr_Format(PyExc_ValueError, "takes 1 to %d jets, and %d hinges and surfaces at most", MOST_JETS, MOST_MOVERS);
        return -1;
    }
    e->jets = (int)jets;
    e->hinges = (int)turns;
    e->movers = (int)movers;
    for (int i = 0; i < e->jets; i++)
        if (!station_of(PyList_GET_ITEM(stations, i), &e->jet[i], e->hinges))
            return -1;
    for (int i = 0; i < e->movers; i++) {
        const bool hinge = i < e->hinges;
        if (!mover_of(hinge ? PyList_GET_ITEM(hinges, i) : PyList_GET_ITEM(surfaces, i - e->hinges), &e->mover[i], hinge))
            return -1;
    }
    if (!numbers_of(scales, jets + movers, e->scale, true, "scales") || !numbers_of(norms, ROWS, e->norm, true, "norms"))
        return -1;
    for (int j = 0; j < e->jets + e->movers; j++)
        if (!(e->scale[j] > 0.0)) {
            PyErr_SetString(PyExc_ValueError, "scales: must be greater than 0");
            return -1;
        }
    return 0;
}

static void solver_dealloc(Solver *self)
{
    PyTypeObject *const type = Py_TYPE((PyObject *)self);
    PyObject_Free(self);
    Py_DECREF(type);
}

/* solve(wanted, lift, pressure, passes, rated, hurried, last, ends, levels, preferred, reach, stand) */
static PyObject *solver_solve(Solver *self, PyObject *const *args, Py_ssize_t given)
{
    const Effectors *const e = &self->known;
    const int count = e->jets + e->movers;
    Problem p;
    double found[MOST_EFFECTORS], missing[ROWS];
    if (given != 12)
        return PyErr_Format(PyExc_TypeError, "solve: takes 12 arguments");
    const long passes = PyLong_AsLong(args[3]);
    if (passes == -1 && PyErr_Occurred())
        return NULL;
    p.passes = passes > 1000 ? 1000 : (int)passes;
    p.rated = args[4] == Py_True;
    p.hurried = args[5] == Py_True;
    if (!numbers_of(args[0], ROWS, p.wanted, true, "wanted") || !number_of(args[1], &p.lift, true, "lift") ||
        !number_of(args[2], &p.pressure, true, "pressure") || !numbers_of(args[6], count, p.last, true, "last") ||
        !limits_of(args[7], e->jets, p.thrust_low, p.thrust_high, "ends") ||
        (p.levels = levels_of(args[8], p.level, ROWS)) < 0 ||
        !numbers_of(args[9], e->jets, p.preferred, true, "preferred") ||
        !limits_of(args[10], e->movers, p.reach_low, p.reach_high, "reach") ||
        !numbers_of(args[11], e->movers, p.stand, true, "stand"))
        return NULL;
    solve_wrench(e, &self->tangent, &p, found, missing);
    PyObject *const first = list_of(found, count), *const second = first ? list_of(missing, ROWS) : NULL;
    PyObject *const made = second ? PyTuple_Pack(2, first, second) : NULL;
    Py_XDECREF(first);
    Py_XDECREF(second);
    return made;
}

static PyObject *lists_of(Real rows[][MOST_EFFECTORS], int count)
{
    PyObject *const made = PyList_New(ROWS);
    for (int row = 0; made && row < ROWS; row++) {
        PyObject *const list = list_of(rows[row], count);
        if (!list) {
            Py_DECREF(made);
            return NULL;
        }
        PyList_SET_ITEM(made, row, list);
    }
    return made;
}

/* linear(at, pressure) */
static PyObject *solver_linear(Solver *self, PyObject *const *args, Py_ssize_t given)
{
    const Effectors *const e = &self->known;
    const int count = e->jets + e->movers;
    double at[MOST_EFFECTORS], pressure, total[ROWS], rows[ROWS][MOST_EFFECTORS];
    if (given != 2)
        return PyErr_Format(PyExc_TypeError, "linear: takes at and pressure");
    if (!numbers_of(args[0], count, at, true, "at") || !number_of(args[1], &pressure, true, "pressure"))
        return NULL;
    linearise(e, &self->tangent, pressure, at, total, rows);
    PyObject *const first = list_of(total, ROWS), *const second = first ? lists_of(rows, count) : NULL;
    PyObject *const made = second ? PyTuple_Pack(2, first, second) : NULL;
    Py_XDECREF(first);
    Py_XDECREF(second);
    return made;
}

/* pitch_arms(angles) */
static PyObject *solver_pitch_arms(Solver *self, PyObject *angles)
{
    const Effectors *const e = &self->known;
    double angle[MOST_MOVERS], arms[MOST_JETS];
    Turned whole[MOST_MOVERS], turned[MOST_LINKS];
    if (!numbers_of(angles, e->movers, angle, true, "angles"))
        return NULL;
    turn_hinges(e, angle, whole);
    for (int i = 0; i < e->jets; i++) {
        Vector axis, place;
        turn_jet(e, &e->jet[i], angle, whole, turned, &axis, &place);
        arms[i] = place.z * axis.x - place.x * axis.z;
    }
    return list_of(arms, e->jets);
}

/* --- the linear problem alone --- */

/* prioritise(rows, wanted, levels, start, low, high, along_first=False) */
static PyObject *prioritise_rows(PyObject *module, PyObject *const *args, Py_ssize_t given)
{
    (void)module;
    Bounded b;
    RowLevel levels[ROWS];
    double wanted[ROWS], start[MOST_EFFECTORS];
    if (given < 6 || given > 7)
        return PyErr_Format(PyExc_TypeError, "prioritise: takes rows, wanted, levels, start, low, high, along_first");
    for (int i = 0; i < 4; i += 3)
        if (!PyList_Check(args[i]) && !PyTuple_Check(args[i]))
            return PyErr_Format(PyExc_TypeError, "%s: takes a list or a tuple", i ? "start" : "rows");
    const Py_ssize_t rows = PySequence_Fast_GET_SIZE(args[0]), count = PySequence_Fast_GET_SIZE(args[3]);
    if (rows < 1 || rows > ROWS || count < 1 || count > MOST_EFFECTORS)
        return PyErr_Format(PyExc_ValueError, "prioritise: takes 1 to %d rows of 1 to %d effectors", ROWS, MOST_EFFECTORS);
    b.count = (int)count;
    for (Py_ssize_t row = 0; row < rows; row++)
        if (!numbers_of(PySequence_Fast_GET_ITEM(args[0], row), count, b.row[row], true, "rows"))
            return NULL;
    const int number = levels_of(args[2], levels, (int)rows);
    if (number < 0 || !numbers_of(args[1], rows, wanted, true, "wanted") ||
        !numbers_of(args[3], count, start, true, "start") || !numbers_of(args[4], count, b.low, false, "low") ||
        !numbers_of(args[5], count, b.high, false, "high"))
        return NULL;
    for (int i = 0; i < b.count; i++)
        if (b.high[i] < b.low[i])
            return PyErr_Format(PyExc_ValueError, "high: is below low");
    prioritise(&b, start, wanted, levels, number, given == 7 && args[6] == Py_True);
    return list_of(b.x, count);
}

#define CALLED(function) ((PyCFunction)(void (*)(void))(function)) /* as Python keeps functions of several arguments */

static PyMethodDef solver_methods[] = {
    {"solve", CALLED(solver_solve), METH_FASTCALL,
     "solve(wanted, lift, pressure, passes, rated, hurried, last, ends, levels, preferred, reach, stand): thrusts [N] and "
     "angles for a wrench, and what is missing of it."},
    {"linear", CALLED(solver_linear), METH_FASTCALL,
     "linear(at, pressure): the wrench in the order of the rows, and its scaled change by each effector."},
    {"pitch_arms", (PyCFunction)solver_pitch_arms, METH_O,
     "pitch_arms(angles): each jet's pitching moment per thrust [m], its twist left out."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot solver_slots[] = {
    {Py_tp_doc, "Solver(stations, hinges, surfaces, scales, norms, weight, given): a vehicle as allocation knows it."},
    {Py_tp_init, solver_init},
    {Py_tp_dealloc, solver_dealloc},
    {Py_tp_methods, solver_methods},
    {0, NULL},
};

static PyType_Spec solver_spec = {
    "cosim.control.allocation._effectiveness.Solver", sizeof(Solver), 0, Py_TPFLAGS_DEFAULT, solver_slots,
};

static PyMethodDef functions[] = {
    {"prioritise", CALLED(prioritise_rows), METH_FASTCALL,
     "prioritise(rows, wanted, levels, start, low, high, along_first=False): the effectors' values that meet the wanted "
     "rows by priority within the limits."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "cosim.control.allocation._effectiveness", "Allocation by effectiveness.", -1, functions,
    NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__effectiveness(void)
{
    PyObject *const module = PyModule_Create(&definition);
    PyObject *const type = module ? PyType_FromSpec(&solver_spec) : NULL;
    if (!type || PyModule_AddObject(module, "Solver", type) < 0) {
        Py_XDECREF(type);
        Py_XDECREF(module);
        return NULL;
    }
    return module;
}
