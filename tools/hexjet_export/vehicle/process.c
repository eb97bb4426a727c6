/* slave.h for a model that another process computes: a Python with the package hexjet-cosim, which this file starts,
 * one for each instance, so that nothing of it is in the importer's own process.
 *
 * The importer's side of the conversation of tools/hexjet_export/vehicle/process.py: frames of doubles through a socket that
 * is the process's standard input.  To it: what to do (0 start, 1 step), how many steps, then every parameter and input
 * in the order of their references.  From it: 0 and every output, or -1 and a line of text that says why it cannot.
 */
#ifndef __linux__
#error "made for Linux: the importer's end of the socket must not be in the process that is started"
#endif
#ifndef _GNU_SOURCE
#define _GNU_SOURCE /* posix_spawn, socketpair, kill */
#endif

#include "slave.h"

#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <float.h>
#include <math.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#define VARIABLE_WITH_PYTHON "HEXJET_PYTHON" /* another interpreter than that of the archive's python.txt */
#define MODULE "hexjet_export.vehicle.process"

typedef enum { INDEPENDENT, PARAMETER, INPUT, OUTPUT } Causality;

typedef struct {
    const char *name;
    Causality causality;
    Type type;
    size_t offset; /* in Variables, which this file has no use for */
    double min, max, start;
} Variable;

/* Indexed by value reference; reference 0 is the time. */
static const Variable TABLE[] = {{"time", INDEPENDENT, REAL, 0, -HUGE_VAL, HUGE_VAL, 0.0}, ENGINE_TABLE};
enum { COUNT = sizeof(TABLE) / sizeof(TABLE[0]), LONGEST_PATH = 4096, LONGEST_LINE = 1024 };

enum {
    ANSWER_MS = 120000, /* for an interpreter to start and read its files, or for a step; chosen by us */
    END_MS = 3000       /* for the process to end by itself once nobody asks any more */
};

typedef enum { START, STEP } Request;

struct Slave {
    Log log;
    void *environment;
    bool logging;
    Mode mode;
    bool stop_defined;
    bool started; /* the outputs follow from the parameters and inputs as they are */
    int64_t steps;
    double start, stop;
    double values[COUNT];
    pid_t process; /* 0: there is none */
    int socket;
    char python[LONGEST_PATH];
};

static const double TOLERANCE = 1e-9; /* relative, for times that the importer computed in floating point */
extern char **environ;

static void say(const Slave *s, const char *format, va_list arguments)
{
    char message[LONGEST_LINE + LONGEST_PATH];
    vsnprintf(message, sizeof(message), format, arguments);
    for (char *at = message; *at; at++)
        if (*at == '%' || *at == '#' || iscntrl((unsigned char)*at))
            *at = ' '; /* FMI 2.0 takes the text for a format, and # for a variable */
    s->log(s->environment, message);
}

bool slave_fail(Slave *s, const char *format, ...)
{
    s->mode = FAILED;
    if (s->logging && s->log) {
        va_list arguments;
        va_start(arguments, format);
        say(s, format, arguments);
        va_end(arguments);
    }
    return false;
}

static void pause_ms(long ms)
{
    const struct timespec time = {ms / 1000, (ms % 1000) * 1000000};
    nanosleep(&time, NULL);
}

/* Let the process go: it ends by itself when its input does, and is ended where it does not. */
static void end_process(Slave *s)
{
    if (s->process == 0)
        return;
    close(s->socket);
    bool ended = false;
    for (int waited = 0; !ended && waited < END_MS; waited += 5) {
        const pid_t found = waitpid(s->process, NULL, WNOHANG);
        ended = found != 0 && !(found < 0 && errno == EINTR);
        if (!ended)
            pause_ms(5);
    }
    if (!ended) {
        kill(s->process, SIGKILL);
        waitpid(s->process, NULL, 0);
    }
    s->process = 0;
}

