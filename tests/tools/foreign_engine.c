/* An engine as other people's tools write it: what it is made of stands in its token, "foreign:lag=0.3,delay=0.08".
 *
 * A delay, two lags, a zero, a weak mode, a sampler, a limit on the acceleration, noise, a start: each off unless named.
 * FMI 2.0, or 3.0 with -DFMI=3.  Functions that are not written here the tests add as stubs.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <math.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#ifndef FMI
#define FMI 2
#endif

enum { OK, WARNING, DISCARD, ERROR, FATAL };
enum { THROTTLE = 1, THRUST = 2, PULSE = 3, IGNITION = 4, MODE = 5, SPEED = 6, VALVE = 7, DRAG = 8, GROSS = 9,
       ALTITUDE = 30, MACH, DENSITY, TOTAL_PRESSURE, TOTAL_TEMPERATURE, GAIN = 40,
       FORWARD, RIGHT, TORQUE, VALUES = 60 };
enum { LINE = 2048, SIX = 6 };
#define H 0.001 /* s, of its own step */
#define FULL 20.0 /* N */
#define PI 3.14159265358979323846

typedef struct {
    double line[LINE], held, x, x2, m, dm, soak, slow, more[8], y, mean, surged;
} One;

#define FIELD(name, otherwise) double name;
#define PARTS(X) X(pulse, 0.0) X(start, 0.0) X(modes, 0.0) X(valve, 0.0) X(delay, 0.0) X(delay_down, -1.0) X(sampled, 0.0) \
    X(delay_full, -1.0) X(lag, 0.1) X(lag2, 0.0) X(accelerates, 0.0) X(zero, 0.0) X(mode, 0.0) X(mode_hz, 9.0) \
    X(damping, 0.01) X(soak, 0.0) X(hunts, 0.0) X(noise, 0.0) X(flat, 1.0) X(exponent, 1.0) X(air, 0.0) X(idle, \
    0.0) X(sign, 1.0) X(drag, 0.0) X(crashes, 0.0) X(hangs, 0.0) X(floods, 0.0) \
    X(over, 0.0) X(over_s, 4.0) X(warm, 0.0) X(warm_s, 45.0) X(more, 0.0) X(more_s, 0.05) X(delta, 0.0) \
    X(prints, 0.0) X(threads, 0.0) X(dies, 0.0) X(leaks, 0.0) \
    X(forward, 0.0) X(right, 0.0) X(torque, 0.0) \
    X(surge, 0.0)

typedef struct {
    PARTS(FIELD)
} Parts;

typedef struct {
    char token[512];
    Parts of;
    double value[VALUES], time, lit;
    long k;
    uint64_t random;
    One one;
} Engine;

static int alive;

static double read_part(const Engine *e, const char *key, double otherwise)
{
    const size_t length = strlen(key);
    for (const char *at = strstr(e->token, key); at; at = strstr(at + 1, key))
        if ((at[-1] == ':' || at[-1] == ',') && at[length] == '=')
            return atof(at + length + 1);
    return otherwise;
}

static double noise(Engine *e)
{
    double sum = 0.0; /* of twelve uniform ones: nearly normal, deviation 1 */
    for (int i = 0; i < 12; i++) {
        e->random = e->random * 6364136223846793005ULL + 1442695040888963407ULL;
        sum += (double)(e->random >> 11) / 9007199254740992.0;
    }
    return sum - 6.0;
}

static double command(const Engine *e)
{
    double u = e->value[THROTTLE];
    if (e->of.pulse > 0.0)
        u = (e->value[PULSE] - 1000.0) / 1000.0;
    return u < 0.0 ? 0.0 : u > 1.0 ? 1.0 : u;
}

/* Ignition, a crank that must reach its speed before the mode is "run", or a valve that must be open. */
static bool running(Engine *e)
{
    const double takes = e->of.start;
    bool on = true;
    if (takes > 0.0) {
        if (e->of.modes > 0.0)
            e->lit += e->value[MODE] == 1.0 && e->lit < takes ? H : 0.0;
        else
            e->lit += e->value[IGNITION] != 0.0 && e->lit < takes ? H : 0.0;
        on = e->lit >= 0.99 * takes && (e->of.modes == 0.0 || e->value[MODE] == 2.0);
    }
    return on && (e->of.valve == 0.0 || e->value[VALVE] > 0.5);
}

