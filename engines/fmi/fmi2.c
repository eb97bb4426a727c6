/* FMI 2.0 for co-simulation on top of slave.h. */
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "slave.h"

#define ERROR_CATEGORY "logStatusError"

typedef struct {
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment component;
    char name[]; /* the importer's name for this instance */
} Environment;

static void log_line(void *environment, const char *message)
{
    const Environment *e = environment;
    /* our messages hold no per cent sign, so they are their own format */
    if (e->logger)
        e->logger(e->component, e->name, fmi2Error, ERROR_CATEGORY, message);
}

static fmi2Status status(bool good) { return good ? fmi2OK : fmi2Error; }

static bool allows(Slave *s, const char *function, unsigned modes) { return s && slave_allows(s, function, modes); }

static fmi2Status refuse(Slave *s, const char *function)
{
    return s ? status(slave_fail(s, "%s is not provided", function)) : fmi2Error;
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories, const fmi2String categories[])
{
    if (!allows(c, "fmi2SetDebugLogging", ANY_MODE))
        return fmi2Error;
    bool wanted = nCategories == 0;
    for (size_t i = 0; i < nCategories; i++)
        wanted = wanted || strcmp(categories[i], ERROR_CATEGORY) == 0;
    slave_set_logging(c, loggingOn && wanted);
    return fmi2OK;
}

static const char *instantiation_problem(fmi2String name, fmi2Type type, fmi2String guid)
{
    if (!name || !*name)
        return "an instance needs a name";
    if (type != fmi2CoSimulation)
        return "this FMU is for co-simulation only";
    if (!guid || strcmp(guid, ENGINE_TOKEN) != 0)
        return "the guid is not that of this FMU";
    return NULL;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID, fmi2String fmuResourceLocation,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean loggingOn)
{
    (void)visible;
    const char *problem = instantiation_problem(instanceName, fmuType, fmuGUID);
    if (problem || !functions) {
        if (functions && functions->logger)
            functions->logger(functions->componentEnvironment, instanceName ? instanceName : "", fmi2Error, ERROR_CATEGORY,
                              problem);
        return NULL;
    }
    Environment *e = malloc(sizeof(Environment) + strlen(instanceName) + 1);
    if (!e)
        return NULL;
    e->logger = functions->logger;
    e->component = functions->componentEnvironment;
    strcpy(e->name, instanceName);
    Slave *s = slave_new(log_line, e, loggingOn != fmi2False, fmuResourceLocation);
    if (!s)
        free(e);
    return s;
}

void fmi2FreeInstance(fmi2Component c)
{
    if (!c)
        return;
    free(slave_environment(c));
    slave_free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    (void)toleranceDefined;
    (void)tolerance;
    return status(allows(c, "fmi2SetupExperiment", INSTANTIATED) &&
                  slave_set_experiment(c, startTime, stopTimeDefined != fmi2False, stopTime));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    if (!allows(c, "fmi2EnterInitializationMode", INSTANTIATED))
        return fmi2Error;
    slave_enter_initialization(c);
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    if (!allows(c, "fmi2ExitInitializationMode", INITIALIZATION))
        return fmi2Error;
    return status(slave_exit_initialization(c));
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    if (!allows(c, "fmi2Terminate", STEPPING))
        return fmi2Error;
    slave_terminate(c);
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    if (!allows(c, "fmi2Reset", ANY_MODE))
        return fmi2Error;
    slave_reset(c);
    return fmi2OK;
}

/* FMI 2.0 lets nothing be read before initialization mode. */
enum { READABLE = INITIALIZATION | STEPPING | TERMINATED | FAILED, WRITABLE = INSTANTIATED | INITIALIZATION | STEPPING };