static bool send_all(Slave *s, const void *data, size_t size)
{
    const char *at = data;
    while (size > 0) {
        const ssize_t sent = send(s->socket, at, size, MSG_NOSIGNAL);
        if (sent < 0 && errno == EINTR)
            continue;
        if (sent <= 0)
            return false;
        at += sent;
        size -= (size_t)sent;
    }
    return true;
}

/* 1, or 0 where the process has ended, or -1 where it does not answer in time. */
static int receive(Slave *s, void *data, size_t size)
{
    char *at = data;
    while (size > 0) {
        struct pollfd waiting = {s->socket, POLLIN, 0};
        const int ready = poll(&waiting, 1, ANSWER_MS);
        if (ready < 0 && errno == EINTR)
            continue;
        if (ready <= 0)
            return -1;
        const ssize_t got = recv(s->socket, at, size, 0);
        if (got < 0 && errno == EINTR)
            continue;
        if (got <= 0)
            return 0;
        at += got;
        size -= (size_t)got;
    }
    return 1;
}

/* 0, or after a log line another number. */
static bool take_status(Slave *s, const char *where)
{
    double status = 0.0;
    char line[LONGEST_LINE];
    size_t length = 0;
    int found = receive(s, &status, sizeof(status));
    if (found == 1 && status == 0.0)
        return true;
    if (found == 1) {
        while (length + 1 < sizeof(line) && receive(s, line + length, 1) == 1 && line[length] != '\n')
            length++;
        line[length] = '\0';
        return slave_fail(s, "%s", line);
    }
    if (found < 0)
        return slave_fail(s, "the process of the vehicle does not answer %s", where);
    return slave_fail(s, "the process of the vehicle ended by itself %s", where);
}

static bool exchange(Slave *s, Request request, double steps)
{
    double frame[COUNT + 2] = {(double)request, steps};
    size_t given = 2, taken = 0;
    const char *where = request == START ? "at its start" : "in a step";
    for (int reference = 1; reference < COUNT; reference++) {
        if (TABLE[reference].causality == OUTPUT)
            taken++;
        else
            frame[given++] = s->values[reference];
    }
    if (s->process == 0)
        return slave_fail(s, "the process of the vehicle has ended");
    (void)send_all(s, frame, given * sizeof(double)); /* where it has ended there is no answer either */
    if (!take_status(s, where))
        return false;
    double answer[COUNT];
    if (receive(s, answer, taken * sizeof(double)) != 1)
        return slave_fail(s, "the process of the vehicle ended by itself %s", where);
    taken = 0;
    for (int reference = 1; reference < COUNT; reference++) {
        if (TABLE[reference].causality != OUTPUT)
            continue;
        s->values[reference] = answer[taken++];
        if (!isfinite(s->values[reference]))
            return slave_fail(s, "%s is not finite at %.10g s", TABLE[reference].name, slave_time(s));
    }
    return true;
}

static int hex(char c)
{
    return isdigit((unsigned char)c) ? c - '0' : isxdigit((unsigned char)c) ? tolower((unsigned char)c) - 'a' + 10 : -1;
}

/* A path, or the URI of one as FMI 2.0 has it. */
static bool as_path(const char *given, char path[LONGEST_PATH])
{
    const bool uri = strncmp(given, "file:", 5) == 0;
    if (uri) {
        given += 5;
        if (strncmp(given, "//", 2) == 0) {
            given = strchr(given + 2, '/'); /* whatever host */
            if (!given)
                return false;
        }
    }
    size_t length = 0;
    for (; *given; given++) {
        if (length + 2 >= LONGEST_PATH)
            return false;
        if (uri && given[0] == '%' && hex(given[1]) >= 0 && hex(given[2]) >= 0) {
            path[length++] = (char)(16 * hex(given[1]) + hex(given[2]));
            given += 2;
        } else {
            path[length++] = *given;
        }
    }
    while (length > 1 && path[length - 1] == '/')
        length--;
    path[length] = '\0';
    return length > 0;
}

