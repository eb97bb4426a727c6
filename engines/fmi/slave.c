#include "slave.h"

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef enum { INDEPENDENT, PARAMETER, INPUT, OUTPUT } Causality;

typedef struct {
    const char *name;
    Causality causality;
    Type type;
    size_t offset; /* in Variables */
    double min, max, start;
} Variable;

/* Indexed by value reference; reference 0 is the time. */
static const Variable TABLE[] = {{"time", INDEPENDENT, REAL, 0, -HUGE_VAL, HUGE_VAL, 0.0}, ENGINE_TABLE};
static const uint32_t COUNT = sizeof(TABLE) / sizeof(TABLE[0]);

/* Everything that a saved state holds beside the model's own state. */
typedef struct {
    Mode mode;
    bool stop_defined;
    int64_t steps; /* internal steps since start: time is counted, never accumulated */
    double start, stop;
    Variables values;
} Core;

struct Slave {
    Log log;
    void *environment;
    bool logging;
    Core core;
    void *state;
};

struct Snapshot {
    Core core;
    unsigned char state[]; /* engine_state_size bytes, copied and never looked into */
};

static const double TOLERANCE = 1e-9; /* relative, for times that the importer computed in floating point */

Slave *slave_new(Log log, void *environment, bool logging, const char *resources)
{
    (void)resources;
    Slave *s = calloc(1, sizeof(Slave));
    if (!s)
        return NULL;
    s->state = calloc(1, engine_state_size);
    if (!s->state) {
        free(s);
        return NULL;
    }
    s->log = log;
    s->environment = environment;
    s->logging = logging;
    slave_reset(s);
    return s;
}

void slave_free(Slave *s)
{
    if (s)
        free(s->state);
    free(s);
}

void *slave_environment(const Slave *s) { return s->environment; }

void slave_set_logging(Slave *s, bool logging) { s->logging = logging; }

bool slave_fail(Slave *s, const char *format, ...)
{
    s->core.mode = FAILED;
    if (s->logging && s->log) {
        char message[256];
        va_list arguments;
        va_start(arguments, format);
        vsnprintf(message, sizeof(message), format, arguments);
        va_end(arguments);
        s->log(s->environment, message);
    }
    return false;
}

static const char *mode_name(Mode mode)
{
    switch (mode) {
    case INSTANTIATED:
        return "before initialization";
    case INITIALIZATION:
        return "in initialization mode";
    case STEPPING:
        return "while stepping";
    case TERMINATED:
        return "after termination";
    default:
        return "after an error";
    }
}

bool slave_allows(Slave *s, const char *function, unsigned modes)
{
    if (s->core.mode & modes)
        return true;
    return slave_fail(s, "%s is not allowed %s", function, mode_name(s->core.mode));
}

bool slave_set_experiment(Slave *s, double start, bool stop_defined, double stop)
{
    if (!isfinite(start) || (stop_defined && !(stop >= start)))
        return slave_fail(s, "start time %g s and stop time %g s do not make an interval", start, stop);
    s->core.start = start;
    s->core.stop_defined = stop_defined;
    s->core.stop = stop_defined ? stop : 0.0;
    return true;
}

void slave_enter_initialization(Slave *s) { s->core.mode = INITIALIZATION; }

bool slave_exit_initialization(Slave *s)
{
    engine_start(&s->core.values, s->state);
    s->core.mode = STEPPING;
    return true;
}

void slave_terminate(Slave *s) { s->core.mode = TERMINATED; }

static void store(Slave *s, const Variable *variable, double value)
{
    char *place = (char *)&s->core.values + variable->offset;
    if (variable->type == REAL)
        *(double *)place = value;
    else
        *(int32_t *)place = (int32_t)value;
}

static double load(const Slave *s, const Variable *variable)
{
    const char *place = (const char *)&s->core.values + variable->offset;
    return variable->type == REAL ? *(const double *)place : *(const int32_t *)place;
}

void slave_reset(Slave *s)
{
    memset(&s->core, 0, sizeof(s->core)); /* padding too: saved states are compared byte by byte */
    memset(s->state, 0, engine_state_size);
    s->core.mode = INSTANTIATED;
    for (uint32_t reference = 1; reference < COUNT; reference++)
        store(s, &TABLE[reference], TABLE[reference].start);
}

static const Variable *find(Slave *s, uint32_t reference, Type type)
{
    if (reference >= COUNT) {
        slave_fail(s, "there is no variable with value reference %u", (unsigned)reference);
        return NULL;
    }
    if (TABLE[reference].type != type) {
        slave_fail(s, "%s is not of the type asked for", TABLE[reference].name);
        return NULL;
    }
    return &TABLE[reference];
}

bool slave_get(Slave *s, uint32_t reference, Type type, double *value)
{
    const Variable *variable = find(s, reference, type);
    if (!variable)
        return false;
    if (variable->causality == INDEPENDENT) {
        *value = slave_time(s);
        return true;
    }
    if (variable->causality == OUTPUT && (s->core.mode & (INSTANTIATED | INITIALIZATION)))
        engine_start(&s->core.values, s->state); /* outputs follow the start values while these may change */
    *value = load(s, variable);
    return true;
}

