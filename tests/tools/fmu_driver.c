/* Drives an engine FMU without Python, for valgrind and the sanitizers: through its throttle, its start and shut-down,
 * saved and serialized states, an error, a reset.  Compiled with -DFMI=2 or -DFMI=3.
 *
 *     driver LIBRARY TOKEN STEP THROTTLE RUN COLD IGNITION OUTPUT...       value references; 0 where there is none
 *
 * Prints the outputs after the last step as hexadecimal floating point. */
#include <dlfcn.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

#if FMI == 3
#include "fmi3FunctionTypes.h"
#define NAME(f) "fmi3" f
typedef fmi3Instance Instance;
typedef fmi3FMUState SavedState;
typedef fmi3Byte Byte;
#else
#include "fmi2FunctionTypes.h"
#define NAME(f) "fmi2" f
typedef fmi2Component Instance;
typedef fmi2FMUstate SavedState;
typedef fmi2Byte Byte;
#endif

enum { STEPS = 1000, SAVED_AT = 540, MOST_OUTPUTS = 8 };

static double internal_step;
static void *library;
static Instance fmu;
static unsigned throttle, run, cold, ignition, outputs[MOST_OUTPUTS];
static size_t n_outputs;

static void *find(const char *name)
{
    void *found = dlsym(library, name);
    if (!found) {
        fprintf(stderr, "no %s\n", name);
        exit(2);
    }
    return found;
}

static void need(bool good, const char *what)
{
    if (!good) {
        fprintf(stderr, "%s failed\n", what);
        exit(2);
    }
}

/* ISO C has no cast from object to function pointer; POSIX asks for this one. */
#define CALL(type, name) (*(type *)&(void *){find(name)})

static int logged;

#if FMI == 3
static void note(fmi3InstanceEnvironment e, fmi3Status s, fmi3String category, fmi3String message)
{
    (void)e, (void)s, (void)category, (void)message;
    logged++;
}

static void instantiate(const char *token)
{
    fmu = CALL(fmi3InstantiateCoSimulationTYPE *, NAME("InstantiateCoSimulation"))(
        "driven", token, NULL, fmi3False, fmi3True, fmi3False, fmi3False, NULL, 0, NULL, note, NULL);
}

static void set(unsigned reference, double value)
{
    if (reference)
        need(CALL(fmi3SetFloat64TYPE *, NAME("SetFloat64"))(fmu, &reference, 1, &value, 1) == fmi3OK, "set");
}

static void set_integer(unsigned reference, int value)
{
    if (reference)
        need(CALL(fmi3SetInt32TYPE *, NAME("SetInt32"))(fmu, &reference, 1, &value, 1) == fmi3OK, "set");
}

static void get(double *values)
{
    need(CALL(fmi3GetFloat64TYPE *, NAME("GetFloat64"))(fmu, outputs, n_outputs, values, n_outputs) == fmi3OK, "get");
}

static void initialize(void)
{
    need(CALL(fmi3EnterInitializationModeTYPE *, NAME("EnterInitializationMode"))(fmu, fmi3False, 0, 0, fmi3False, 0) == fmi3OK,
         "enter");
    need(CALL(fmi3ExitInitializationModeTYPE *, NAME("ExitInitializationMode"))(fmu) == fmi3OK, "exit");
}

static bool step(double time, double size)
{
    fmi3Boolean event, terminate, early;
    fmi3Float64 last;
    return CALL(fmi3DoStepTYPE *, NAME("DoStep"))(fmu, time, size, fmi3True, &event, &terminate, &early, &last) == fmi3OK;
}
#define GET_STATE CALL(fmi3GetFMUStateTYPE *, NAME("GetFMUState"))
#define SET_STATE CALL(fmi3SetFMUStateTYPE *, NAME("SetFMUState"))
#define FREE_STATE CALL(fmi3FreeFMUStateTYPE *, NAME("FreeFMUState"))
#define STATE_SIZE CALL(fmi3SerializedFMUStateSizeTYPE *, NAME("SerializedFMUStateSize"))
#define SERIALIZE CALL(fmi3SerializeFMUStateTYPE *, NAME("SerializeFMUState"))
#define DESERIALIZE CALL(fmi3DeserializeFMUStateTYPE *, NAME("DeserializeFMUState"))
#define RESET CALL(fmi3ResetTYPE *, NAME("Reset"))
#define FREE CALL(fmi3FreeInstanceTYPE *, NAME("FreeInstance"))
#else
static void note(fmi2ComponentEnvironment e, fmi2String name, fmi2Status s, fmi2String category, fmi2String message, ...)
{
    (void)e, (void)name, (void)s, (void)category, (void)message;
    logged++;
}

static const fmi2CallbackFunctions callbacks = {note, calloc, free, NULL, NULL};

static void instantiate(const char *token)
{
    fmu = CALL(fmi2InstantiateTYPE *, NAME("Instantiate"))("driven", fmi2CoSimulation, token, "", &callbacks, fmi2False, fmi2True);
}