static bool find_python(Slave *s, const char *resources)
{
    const char *chosen = getenv(VARIABLE_WITH_PYTHON);
    if (chosen && *chosen) {
        snprintf(s->python, sizeof(s->python), "%s", chosen);
        return true;
    }
    char name[LONGEST_PATH + 16];
    snprintf(name, sizeof(name), "%s/python.txt", resources);
    FILE *file = fopen(name, "r");
    const bool found = file && fgets(s->python, sizeof(s->python), file);
    if (file)
        fclose(file);
    if (!found)
        return slave_fail(s, "%s cannot be read: %s", name, strerror(errno));
    s->python[strcspn(s->python, "\r\n")] = '\0';
    return true;
}

/* Python without PYTHONPATH and its like, which are the importer's; in a group of its own, so that Ctrl-C is the
 * importer's to answer; nothing on its standard output, which may be the importer's results. */
static bool start_process(Slave *s, const char *resources)
{
    char path[LONGEST_PATH];
    if (!resources || !as_path(resources, path))
        return slave_fail(s, "the importer does not say where the resources are");
    if (!find_python(s, path))
        return false;
    int ends[2];
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0)
        return slave_fail(s, "no socket: %s", strerror(errno));
    char flags[] = "-EP", module[] = "-m", name[] = MODULE;
    char *const arguments[] = {s->python, flags, module, name, path, NULL};
    posix_spawn_file_actions_t actions;
    posix_spawnattr_t attributes;
    sigset_t none;
    sigemptyset(&none);
    posix_spawn_file_actions_init(&actions);
    posix_spawnattr_init(&attributes);
    posix_spawn_file_actions_adddup2(&actions, ends[1], 0);
    posix_spawn_file_actions_addopen(&actions, 1, "/dev/null", O_WRONLY, 0);
    posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP | POSIX_SPAWN_SETSIGMASK);
    posix_spawnattr_setpgroup(&attributes, 0);
    posix_spawnattr_setsigmask(&attributes, &none);
    pid_t process = 0;
    const int problem = posix_spawnp(&process, s->python, &actions, &attributes, arguments, environ);
    posix_spawn_file_actions_destroy(&actions);
    posix_spawnattr_destroy(&attributes);
    close(ends[1]);
    if (problem != 0) {
        close(ends[0]);
        return slave_fail(s,
                          "the Python %s cannot be started: %s; this vehicle needs one with the package hexjet-cosim, which the "
                          "environment variable " VARIABLE_WITH_PYTHON " names",
                          s->python, strerror(problem));
    }
    s->process = process;
    s->socket = ends[0];
    char where[LONGEST_PATH + 200];
    snprintf(where, sizeof(where),
             "before it was ready: has the Python %s the package hexjet-cosim? The environment variable " VARIABLE_WITH_PYTHON
             " names another one",
             s->python);
    return take_status(s, where);
}

Slave *slave_new(Log log, void *environment, bool logging, const char *resources)
{
    Slave *s = calloc(1, sizeof(Slave));
    if (!s)
        return NULL;
    s->log = log;
    s->environment = environment;
    s->logging = true; /* why there is no instance is said in any case */
    slave_reset(s);
    if (!start_process(s, resources)) {
        slave_free(s);
        return NULL;
    }
    s->logging = logging;
    return s;
}

void slave_free(Slave *s)
{
    if (s)
        end_process(s);
    free(s);
}

void *slave_environment(const Slave *s) { return s->environment; }

void slave_set_logging(Slave *s, bool logging) { s->logging = logging; }

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
    if (s->mode & modes)
        return true;
    return slave_fail(s, "%s is not allowed %s", function, mode_name(s->mode));
}

bool slave_set_experiment(Slave *s, double start, bool stop_defined, double stop)
{
    if (!isfinite(start) || (stop_defined && !(stop >= start)))
        return slave_fail(s, "start time %g s and stop time %g s do not make an interval", start, stop);
    s->start = start;
    s->stop_defined = stop_defined;
    s->stop = stop_defined ? stop : 0.0;
    return true;
}

void slave_enter_initialization(Slave *s) { s->mode = INITIALIZATION; }

