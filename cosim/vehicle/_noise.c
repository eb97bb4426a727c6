/* What the sensors make of a state, noise, bias and the gyro's filter in one go.
 *
 * It is SensorSuite.sample in cosim/vehicle/sensors.py for sensors without resolution and without an AHRS's lean, in the
 * same order of operations, so that the bits are the same; a test holds one against the other.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
#include <stdbool.h>
#include <string.h>

/* places of a state, cosim.base.signals.State */
enum { POSITION = 0, VELOCITY = 1, ATTITUDE = 2, RATE = 4, FORCE = 5, ALTITUDE = 6, FIELDS = 12 };
enum { DRAWS = 13, FORCE_DRAWS = 3 }; /* standard normals a step */

typedef struct {
    double gyro, attitude, position, velocity, height, force;     /* standard deviations */
    double gyro_bias[3], attitude_bias[3], height_bias, force_bias[3];
    double share; /* of the gyro's filter */
} Settings;

typedef struct {
    PyObject_HEAD
    Settings is;
    Py_buffer draws, force_draws;
    Py_ssize_t rows, row;
} Noise;

static void forget(Noise *self)
{
    PyBuffer_Release(&self->draws); /* does nothing to one that is released */
    PyBuffer_Release(&self->force_draws);
    self->rows = self->row = 0;
}

static void noise_dealloc(Noise *self)
{
    forget(self);
    PyTypeObject *const type = Py_TYPE((PyObject *)self);
    PyObject_Free(self);
    Py_DECREF(type);
}

static int noise_init(Noise *self, PyObject *args, PyObject *named)
{
    (void)named;
    Settings *const is = &self->is;
    double *const g = is->gyro_bias, *const a = is->attitude_bias, *const f = is->force_bias;
    return PyArg_ParseTuple(args, "(d(ddd))(d(ddd))(dd)(dd)(d(ddd))d", &is->gyro, g, g + 1, g + 2, &is->attitude, a, a + 1,
                            a + 2, &is->position, &is->velocity, &is->height, &is->height_bias, &is->force, f, f + 1, f + 2,
                            &is->share)
               ? 0
               : -1;
}

static bool view(PyObject *given, Py_ssize_t columns, Py_buffer *to)
{
    if (PyObject_GetBuffer(given, to, PyBUF_FORMAT | PyBUF_C_CONTIGUOUS) < 0)
        return false;
    if (to->ndim == 2 && to->shape[1] == columns && to->format && strcmp(to->format, "d") == 0)
        return true;
    PyErr_Format(PyExc_ValueError, "fill: needs float64 of %zd columns", columns);
    return false;
}

/* fill(draws, force_draws) */
static PyObject *noise_fill(Noise *self, PyObject *const *args, Py_ssize_t given)
{
    forget(self);
    if (given != 2)
        return PyErr_Format(PyExc_TypeError, "fill: takes draws and those of the accelerometer");
    if (!view(args[0], DRAWS, &self->draws) || !view(args[1], FORCE_DRAWS, &self->force_draws))
        return NULL;
    if (self->draws.shape[0] != self->force_draws.shape[0])
        return PyErr_Format(PyExc_ValueError, "fill: needs as many rows of both");
    self->rows = self->draws.shape[0];
    Py_RETURN_NONE;
}

static bool read_floats(PyObject *item, Py_ssize_t count, double *to)
{
    if (!PyTuple_Check(item) || PyTuple_GET_SIZE(item) != count) {
        PyErr_Format(PyExc_TypeError, "sample: not %zd floats", count);
        return false;
    }
    for (Py_ssize_t i = 0; i < count; i++) {
        PyObject *const number = PyTuple_GET_ITEM(item, i);
        to[i] = PyFloat_CheckExact(number) ? PyFloat_AS_DOUBLE(number) : PyFloat_AsDouble(number);
        if (to[i] == -1.0 && PyErr_Occurred())
            return false;
    }
    return true;
}

static PyObject *made(const double *value, Py_ssize_t count)
{
    PyObject *const tuple = PyTuple_New(count);
    for (Py_ssize_t i = 0; tuple && i < count; i++) {
        PyObject *const number = PyFloat_FromDouble(value[i]);
        if (!number) {
            Py_DECREF(tuple);
            return NULL;
        }
        PyTuple_SET_ITEM(tuple, i, number);
    }
    return tuple;
}

/* The attitude turned by small angles [rad], normalized: as cosim.base.frames has product and norm. */
static bool turn(double *q, double bx, double by, double bz)
{
    const double aw = q[0], ax = q[1], ay = q[2], az = q[3], bw = 1.0;
    const double w = aw * bw - ax * bx - ay * by - az * bz, x = aw * bx + ax * bw + ay * bz - az * by,
                 y = aw * by - ax * bz + ay * bw + az * bx, z = aw * bz + ax * by - ay * bx + az * bw;
    const double norm = sqrt(w * w + x * x + y * y + z * z);
    if (norm == 0.0) {
        PyErr_SetString(PyExc_ZeroDivisionError, "float division by zero");
        return false;
    }
    const double scale = 1.0 / norm;
    q[0] = w * scale, q[1] = x * scale, q[2] = y * scale, q[3] = z * scale;
    return true;
}