static void part(Engine *e, One *s, double u)
{
    const double up = e->of.delay, down = (e->of.delay_down < 0.0 ? up : e->of.delay_down), sampled = e->of.sampled;
    const bool passes = fabs(u - s->held) > e->of.delta || e->of.delta == 0.0; /* a throttle told when it has changed by so much */
    if (passes && (sampled == 0.0 || e->k % lround(sampled / H) == 0))
        s->held = u;
    s->line[e->k % LINE] = s->held;
    const double late = (e->of.delay_full < 0.0 ? up : e->of.delay_full); /* where the dead time goes with the throttle */
    const double own = up + (late - up) * s->held;
    const double a = s->line[(e->k + LINE - lround(own / H)) % LINE];
    const double b = s->line[(e->k + LINE - lround((late == up ? down : own) / H)) % LINE];
    const double v = down > up ? fmax(a, b) : down < up ? fmin(a, b) : a;
    const double lag = e->of.warm > 0.0 && e->time > e->of.warm_s ? e->of.warm : e->of.lag;
    const double lag2 = e->of.lag2, most = e->of.accelerates * H;
    double move = (v - s->x) * -expm1(-H / lag);
    if (most > 0.0)
        move = move > most ? most : move < -most ? -most : move;
    s->x += move;
    double y = s->x;
    if (lag2 > 0.0) {
        s->x2 += (s->x - s->x2) * -expm1(-H / lag2);
        y = s->x2 + e->of.zero * (s->x - s->x2) / lag2;
    }
    const double share = e->of.mode;
    if (share > 0.0) {
        const double w = 2.0 * PI * e->of.mode_hz;
        s->dm += H * (w * w * (v - s->m) - 2.0 * e->of.damping * w * s->dm);
        s->m += H * s->dm;
        y = (1.0 - share) * y + share * s->m;
    }
    for (int i = 0; i < (int)e->of.more; i++) { /* further lags in a row */
        s->more[i] += (y - s->more[i]) * -expm1(-H / e->of.more_s);
        y = s->more[i];
    }
    if (e->of.over != 0.0) { /* thrust goes beyond what it comes to, and back slowly */
        s->slow += (y - s->slow) * -expm1(-H / e->of.over_s);
        y += e->of.over * (y - s->slow);
    }
    if (e->of.surge > 0.0) { /* a throttle that is opened so far within 50 ms halves the thrust for 0.6 s */
        s->mean += (u - s->mean) * -expm1(-H / 0.05);
        s->surged = u - s->mean > e->of.surge ? 0.6 : fmax(s->surged - H, 0.0);
        y *= s->surged > 0.0 ? 0.5 : 1.0;
    }
    s->soak += (s->x - s->soak) * -expm1(-H / 120.0);
    s->y = y * (1.0 - e->of.soak * s->soak) + e->of.hunts * sin(2.0 * PI * 1.3 * e->time);
}

static void outputs(Engine *e)
{
    const double share = e->of.noise;
    double y = e->one.y, flat = e->of.flat, exponent = e->of.exponent;
    y = flat == 1.0 ? y : y < flat ? y / flat : 1.0; /* thrust may go beyond what it comes to */
    y = exponent != 1.0 ? pow(fmax(y, 0.0), exponent) : y;
    if (e->value[GAIN] > 0.0)
        y *= e->value[GAIN];
    if (e->of.air > 0.0) /* thrust as density, lifted by the ram and lowered by Mach */
        y *= e->value[DENSITY] / 1.225 * (1.0 - 0.3 * e->value[MACH]);
    double newton = FULL * (y + (share > 0.0 ? share * noise(e) : 0.0));
    if (e->of.idle > 0.0)
        newton = FULL * (e->of.idle + (1.0 - e->of.idle) * y);
    e->value[THRUST] = e->of.sign * newton;
    e->value[FORWARD] = e->of.forward * e->value[THRUST];
    e->value[RIGHT] = e->of.right * e->value[THRUST];
    e->value[TORQUE] = e->of.torque * e->value[THRUST];
    e->value[DRAG] = e->of.drag;
    e->value[GROSS] = e->value[THRUST] + e->value[DRAG];
    const double takes = e->of.start;
    e->value[SPEED] = takes > 0.0 ? 5000.0 * e->lit / takes : 5000.0 + 10000.0 * e->one.x;
}

static int advance(Engine *e, double t, double h)
{
    (void)t;
    const long steps = lround(h / H);
    for (long n = 0; n < steps; n++, e->k++) {
        e->time = (double)e->k * H;
        const bool on = running(e);
        part(e, &e->one, on ? command(e) : 0.0);
    }
    if (alive >= SIX && e->time > 3.0) { /* in a flight, and in no trial */
        volatile char *lost = e->of.leaks > 0.0 ? malloc((size_t)(e->of.leaks * 1048576.0)) : NULL; /* MB a step */
        for (size_t at = 0; lost && (double)at < e->of.leaks * 1048576.0; at += 4096)
            lost[at] = 1;
        if (e->of.crashes > 0.0)
            *(volatile int *)0 = 1;
        for (volatile double spin = 0.0; e->of.hangs > 0.0; spin += 1.0)
            ;
        for (int i = 0; i < 1000 && e->of.floods > 0.0; i++)
            puts("a line of no use to anybody, printed again and again");
    }
    outputs(e);
    return OK;
}