static bool make_start(Slave *s)
{
    s->started = s->started || exchange(s, START, 0.0);
    return s->started;
}

bool slave_exit_initialization(Slave *s)
{
    if (!make_start(s))
        return false;
    s->mode = STEPPING;
    return true;
}

void slave_terminate(Slave *s) { s->mode = TERMINATED; }

void slave_reset(Slave *s)
{
    s->mode = INSTANTIATED;
    s->started = s->stop_defined = false;
    s->steps = 0;
    s->start = s->stop = 0.0;
    for (int reference = 1; reference < COUNT; reference++)
        s->values[reference] = TABLE[reference].start;
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
    /* outputs follow the start values while these may change */
    if (variable->causality == OUTPUT && (s->mode & (INSTANTIATED | INITIALIZATION)) && !make_start(s))
        return false;
    *value = variable->causality == INDEPENDENT ? slave_time(s) : s->values[reference];
    return true;
}

bool slave_set(Slave *s, uint32_t reference, Type type, double value)
{
    const Variable *variable = find(s, reference, type);
    if (!variable)
        return false;
    const bool before_start = s->mode & (INSTANTIATED | INITIALIZATION);
    if (variable->causality != INPUT && !(variable->causality == PARAMETER && before_start))
        return slave_fail(s, "%s cannot be set %s", variable->name, mode_name(s->mode));
    if (!isfinite(value))
        return slave_fail(s, "%s is not finite", variable->name);
    if (variable->causality == PARAMETER && (value < variable->min || value > variable->max))
        return slave_fail(s, "%s = %.10g is outside %.10g to %.10g", variable->name, value, variable->min, variable->max);
    if (before_start && s->values[reference] != value)
        s->started = false;
    s->values[reference] = value;
    return true;
}

double slave_time(const Slave *s) { return s->start + (double)s->steps * ENGINE_STEP; }

bool slave_do_step(Slave *s, double point, double step)
{
    const double here = slave_time(s);
    const double count = floor(step / ENGINE_STEP + 0.5);
    /* what a master that computes its step as a difference of times loses where they are large */
    const double lost = DBL_EPSILON * (fabs(here) + fabs(here + count * ENGINE_STEP));
    /* written so that NaN falls through to the error */
    if (!(count >= 1.0 && count <= 1e9 && fabs(step - count * ENGINE_STEP) <= TOLERANCE * step + lost))
        return slave_fail(s, "communication step %.10g s is not a whole multiple of the control step %.10g s", step, ENGINE_STEP);
    if (!(fabs(point - here) <= TOLERANCE * fmax(fabs(here), ENGINE_STEP)))
        return slave_fail(s, "communication point %.10g s is not where the vehicle stands, %.10g s", point, here);
    const double end = s->start + ((double)s->steps + count) * ENGINE_STEP;
    if (s->stop_defined && end - s->stop > TOLERANCE * fmax(fabs(end), ENGINE_STEP))
        return slave_fail(s, "a step to %.10g s passes the stop time %.10g s", end, s->stop);
    s->steps += (int64_t)count;
    return exchange(s, STEP, count);
}

/* States are not saved: what JSBSim remembers cannot be taken out and put back. */
bool slave_save(Slave *s, Snapshot **snapshot)
{
    (void)snapshot;
    return slave_fail(s, "the state of this FMU cannot be saved");
}

bool slave_restore(Slave *s, const Snapshot *snapshot)
{
    (void)snapshot;
    return slave_fail(s, "the state of this FMU cannot be restored");
}

size_t slave_serialized_size(void) { return 0; }

bool slave_serialize(Slave *s, const Snapshot *snapshot, unsigned char *bytes, size_t size)
{
    (void)snapshot, (void)bytes, (void)size;
    return slave_fail(s, "the state of this FMU cannot be saved");
}

bool slave_deserialize(Slave *s, const unsigned char *bytes, size_t size, Snapshot **snapshot)
{
    (void)bytes, (void)size, (void)snapshot;
    return slave_fail(s, "the state of this FMU cannot be restored");
}
