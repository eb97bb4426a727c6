/* FMI 3.0 for co-simulation on top of slave.h.  No events, clocks, early return or intermediate update. */
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#include "slave.h"

#define ERROR_CATEGORY "logStatusError"

typedef struct {
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment instance;
} Environment;

static void log_line(void *environment, const char *message)
{
    const Environment *e = environment;
    e->log(e->instance, fmi3Error, ERROR_CATEGORY, message);
}

static fmi3Status status(bool good) { return good ? fmi3OK : fmi3Error; }

static bool allows(Slave *s, const char *function, unsigned modes) { return s && slave_allows(s, function, modes); }

static fmi3Status refuse(Slave *s, const char *function)
{
    return s ? status(slave_fail(s, "%s is not provided", function)) : fmi3Error;
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories, const fmi3String categories[])
{
    if (!allows(instance, "fmi3SetDebugLogging", ANY_MODE))
        return fmi3Error;
    bool wanted = nCategories == 0;
    for (size_t i = 0; i < nCategories; i++)
        wanted = wanted || strcmp(categories[i], ERROR_CATEGORY) == 0;
    slave_set_logging(instance, loggingOn && wanted);
    return fmi3OK;
}

static fmi3Instance no_instance(fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, const char *problem)
{
    if (log)
        log(environment, fmi3Error, ERROR_CATEGORY, problem);
    return NULL;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
                                         fmi3Boolean visible, fmi3Boolean loggingOn, fmi3Boolean eventModeUsed,
                                         fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables, fmi3InstanceEnvironment instanceEnvironment,
                                         fmi3LogMessageCallback logMessage, fmi3IntermediateUpdateCallback intermediateUpdate)
{
    (void)visible, (void)earlyReturnAllowed;
    (void)requiredIntermediateVariables, (void)nRequiredIntermediateVariables, (void)intermediateUpdate;
    if (!instanceName || !*instanceName)
        return no_instance(instanceEnvironment, logMessage, "an instance needs a name");
    if (!instantiationToken || strcmp(instantiationToken, ENGINE_TOKEN) != 0)
        return no_instance(instanceEnvironment, logMessage, "the instantiation token is not that of this FMU");
    if (eventModeUsed)
        return no_instance(instanceEnvironment, logMessage, "this FMU has no event mode");
    Environment *e = malloc(sizeof(Environment));
    if (!e)
        return NULL;
    e->log = logMessage;
    e->instance = instanceEnvironment;
    Slave *s = slave_new(logMessage ? log_line : NULL, e, loggingOn, resourcePath);
    if (!s)
        free(e);
    return s;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
                                          fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage)
{
    (void)instanceName, (void)instantiationToken, (void)resourcePath, (void)visible, (void)loggingOn;
    return no_instance(instanceEnvironment, logMessage, "this FMU is for co-simulation only");
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken,
                                               fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                               fmi3InstanceEnvironment instanceEnvironment,
                                               fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
                                               fmi3LockPreemptionCallback lockPreemption,
                                               fmi3UnlockPreemptionCallback unlockPreemption)
{
    (void)instanceName, (void)instantiationToken, (void)resourcePath, (void)visible, (void)loggingOn;
    (void)clockUpdate, (void)lockPreemption, (void)unlockPreemption;
    return no_instance(instanceEnvironment, logMessage, "this FMU is for co-simulation only");
}