static void *wait_for_ever(void *nothing)
{
    pause();
    return nothing;
}

static Engine *create(const char *token)
{
    Engine *e = calloc(1, sizeof *e);
    snprintf(e->token, sizeof e->token, "%s", token);
    e->random = 12345;
#define READ(name, otherwise) e->of.name = read_part(e, #name, otherwise);
    PARTS(READ)
    Dl_info self;
    if (e->of.threads > 0.0 && dladdr((void *)&alive, &self))
        dlopen(self.dli_fname, RTLD_NOW | RTLD_NODELETE); /* threads outlive the instance */
    for (int i = 0; i < (int)e->of.threads; i++) {
        pthread_t thread;
        pthread_create(&thread, NULL, wait_for_ever, NULL);
        pthread_detach(thread);
    }
    if (e->of.dies > 0.0)
        *(volatile int *)0 = 1;
    if (e->of.prints > 0.0)
        puts("a banner");
    e->value[PULSE] = 1000.0;
    e->value[DENSITY] = 1.225;
    alive++;
    return e;
}

static int reset(Engine *e)
{
    char token[sizeof e->token];
    memcpy(token, e->token, sizeof token);
    Engine *fresh = create(token);
    alive--;
    memcpy(e, fresh, sizeof *e);
    free(fresh);
    return OK;
}

static void destroy(Engine *e)
{
    alive--;
    free(e);
}

#define SETTER(function, type, more)                                                        \
    int function(Engine *e, const uint32_t r[], size_t n, const type v[] more)              \
    {                                                                                       \
        for (size_t i = 0; i < n; i++)                                                      \
            e->value[r[i]] = (double)v[i];                                                  \
        return OK;                                                                          \
    }
#define GETTER(function, type, more)                                                        \
    int function(Engine *e, const uint32_t r[], size_t n, type v[] more)                    \
    {                                                                                       \
        for (size_t i = 0; i < n; i++)                                                      \
            v[i] = (type)e->value[r[i]];                                                    \
        return OK;                                                                          \
    }
#define NOTHING
#define COUNT , size_t m

#if FMI == 2
void *fmi2Instantiate(const char *name, int kind, const char *token, const char *resources, void *callbacks,
                      int visible, int logging)
{
    (void)name, (void)kind, (void)resources, (void)callbacks, (void)visible, (void)logging;
    return create(token);
}
void fmi2FreeInstance(Engine *e) { destroy(e); }
int fmi2SetupExperiment(Engine *e) { return (void)e, OK; }
int fmi2EnterInitializationMode(Engine *e) { return (void)e, OK; }
int fmi2ExitInitializationMode(Engine *e) { return outputs(e), OK; }
int fmi2Terminate(Engine *e) { return (void)e, OK; }
int fmi2Reset(Engine *e) { return reset(e); }
SETTER(fmi2SetReal, double, NOTHING)
SETTER(fmi2SetInteger, int32_t, NOTHING)
SETTER(fmi2SetBoolean, int32_t, NOTHING)
GETTER(fmi2GetReal, double, NOTHING)
GETTER(fmi2GetInteger, int32_t, NOTHING)
int fmi2DoStep(Engine *e, double t, double h, int no) { return (void)no, advance(e, t, h); }
#else
void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible, bool logging,
                                  bool events, bool early, const uint32_t required[], size_t count, void *environment,
                                  void *logger, void *update)
{
    (void)name, (void)visible, (void)logging, (void)events, (void)early, (void)required, (void)count, (void)update;
    (void)resources, (void)environment, (void)logger;
    return create(token);
}
void fmi3FreeInstance(Engine *e) { destroy(e); }
int fmi3EnterInitializationMode(Engine *e) { return (void)e, OK; }
int fmi3ExitInitializationMode(Engine *e) { return outputs(e), OK; }
int fmi3Terminate(Engine *e) { return (void)e, OK; }
int fmi3Reset(Engine *e) { return reset(e); }
SETTER(fmi3SetFloat64, double, COUNT)
SETTER(fmi3SetUInt16, uint16_t, COUNT)
SETTER(fmi3SetInt64, int64_t, COUNT)
SETTER(fmi3SetBoolean, bool, COUNT)
GETTER(fmi3GetFloat64, double, COUNT)
GETTER(fmi3GetUInt16, uint16_t, COUNT)
GETTER(fmi3GetInt64, int64_t, COUNT)
int fmi3DoStep(Engine *e, double t, double h, bool no, bool *event, bool *terminate, bool *early, double *last)
{
    (void)no;
    *event = *terminate = *early = false;
    *last = t + h;
    return advance(e, t, h);
}
#endif