static void set(unsigned reference, double value)
{
    if (reference)
        need(CALL(fmi2SetRealTYPE *, NAME("SetReal"))(fmu, &reference, 1, &value) == fmi2OK, "set");
}

static void set_integer(unsigned reference, int value)
{
    if (reference)
        need(CALL(fmi2SetIntegerTYPE *, NAME("SetInteger"))(fmu, &reference, 1, &value) == fmi2OK, "set");
}

static void get(double *values)
{
    need(CALL(fmi2GetRealTYPE *, NAME("GetReal"))(fmu, outputs, n_outputs, values) == fmi2OK, "get");
}

static void initialize(void)
{
    need(CALL(fmi2SetupExperimentTYPE *, NAME("SetupExperiment"))(fmu, fmi2False, 0, 0, fmi2False, 0) == fmi2OK, "set up");
    need(CALL(fmi2EnterInitializationModeTYPE *, NAME("EnterInitializationMode"))(fmu) == fmi2OK, "enter");
    need(CALL(fmi2ExitInitializationModeTYPE *, NAME("ExitInitializationMode"))(fmu) == fmi2OK, "exit");
}

static bool step(double time, double size)
{
    return CALL(fmi2DoStepTYPE *, NAME("DoStep"))(fmu, time, size, fmi2True) == fmi2OK;
}
#define GET_STATE CALL(fmi2GetFMUstateTYPE *, NAME("GetFMUstate"))
#define SET_STATE CALL(fmi2SetFMUstateTYPE *, NAME("SetFMUstate"))
#define FREE_STATE CALL(fmi2FreeFMUstateTYPE *, NAME("FreeFMUstate"))
#define STATE_SIZE CALL(fmi2SerializedFMUstateSizeTYPE *, NAME("SerializedFMUstateSize"))
#define SERIALIZE CALL(fmi2SerializeFMUstateTYPE *, NAME("SerializeFMUstate"))
#define DESERIALIZE CALL(fmi2DeSerializeFMUstateTYPE *, NAME("DeSerializeFMUstate"))
#define RESET CALL(fmi2ResetTYPE *, NAME("Reset"))
#define FREE CALL(fmi2FreeInstanceTYPE *, NAME("FreeInstance"))
#endif

/* Up and down, shut off and started again. */
static void fly(int from, int to)
{
    for (int k = from; k < to; k++) {
        set(throttle, (double)(k / 50 * 7 % 11) / 10.0);
        set(run, k >= 300 && k < 500 ? 0.0 : 1.0);
        need(step(k * internal_step, internal_step), "step");
    }
}

static void there_and_back(double *values)
{
    double again[MOST_OUTPUTS];
    fly(0, SAVED_AT);
    SavedState saved = NULL, copy = NULL;
    size_t size = 0;
    need(GET_STATE(fmu, &saved) == 0, "get state");
    fly(SAVED_AT, STEPS);
    get(values);
    need(STATE_SIZE(fmu, saved, &size) == 0, "state size");
    Byte *bytes = malloc(size);
    need(bytes && SERIALIZE(fmu, saved, bytes, size) == 0, "serialize");
    need(DESERIALIZE(fmu, bytes, size, &copy) == 0, "deserialize");
    free(bytes);
    need(SET_STATE(fmu, copy) == 0, "set state");
    fly(SAVED_AT, STEPS);
    get(again);
    for (size_t i = 0; i < n_outputs; i++)
        need(again[i] == values[i], "the same again");
    need(FREE_STATE(fmu, &saved) == 0 && FREE_STATE(fmu, &copy) == 0, "free state");
}

int main(int argc, char **argv)
{
    need(argc > 8 && argc - 8 <= MOST_OUTPUTS, "arguments");
    internal_step = atof(argv[3]);
    throttle = (unsigned)atoi(argv[4]);
    run = (unsigned)atoi(argv[5]);
    cold = (unsigned)atoi(argv[6]);
    ignition = (unsigned)atoi(argv[7]);
    while ((int)n_outputs < argc - 8) {
        outputs[n_outputs] = (unsigned)atoi(argv[8 + n_outputs]);
        n_outputs++;
    }
    library = dlopen(argv[1], RTLD_NOW | RTLD_LOCAL);
    need(library != NULL, "dlopen");

    instantiate("another FMU's");
    need(fmu == NULL, "a wrong token refused");
    instantiate(argv[2]);
    need(fmu != NULL, "instantiate");
    double values[MOST_OUTPUTS];
    set(ignition, 0.1); /* s: the start is to be seen */
    initialize();
    there_and_back(values);
    logged = 0;
    need(!step(0.0, internal_step), "a step in the past refused");
    need(logged == 1, "and explained");

    need(RESET(fmu) == 0, "reset");
    set_integer(cold, 1);
    set(ignition, 0.1);
    initialize();
    there_and_back(values);
    for (size_t i = 0; i < n_outputs; i++)
        printf("%a\n", values[i]);
    FREE(fmu);
    dlclose(library);
    return 0;
}