static bool read_state(PyObject *state, PyObject *filtered, bool fix, double *rate, double *was, double *attitude,
                       double *altitude, double *force, double *place)
{
    if (!PyTuple_Check(state) || PyTuple_GET_SIZE(state) != FIELDS) {
        PyErr_SetString(PyExc_TypeError, "sample: takes a state");
        return false;
    }
    *altitude = PyFloat_AsDouble(PyTuple_GET_ITEM(state, ALTITUDE));
    return !(*altitude == -1.0 && PyErr_Occurred()) && read_floats(PyTuple_GET_ITEM(state, RATE), 3, rate) &&
           read_floats(filtered, 3, was) && read_floats(PyTuple_GET_ITEM(state, ATTITUDE), 4, attitude) &&
           read_floats(PyTuple_GET_ITEM(state, FORCE), 3, force) &&
           (!fix || (read_floats(PyTuple_GET_ITEM(state, POSITION), 3, place) &&
                     read_floats(PyTuple_GET_ITEM(state, VELOCITY), 3, place + 3)));
}

/* sample(state, filtered, fix) */
static PyObject *noise_sample(Noise *self, PyObject *const *args, Py_ssize_t given)
{
    if (given != 3 || self->row >= self->rows)
        return PyErr_Format(PyExc_TypeError, "sample: takes state, filtered rate and whether there is a fix, while there are draws");
    const Settings *const is = &self->is;
    const bool fix = args[2] == Py_True;
    double rate[3], was[3], attitude[4], altitude, force[3], place[6];
    if (!read_state(args[0], args[1], fix, rate, was, attitude, &altitude, force, place))
        return NULL;
    const double *const n = (const double *)self->draws.buf + self->row * DRAWS;
    const double *const m = (const double *)self->force_draws.buf + self->row * FORCE_DRAWS;
    self->row++;
    for (int i = 0; i < 3; i++) {
        force[i] = force[i] + is->force * m[i] + is->force_bias[i];
        rate[i] += is->gyro * n[i] + is->gyro_bias[i];
        rate[i] = was[i] + is->share * (rate[i] - was[i]);
    }
    const double s = 0.5 * is->attitude;
    const double *const a = is->attitude_bias;
    if (!turn(attitude, s * n[3] + 0.5 * a[0], s * n[4] + 0.5 * a[1], s * n[5] + 0.5 * a[2]))
        return NULL;
    altitude += is->height * n[12] + is->height_bias;
    for (int i = 0; fix && i < 3; i++) {
        place[i] = place[i] + is->position * n[6 + i];
        place[3 + i] = place[3 + i] + is->velocity * n[9 + i];
    }
    PyObject *const answer = PyTuple_New(6);
    if (!answer)
        return NULL;
    PyObject *const part[] = {made(rate, 3), made(attitude, 4), fix ? made(place, 3) : Py_NewRef(Py_None),
                              fix ? made(place + 3, 3) : Py_NewRef(Py_None), PyFloat_FromDouble(altitude), made(force, 3)};
    bool good = true;
    for (int i = 0; i < 6; i++) {
        good = good && part[i];
        PyTuple_SET_ITEM(answer, i, part[i]);
    }
    if (!good)
        Py_DECREF(answer);
    return good ? answer : NULL;
}

static PyObject *noise_left(Noise *self, void *unused)
{
    (void)unused;
    return PyLong_FromSsize_t(self->rows - self->row);
}

#define CALLED(function) ((PyCFunction)(void (*)(void))(function)) /* as Python keeps functions of several arguments */

static PyMethodDef noise_methods[] = {
    {"fill", CALLED(noise_fill), METH_FASTCALL, "fill(draws, force_draws): a row of standard normals for each step to come."},
    {"sample", CALLED(noise_sample), METH_FASTCALL,
     "sample(state, filtered, fix): filtered rate, attitude, position and velocity (None without a fix), height, force."},
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef noise_properties[] = {
    {"left", (getter)noise_left, NULL, "Steps for which there are draws.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyType_Slot noise_slots[] = {
    {Py_tp_doc, "Noise(gyro, attitude, gnss, height, force, share): standard deviation with bias of each, GNSS those of "
                "place and velocity; share of the gyro's filter."},
    {Py_tp_init, noise_init},
    {Py_tp_dealloc, noise_dealloc},
    {Py_tp_methods, noise_methods},
    {Py_tp_getset, noise_properties},
    {0, NULL},
};

static PyType_Spec noise_spec = {
    "cosim.vehicle._noise.Noise", sizeof(Noise), 0, Py_TPFLAGS_DEFAULT, noise_slots,
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "cosim.vehicle._noise", "Noise, bias and filter of the sensors.", -1, NULL, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__noise(void)
{
    PyObject *const module = PyModule_Create(&definition);
    PyObject *const type = module ? PyType_FromSpec(&noise_spec) : NULL;
    if (!type || PyModule_AddObject(module, "Noise", type) < 0) {
        Py_XDECREF(type);
        Py_XDECREF(module);
        return NULL;
    }
    return module;
}