void fmi3FreeInstance(fmi3Instance instance)
{
    if (!instance)
        return;
    free(slave_environment(instance));
    slave_free(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    (void)toleranceDefined, (void)tolerance;
    if (!allows(instance, "fmi3EnterInitializationMode", INSTANTIATED) ||
        !slave_set_experiment(instance, startTime, stopTimeDefined, stopTime))
        return fmi3Error;
    slave_enter_initialization(instance);
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    if (!allows(instance, "fmi3ExitInitializationMode", INITIALIZATION))
        return fmi3Error;
    return status(slave_exit_initialization(instance));
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    if (!allows(instance, "fmi3Terminate", STEPPING))
        return fmi3Error;
    slave_terminate(instance);
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    if (!allows(instance, "fmi3Reset", ANY_MODE))
        return fmi3Error;
    slave_reset(instance);
    return fmi3OK;
}

enum { WRITABLE = INSTANTIATED | INITIALIZATION | STEPPING };

static bool counts_agree(Slave *s, const char *function, size_t references, size_t values)
{
    return references == values || slave_fail(s, "%s: %lu value references for %lu values", function,
                                              (unsigned long)references, (unsigned long)values);
}

#define GET(NAME, TYPE, KIND)                                                                           \
    fmi3Status NAME(fmi3Instance instance, const fmi3ValueReference valueReferences[],                  \
                    size_t nValueReferences, TYPE values[], size_t nValues)                             \
    {                                                                                                   \
        bool good = allows(instance, #NAME, ANY_MODE) &&                                                \
                    counts_agree(instance, #NAME, nValueReferences, nValues);                           \
        for (size_t i = 0; good && i < nValues; i++) {                                                  \
            double found = 0.0;                                                                         \
            good = slave_get(instance, valueReferences[i], KIND, &found);                               \
            if (good)                                                                                   \
                values[i] = (TYPE)found;                                                                \
        }                                                                                               \
        return status(good);                                                                            \
    }

#define SET(NAME, TYPE, KIND)                                                                           \
    fmi3Status NAME(fmi3Instance instance, const fmi3ValueReference valueReferences[],                  \
                    size_t nValueReferences, const TYPE values[], size_t nValues)                       \
    {                                                                                                   \
        bool good = allows(instance, #NAME, WRITABLE) &&                                                \
                    counts_agree(instance, #NAME, nValueReferences, nValues);                           \
        for (size_t i = 0; good && i < nValues; i++)                                                    \
            good = slave_set(instance, valueReferences[i], KIND, values[i]);                            \
        return status(good);                                                                            \
    }

/* Types that no engine variable has: good for no variables at all, else an error. */
#define NONE(NAME, TYPE)                                                                                \
    fmi3Status NAME(fmi3Instance instance, const fmi3ValueReference valueReferences[],                  \
                    size_t nValueReferences, TYPE values[], size_t nValues)                             \
    {                                                                                                   \
        (void)valueReferences, (void)values;                                                            \
        return nValueReferences == 0 && nValues == 0 && instance ? fmi3OK : refuse(instance, #NAME);    \
    }

GET(fmi3GetFloat64, fmi3Float64, REAL)
SET(fmi3SetFloat64, fmi3Float64, REAL)
GET(fmi3GetInt32, fmi3Int32, INTEGER)
SET(fmi3SetInt32, fmi3Int32, INTEGER)
NONE(fmi3GetFloat32, fmi3Float32)
NONE(fmi3SetFloat32, const fmi3Float32)
NONE(fmi3GetInt8, fmi3Int8)
NONE(fmi3SetInt8, const fmi3Int8)
NONE(fmi3GetUInt8, fmi3UInt8)
NONE(fmi3SetUInt8, const fmi3UInt8)
NONE(fmi3GetInt16, fmi3Int16)
NONE(fmi3SetInt16, const fmi3Int16)
NONE(fmi3GetUInt16, fmi3UInt16)
NONE(fmi3SetUInt16, const fmi3UInt16)
NONE(fmi3GetUInt32, fmi3UInt32)
NONE(fmi3SetUInt32, const fmi3UInt32)
NONE(fmi3GetInt64, fmi3Int64)
NONE(fmi3SetInt64, const fmi3Int64)
NONE(fmi3GetUInt64, fmi3UInt64)
NONE(fmi3SetUInt64, const fmi3UInt64)
NONE(fmi3GetBoolean, fmi3Boolean)
NONE(fmi3SetBoolean, const fmi3Boolean)
NONE(fmi3GetString, fmi3String)
NONE(fmi3SetString, const fmi3String)

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         size_t valueSizes[], fmi3Binary values[], size_t nValues)
{
    (void)valueReferences, (void)valueSizes, (void)values;
    return nValueReferences == 0 && nValues == 0 && instance ? fmi3OK : refuse(instance, "fmi3GetBinary");
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const size_t valueSizes[], const fmi3Binary values[], size_t nValues)
{
    (void)valueReferences, (void)valueSizes, (void)values;
    return nValueReferences == 0 && nValues == 0 && instance ? fmi3OK : refuse(instance, "fmi3SetBinary");
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    Snapshot *snapshot = *FMUState;
    const bool good = allows(instance, "fmi3GetFMUState", ANY_MODE) && slave_save(instance, &snapshot);
    *FMUState = snapshot;
    return status(good);
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    return status(allows(instance, "fmi3SetFMUState", ANY_MODE) && slave_restore(instance, FMUState));
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    if (FMUState) {
        free(*FMUState);
        *FMUState = NULL;
    }
    return status(allows(instance, "fmi3FreeFMUState", ANY_MODE));
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size)
{
    (void)FMUState;
    if (!allows(instance, "fmi3SerializedFMUStateSize", ANY_MODE))
        return fmi3Error;
    *size = slave_serialized_size();
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[], size_t size)
{
    return status(allows(instance, "fmi3SerializeFMUState", ANY_MODE) &&
                  slave_serialize(instance, FMUState, serializedState, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState)
{
    Snapshot *snapshot = *FMUState;
    const bool good =
        allows(instance, "fmi3DeserializeFMUState", ANY_MODE) && slave_deserialize(instance, serializedState, size, &snapshot);
    *FMUState = snapshot;
    return status(good);
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!allows(instance, "fmi3DoStep", STEPPING))
        return fmi3Error;
    const bool good = slave_do_step(instance, currentCommunicationPoint, communicationStepSize);
    *eventHandlingNeeded = fmi3False;
    *terminateSimulation = fmi3False;
    *earlyReturn = fmi3False;
    *lastSuccessfulTime = slave_time(instance);
    return status(good);
}

/* What follows belongs to capabilities that the model description does not claim; the names must exist all the same. */
#define REFUSE(NAME, ...)                                                                               \
    fmi3Status NAME(fmi3Instance instance, __VA_ARGS__)                                                 \
    {                                                                                                   \
        return refuse(instance, #NAME);                                                                 \
    }
#define REFUSE_BARE(NAME)                                                                               \
    fmi3Status NAME(fmi3Instance instance)                                                              \
    {                                                                                                   \
        return refuse(instance, #NAME);                                                                 \
    }

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

typedef fmi3ValueReference Reference;

REFUSE_BARE(fmi3EnterConfigurationMode)
REFUSE_BARE(fmi3ExitConfigurationMode)
REFUSE_BARE(fmi3EnterEventMode)
REFUSE_BARE(fmi3EnterStepMode)
REFUSE_BARE(fmi3EnterContinuousTimeMode)
REFUSE_BARE(fmi3EvaluateDiscreteStates)
REFUSE(fmi3GetClock, const Reference r[], size_t n, fmi3Clock v[])
REFUSE(fmi3SetClock, const Reference r[], size_t n, const fmi3Clock v[])
REFUSE(fmi3GetNumberOfVariableDependencies, Reference r, size_t *n)
REFUSE(fmi3GetVariableDependencies, Reference r, size_t i[], Reference f[], size_t j[], fmi3DependencyKind k[], size_t n)
REFUSE(fmi3GetDirectionalDerivative, const Reference u[], size_t nu, const Reference k[], size_t nk, const fmi3Float64 seed[],
       size_t ns, fmi3Float64 d[], size_t nd)
REFUSE(fmi3GetAdjointDerivative, const Reference u[], size_t nu, const Reference k[], size_t nk, const fmi3Float64 seed[],
       size_t ns, fmi3Float64 d[], size_t nd)
REFUSE(fmi3GetIntervalDecimal, const Reference r[], size_t n, fmi3Float64 v[], fmi3IntervalQualifier q[])
REFUSE(fmi3GetIntervalFraction, const Reference r[], size_t n, fmi3UInt64 c[], fmi3UInt64 d[], fmi3IntervalQualifier q[])
REFUSE(fmi3GetShiftDecimal, const Reference r[], size_t n, fmi3Float64 v[])
REFUSE(fmi3GetShiftFraction, const Reference r[], size_t n, fmi3UInt64 c[], fmi3UInt64 d[])
REFUSE(fmi3SetIntervalDecimal, const Reference r[], size_t n, const fmi3Float64 v[])
REFUSE(fmi3SetIntervalFraction, const Reference r[], size_t n, const fmi3UInt64 c[], const fmi3UInt64 d[])
REFUSE(fmi3SetShiftDecimal, const Reference r[], size_t n, const fmi3Float64 v[])
REFUSE(fmi3SetShiftFraction, const Reference r[], size_t n, const fmi3UInt64 c[], const fmi3UInt64 d[])
REFUSE(fmi3UpdateDiscreteStates, fmi3Boolean *a, fmi3Boolean *b, fmi3Boolean *c, fmi3Boolean *d, fmi3Boolean *e, fmi3Float64 *t)
REFUSE(fmi3CompletedIntegratorStep, fmi3Boolean a, fmi3Boolean *b, fmi3Boolean *c)
REFUSE(fmi3SetTime, fmi3Float64 t)
REFUSE(fmi3SetContinuousStates, const fmi3Float64 x[], size_t n)
REFUSE(fmi3GetContinuousStateDerivatives, fmi3Float64 x[], size_t n)
REFUSE(fmi3GetEventIndicators, fmi3Float64 x[], size_t n)
REFUSE(fmi3GetContinuousStates, fmi3Float64 x[], size_t n)
REFUSE(fmi3GetNominalsOfContinuousStates, fmi3Float64 x[], size_t n)
REFUSE(fmi3GetNumberOfEventIndicators, size_t *n)
REFUSE(fmi3GetNumberOfContinuousStates, size_t *n)
REFUSE(fmi3GetOutputDerivatives, const Reference r[], size_t n, const fmi3Int32 o[], fmi3Float64 v[], size_t nv)
REFUSE(fmi3ActivateModelPartition, Reference r, fmi3Float64 t)
