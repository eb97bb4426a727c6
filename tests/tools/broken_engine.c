/* An engine that misbehaves: a lag of the throttle, and the one fault that its token names behind "broken:".
 *
 * FMI 2.0, or 3.0 with -DFMI=3.  What is not written here the tests add as stubs, since FMPy asks for every function.
 * Faults that strike when the library is loaded or unloaded are chosen by -D.
 */
#define _GNU_SOURCE
#include <fenv.h>
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

#ifndef FMI
#define FMI 2
#endif
enum { OK, WARNING, DISCARD, ERROR };

typedef void (*Logger2)(void *, const char *, int, const char *, const char *, ...);
typedef struct {
    Logger2 logger;
    void *allocate, *release, *finished, *environment;
} Callbacks2;
typedef void (*Logger3)(void *, int, const char *, const char *);

enum { LATE = 101 }; /* one more than the delay in steps */

typedef struct {
    char fault[64];
    double throttle, start, y, line[LATE];
    long steps;
    Logger2 logger2;
    Logger3 logger3;
    void *environment;
} Engine;

static int alive;
static volatile int *volatile nowhere;
static volatile double sink;

static bool is(const Engine *e, const char *fault) { return strcmp(e->fault, fault) == 0; }

static void crash(void) { *nowhere = 1; }

static void hang(void)
{
    for (;;)
        sink += 1.0;
}

/* What linking with -ffast-math does to the whole process. */
static void flush_tiny_numbers(void)
{
#if defined(__SSE2__)
    _mm_setcsr(_mm_getcsr() | 0x8040);
#elif defined(__aarch64__)
    uint64_t control;
    __asm__ volatile("mrs %0, fpcr" : "=r"(control));
    __asm__ volatile("msr fpcr, %0" : : "r"(control | (1u << 24)));
#endif
}

/* Crash, hang or leave if the fault is of this moment. */
static void strike(const Engine *e, const char *moment)
{
    const char *dash = strchr(e->fault, '-');
    if (!dash || strcmp(dash + 1, moment) != 0)
        return;
    if (strncmp(e->fault, "crash", 5) == 0)
        crash();
    else if (strncmp(e->fault, "hang", 4) == 0)
        hang();
    else if (strncmp(e->fault, "exit", 4) == 0)
        exit(3);
    else if (strncmp(e->fault, "leave", 5) == 0)
        _exit(0);
    else if (strncmp(e->fault, "abort", 5) == 0)
        abort();
}

static void mention(const Engine *e, int status, const char *text)
{
    if (e->logger2)
        e->logger2(e->environment, "engine", status, "logStatusError", "%s", text);
    if (e->logger3)
        e->logger3(e->environment, status, "logStatusError", text);
}

static void say(const Engine *e, const char *text) { mention(e, ERROR, text); }

static void rest(Engine *e)
{
    e->throttle = e->start = 0.0;
    memset(e->line, 0, sizeof(e->line)), e->y = 0.0;
    e->steps = 0;
}

static Engine *create(const char *token, Logger2 logger2, Logger3 logger3, void *environment)
{
    Engine *e = calloc(1, sizeof(Engine));
    e->logger2 = logger2;
    e->logger3 = logger3;
    e->environment = environment;
    const char *colon = strchr(token, ':');
    snprintf(e->fault, sizeof(e->fault), "%s", colon ? colon + 1 : "");
    strike(e, "instantiate");
    if (strncmp(token, "broken:", 7) != 0) {
        say(e, "the token is not mine");
        return NULL;
    }
    if (is(e, "needs-tool")) {
        say(e, "cannot reach the simulation tool");
        return NULL;
    }
    if (is(e, "refuse") || (is(e, "single") && alive > 0))
        return NULL;
    if (is(e, "chdir") && chdir("/") != 0)
        return NULL;
    if (is(e, "hungry")) {
        const size_t block = 64u << 20;
        for (int i = 0; i < 160; i++) {
            char *memory = malloc(block);
            if (!memory)
                return NULL;
            memset(memory, 1, block);
            usleep(2000);
        }
    }
    if (is(e, "spawn") && fork() == 0) {
        sleep(30);
        _exit(0);
    }
    if (is(e, "close"))
        for (int i = 3; i < 64; i++)
            close(i);
    alive++;
    return e;
}

static void destroy(Engine *e)
{
    alive--;
    free(e);
}

static int initialize(Engine *e)
{
    if (is(e, "error-init")) {
        say(e, "no oil pressure");
        return ERROR;
    }
    return OK;
}