#define GET(NAME, TYPE, KIND)                                                                           \
    fmi2Status NAME(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, TYPE value[])           \
    {                                                                                                   \
        bool good = allows(c, #NAME, READABLE);                                                         \
        for (size_t i = 0; good && i < nvr; i++) {                                                      \
            double found = 0.0;                                                                         \
            good = slave_get(c, vr[i], KIND, &found);                                                   \
            if (good)                                                                                   \
                value[i] = (TYPE)found;                                                                 \
        }                                                                                               \
        return status(good);                                                                            \
    }

#define SET(NAME, TYPE, KIND)                                                                           \
    fmi2Status NAME(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const TYPE value[])     \
    {                                                                                                   \
        bool good = allows(c, #NAME, WRITABLE);                                                         \
        for (size_t i = 0; good && i < nvr; i++)                                                        \
            good = slave_set(c, vr[i], KIND, value[i]);                                                 \
        return status(good);                                                                            \
    }

/* Types that no engine variable has: good for no variables at all, else an error. */
#define NONE(NAME, TYPE)                                                                                \
    fmi2Status NAME(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, TYPE value[])           \
    {                                                                                                   \
        (void)vr;                                                                                       \
        (void)value;                                                                                    \
        return nvr == 0 && c ? fmi2OK : refuse(c, #NAME);                                               \
    }

GET(fmi2GetReal, fmi2Real, REAL)
SET(fmi2SetReal, fmi2Real, REAL)
GET(fmi2GetInteger, fmi2Integer, INTEGER)
SET(fmi2SetInteger, fmi2Integer, INTEGER)
NONE(fmi2GetBoolean, fmi2Boolean)
NONE(fmi2SetBoolean, const fmi2Boolean)
NONE(fmi2GetString, fmi2String)
NONE(fmi2SetString, const fmi2String)

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    Snapshot *snapshot = *FMUstate;
    const bool good = allows(c, "fmi2GetFMUstate", ANY_MODE) && slave_save(c, &snapshot);
    *FMUstate = snapshot;
    return status(good);
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    return status(allows(c, "fmi2SetFMUstate", ANY_MODE) && slave_restore(c, FMUstate));
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    if (FMUstate) {
        free(*FMUstate);
        *FMUstate = NULL;
    }
    return status(allows(c, "fmi2FreeFMUstate", ANY_MODE));
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    (void)FMUstate;
    if (!allows(c, "fmi2SerializedFMUstateSize", ANY_MODE))
        return fmi2Error;
    *size = slave_serialized_size();
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    return status(allows(c, "fmi2SerializeFMUstate", ANY_MODE) &&
                  slave_serialize(c, FMUstate, (unsigned char *)serializedState, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size, fmi2FMUstate *FMUstate)
{
    Snapshot *snapshot = *FMUstate;
    const bool good =
        allows(c, "fmi2DeSerializeFMUstate", ANY_MODE) && slave_deserialize(c, (const unsigned char *)serializedState, size, &snapshot);
    *FMUstate = snapshot;
    return status(good);
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[])
{
    (void)vUnknown_ref, (void)nUnknown, (void)vKnown_ref, (void)nKnown, (void)dvKnown, (void)dvUnknown;
    return refuse(c, "fmi2GetDirectionalDerivative");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[],
                                       const fmi2Real value[])
{
    (void)vr, (void)nvr, (void)order, (void)value;
    return refuse(c, "fmi2SetRealInputDerivatives");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[],
                                        fmi2Real value[])
{
    (void)vr, (void)nvr, (void)order, (void)value;
    return refuse(c, "fmi2GetRealOutputDerivatives");
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    return status(allows(c, "fmi2DoStep", STEPPING) && slave_do_step(c, currentCommunicationPoint, communicationStepSize));
}

fmi2Status fmi2CancelStep(fmi2Component c) { return refuse(c, "fmi2CancelStep"); }

/* Steps are never pending; of the five questions only two have an answer, the others are discarded as FMI asks for. */
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    if (!c || s != fmi2LastSuccessfulTime)
        return fmi2Discard;
    *value = slave_time(c);
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    if (!c || s != fmi2Terminated)
        return fmi2Discard;
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    (void)c, (void)s, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value)
{
    (void)c, (void)s, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    (void)c, (void)s, (void)value;
    return fmi2Discard;
}