bool slave_set(Slave *s, uint32_t reference, Type type, double value)
{
    const Variable *variable = find(s, reference, type);
    if (!variable)
        return false;
    const bool before_start = s->core.mode & (INSTANTIATED | INITIALIZATION);
    if (variable->causality != INPUT && !(variable->causality == PARAMETER && before_start))
        return slave_fail(s, "%s cannot be set %s", variable->name, mode_name(s->core.mode));
    if (!isfinite(value))
        return slave_fail(s, "%s is not finite", variable->name);
    if (variable->causality == PARAMETER && (value < variable->min || value > variable->max))
        return slave_fail(s, "%s = %.10g is outside %.10g to %.10g", variable->name, value, variable->min, variable->max);
    store(s, variable, value);
    return true;
}

double slave_time(const Slave *s) { return s->core.start + (double)s->core.steps * ENGINE_STEP; }

/* How many internal steps a communication step of `step` from `point` is; 0, after a log line, if it does not fit. */
static int64_t count_steps(Slave *s, double point, double step)
{
    const double here = slave_time(s);
    const double count = floor(step / ENGINE_STEP + 0.5);
    /* what a master that computes its step as a difference of times loses where they are large: half a unit in the last
     * place of either */
    const double lost = DBL_EPSILON * (fabs(here) + fabs(here + count * ENGINE_STEP));
    /* written so that NaN falls through to the error */
    if (!(count >= 1.0 && count <= 1e9 && fabs(step - count * ENGINE_STEP) <= TOLERANCE * step + lost)) {
        slave_fail(s, "communication step %.10g s is not a whole multiple of the internal step %.10g s", step, ENGINE_STEP);
        return 0;
    }
    if (!(fabs(point - here) <= TOLERANCE * fmax(fabs(here), ENGINE_STEP))) {
        slave_fail(s, "communication point %.10g s is not where the engine stands, %.10g s", point, here);
        return 0;
    }
    const double end = s->core.start + ((double)s->core.steps + count) * ENGINE_STEP;
    if (s->core.stop_defined && end - s->core.stop > TOLERANCE * fmax(fabs(end), ENGINE_STEP)) {
        slave_fail(s, "a step to %.10g s passes the stop time %.10g s", end, s->core.stop);
        return 0;
    }
    return (int64_t)count;
}

bool slave_do_step(Slave *s, double point, double step)
{
    const int64_t count = count_steps(s, point, step);
    if (count == 0)
        return false;
    for (int64_t i = 0; i < count; i++)
        engine_step(&s->core.values, s->state);
    s->core.steps += count;
    for (uint32_t reference = 1; reference < COUNT; reference++)
        if (TABLE[reference].causality == OUTPUT && !isfinite(load(s, &TABLE[reference])))
            return slave_fail(s, "%s is not finite at %.10g s", TABLE[reference].name, slave_time(s));
    return true;
}

/* A serialized state is the token of this very build, to refuse the state of another engine, then a snapshot, then a
 * checksum of both: a snapshot that was damaged on its way would have the engine write where it must not. */
static size_t snapshot_size(void) { return offsetof(Snapshot, state) + engine_state_size; }
static size_t summed_size(void) { return sizeof(ENGINE_TOKEN) + snapshot_size(); }

size_t slave_serialized_size(void) { return summed_size() + sizeof(uint64_t); }

/* FNV-1a, 64 bit: draft-eastlake-fnv. */
static uint64_t checksum(const unsigned char *bytes, size_t size)
{
    uint64_t sum = 14695981039346656037u;
    for (size_t i = 0; i < size; i++)
        sum = (sum ^ bytes[i]) * 1099511628211u;
    return sum;
}

static bool allocate(Slave *s, Snapshot **snapshot)
{
    if (!*snapshot)
        *snapshot = calloc(1, snapshot_size());
    return *snapshot || slave_fail(s, "out of memory for a saved state");
}

bool slave_save(Slave *s, Snapshot **snapshot)
{
    if (!allocate(s, snapshot))
        return false;
    memcpy(&(*snapshot)->core, &s->core, sizeof(Core));
    memcpy((*snapshot)->state, s->state, engine_state_size);
    return true;
}

bool slave_restore(Slave *s, const Snapshot *snapshot)
{
    if (!snapshot)
        return slave_fail(s, "there is no saved state to restore");
    memcpy(&s->core, &snapshot->core, sizeof(Core));
    memcpy(s->state, snapshot->state, engine_state_size);
    return true;
}

bool slave_serialize(Slave *s, const Snapshot *snapshot, unsigned char *bytes, size_t size)
{
    if (!snapshot || !bytes || size < slave_serialized_size())
        return slave_fail(s, "a serialized state takes %lu bytes, not %lu", (unsigned long)slave_serialized_size(),
                          (unsigned long)size);
    memcpy(bytes, ENGINE_TOKEN, sizeof(ENGINE_TOKEN));
    memcpy(bytes + sizeof(ENGINE_TOKEN), snapshot, snapshot_size());
    const uint64_t sum = checksum(bytes, summed_size());
    memcpy(bytes + summed_size(), &sum, sizeof(sum));
    return true;
}

bool slave_deserialize(Slave *s, const unsigned char *bytes, size_t size, Snapshot **snapshot)
{
    if (!bytes || size != slave_serialized_size() || memcmp(bytes, ENGINE_TOKEN, sizeof(ENGINE_TOKEN)) != 0)
        return slave_fail(s, "this is not a serialized state of this engine");
    const uint64_t sum = checksum(bytes, summed_size());
    if (memcmp(bytes + summed_size(), &sum, sizeof(sum)) != 0)
        return slave_fail(s, "the serialized state is damaged: its checksum does not fit");
    if (!allocate(s, snapshot))
        return false;
    memcpy(*snapshot, bytes + sizeof(ENGINE_TOKEN), snapshot_size());
    return true;
}