static int advance(Engine *e, double time, double step)
{
    (void)time;
    e->steps++;
    strike(e, "step");
    if (e->steps * step > 1.0)
        strike(e, "later");
    if (is(e, "error"))
        return say(e, "compressor surge"), ERROR;
    if (is(e, "discard"))
        return mention(e, OK, "no time for that"), DISCARD;
    if (is(e, "grid") && fabs(step - 0.003) > 1e-9)
        return say(e, "my step is 0.003 s"), ERROR;
    if (is(e, "chatter"))
        for (int i = 0; i < 20; i++)
            printf("step %ld: everything is fine, thank you for asking\n", e->steps);
    if (is(e, "slow"))
        usleep(2000);
    if (is(e, "rounding"))
        fesetround(FE_UPWARD);
    if (is(e, "tiny"))
        flush_tiny_numbers();
    e->y += 0.2 * (e->throttle - e->y);
    e->line[(e->steps + LATE - 1) % LATE] = e->y;
    return OK;
}

static double thrust(Engine *e)
{
    const double u = e->y, force = 20.0 * u, time = 0.004 * (double)e->steps;
    if (is(e, "nan") || (is(e, "nan-later") && time > 1.0))
        return NAN;
    if (is(e, "hump"))
        return force * (1.6 - u);
    if (is(e, "restless"))
        return force + 0.1 * sin(7.0 * time);
    if (is(e, "trembling")) /* late, and as a solver leaves it at rest; no fault */
        return 20.0 * e->line[e->steps % LATE] + 1e-7 * sin(7.0 * time);
    if (is(e, "constant"))
        return 12.0;
    if (is(e, "negative"))
        return force - 5.0;
    if (is(e, "process"))
        return force * (1.0 + 1e-6 * (double)getpid());
    return force;
}

enum { THROTTLE = 1, THRUST = 2, OTHER = 3 };

static int get(Engine *e, const uint32_t reference[], size_t count, double value[])
{
    for (size_t i = 0; i < count; i++)
        value[i] = reference[i] == THROTTLE ? e->throttle : reference[i] == THRUST ? thrust(e) : 0.0;
    return OK;
}

static int set(Engine *e, const uint32_t reference[], size_t count, const double value[])
{
    for (size_t i = 0; i < count; i++)
        if (reference[i] == THROTTLE)
            e->throttle = value[i];
    return OK;
}

#ifdef CRASH_ON_LOAD
__attribute__((constructor)) static void loaded(void) { crash(); }
#endif
#ifdef HANG_ON_LOAD
__attribute__((constructor)) static void loaded(void) { hang(); }
#endif
#ifdef CRASH_AT_EXIT
__attribute__((destructor)) static void unloaded(void) { crash(); }
#endif

#if FMI == 2
void *fmi2Instantiate(const char *name, int kind, const char *token, const char *resources, const Callbacks2 *callbacks,
                      int visible, int logging)
{
    (void)name, (void)kind, (void)resources, (void)visible, (void)logging;
    return create(token, callbacks->logger, NULL, callbacks->environment);
}
void fmi2FreeInstance(Engine *e) { destroy(e); }
int fmi2SetupExperiment(Engine *e) { return (void)e, OK; }
int fmi2EnterInitializationMode(Engine *e) { return initialize(e); }
int fmi2ExitInitializationMode(Engine *e) { return (void)e, OK; }
int fmi2Terminate(Engine *e) { return (void)e, OK; }
int fmi2Reset(Engine *e) { return rest(e), OK; }
int fmi2GetReal(Engine *e, const uint32_t r[], size_t n, double v[]) { return get(e, r, n, v); }
int fmi2SetReal(Engine *e, const uint32_t r[], size_t n, const double v[]) { return set(e, r, n, v); }
#ifndef WITHOUT_STEP
int fmi2DoStep(Engine *e, double t, double h, int no) { return (void)no, advance(e, t, h); }
#endif
#else
void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible, bool logging,
                                  bool events, bool early, const uint32_t required[], size_t count, void *environment,
                                  Logger3 logger, void *update)
{
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)required, (void)count, (void)update;
    return create(token, NULL, logger, environment);
}
void fmi3FreeInstance(Engine *e) { destroy(e); }
int fmi3EnterInitializationMode(Engine *e) { return initialize(e); }
int fmi3ExitInitializationMode(Engine *e) { return (void)e, OK; }
int fmi3EnterStepMode(Engine *e) { return (void)e, OK; }
int fmi3Terminate(Engine *e) { return (void)e, OK; }
int fmi3Reset(Engine *e) { return rest(e), OK; }
int fmi3GetFloat64(Engine *e, const uint32_t r[], size_t n, double v[], size_t m) { return (void)m, get(e, r, n, v); }
int fmi3SetFloat64(Engine *e, const uint32_t r[], size_t n, const double v[], size_t m) { return (void)m, set(e, r, n, v); }
int fmi3DoStep(Engine *e, double t, double h, bool no, bool *event, bool *terminate, bool *early, double *last)
{
    (void)no;
    *event = false;
    *terminate = is(e, "terminate") && t > 1.0;
    *early = is(e, "early") && t > 1.0;
    *last = *early ? t : t + h;
    return *early ? OK : advance(e, t, h);
}
#endif
