/* An FMI 3.0 engine that uses what ours do not: arrays, Float32 and early return.
 *
 * A lag x' = (u - x) / 0.05 s, integrated exactly however a step is cut.  What it does on the way depends on TROUBLE.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3FunctionTypes.h"

#define LAG 0.05
#define PERIOD 0.0015 /* s between early returns: no divisor of a step of 4 ms */

enum { LEVERS = 2, FORCES, SPEED, PRESSURE, GAINS, TROUBLE, EGT, SETS, RUN };
enum { NOTHING, EARLY, STUCK, TERMINATE, TINY, DISCARDS };

typedef struct {
    fmi3Boolean early_allowed;
    double time, x, levers[2], gains[3];
    float pressure;
    fmi3Boolean run;
    int trouble, sets;
    long long count; /* early returns */
} Engine;

#define S ((Engine *)instance)

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n, fmi3InstanceEnvironment where,
                                         fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)required, (void)n, (void)where,
        (void)log, (void)update, (void)events;
    Engine *e = calloc(1, sizeof(Engine));
    e->early_allowed = early;
    e->levers[0] = 10.0;
    e->levers[1] = 35.0;
    e->gains[0] = 1.0, e->gains[1] = 2.0, e->gains[2] = 3.0;
    e->pressure = 1013.25f;
    e->run = fmi3True;
    return e;
}

void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean d, fmi3Float64 t, fmi3Float64 start,
                                       fmi3Boolean s, fmi3Float64 stop)
{
    (void)instance, (void)d, (void)t, (void)start, (void)s, (void)stop;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    return S ? fmi3OK : fmi3Error;
}

fmi3Status fmi3Terminate(fmi3Instance instance) { return S ? fmi3OK : fmi3Error; }

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3Float64 v[], size_t m)
{
    for (size_t i = 0, k = 0; i < n; i++) {
        const size_t size = r[i] == LEVERS ? 2 : r[i] == GAINS ? 3 : 0;
        if (!size || k + size > m)
            return fmi3Error;
        memcpy(r[i] == LEVERS ? S->levers : S->gains, v + k, size * sizeof(double));
        k += size;
    }
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3Float64 v[], size_t m)
{
    for (size_t i = 0, k = 0; i < n; i++) {
        if (k + (r[i] == FORCES ? 3 : 1) > m)
            return fmi3Error;
        if (r[i] == FORCES) {
            v[k++] = S->levers[1];
            v[k++] = S->run ? S->gains[1] * S->x * (double)S->pressure / 1013.25 : 0.0;
            v[k++] = S->gains[0];
        } else if (r[i] == EGT) {
            v[k++] = 20.0;
        } else if (r[i] == SETS) {
            v[k++] = S->sets;
        } else {
            return fmi3Error;
        }
    }
    return fmi3OK;
}

fmi3Status fmi3SetFloat32(fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3Float32 v[], size_t m)
{
    if (n != 1 || m != 1 || r[0] != PRESSURE)
        return fmi3Error;
    S->pressure = v[0];
    S->sets++;
    return fmi3OK;
}

fmi3Status fmi3GetFloat32(fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3Float32 v[], size_t m)
{
    if (n != 1 || m != 1 || r[0] != SPEED)
        return fmi3Error;
    v[0] = (float)(60000.0 * S->x);
    return fmi3OK;
}

fmi3Status fmi3SetInt32(fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3Int32 v[], size_t m)
{
    if (n != 1 || m != 1 || r[0] != TROUBLE)
        return fmi3Error;
    S->trouble = v[0];
    return fmi3OK;
}

fmi3Status fmi3SetBoolean(fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3Boolean v[], size_t m)
{
    if (n != 1 || m != 1 || r[0] != RUN)
        return fmi3Error;
    S->run = v[0];
    return fmi3OK;
}

static void advance(Engine *e, double length)
{
    const double u = (e->levers[0] - 10.0) / 100.0;
    e->x = u + (e->x - u) * exp(-length / LAG);
    e->time += length;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 step, fmi3Boolean no, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *reached)
{
    (void)no;
    *event = *terminate = *early = fmi3False;
    if (fabs(time - S->time) > 1e-9 || step <= 0.0)
        return fmi3Error; /* from elsewhere */
    *terminate = S->time > 0.0 && S->trouble == TERMINATE;
    if (S->trouble == DISCARDS)
        return fmi3Discard;
    if (S->trouble == STUCK || S->trouble == TINY) {
        *early = fmi3True;
        S->time += S->trouble == TINY ? 1e-9 : 0.0;
        *reached = S->time;
        return fmi3OK;
    }
    const double end = time + step;
    double next = (double)(S->count + 1) * PERIOD;
    if (S->trouble == EARLY && next < time + 1e-9) /* at the end of the last step: nothing to return for */
        next = (double)(++S->count + 1) * PERIOD;
    if (S->trouble == EARLY && S->early_allowed && next < end - 1e-9) {
        advance(S, next - S->time);
        S->count++;
        *early = fmi3True;
    } else {
        advance(S, end - S->time);
    }
    *reached = S->time;
    return fmi3OK;
}

const char *fmi3GetVersion(void) { return "3.0"; }

/* What else FMI wants an FMU to export, and what nobody calls here. */
#define STUB(NAME) \
    fmi3Status fmi3##NAME(void) { return fmi3Error; }

STUB(ActivateModelPartition) STUB(CompletedIntegratorStep) STUB(DeserializeFMUState)
STUB(EnterConfigurationMode) STUB(EnterContinuousTimeMode) STUB(EnterEventMode) STUB(EnterStepMode) STUB(EvaluateDiscreteStates)
STUB(ExitConfigurationMode) STUB(FreeFMUState) STUB(GetAdjointDerivative) STUB(GetBinary) STUB(GetBoolean)
STUB(GetClock) STUB(GetContinuousStateDerivatives) STUB(GetContinuousStates) STUB(GetDirectionalDerivative)
STUB(GetEventIndicators) STUB(GetFMUState) STUB(GetInt16) STUB(GetInt32) STUB(GetInt64) STUB(GetInt8)
STUB(GetIntervalDecimal) STUB(GetIntervalFraction) STUB(GetNominalsOfContinuousStates)
STUB(GetNumberOfContinuousStates) STUB(GetNumberOfEventIndicators) STUB(GetNumberOfVariableDependencies)
STUB(GetOutputDerivatives) STUB(GetShiftDecimal) STUB(GetShiftFraction) STUB(GetString) STUB(GetUInt16)
STUB(GetUInt32) STUB(GetUInt64) STUB(GetUInt8) STUB(GetVariableDependencies) STUB(InstantiateModelExchange)
STUB(InstantiateScheduledExecution) STUB(SerializeFMUState) STUB(SerializedFMUStateSize) STUB(SetBinary)
STUB(SetClock) STUB(SetContinuousStates) STUB(SetDebugLogging) STUB(SetFMUState) STUB(SetInt16)
STUB(SetInt64) STUB(SetInt8) STUB(SetIntervalDecimal) STUB(SetIntervalFraction) STUB(SetShiftDecimal)
STUB(SetShiftFraction) STUB(SetString) STUB(SetTime) STUB(SetUInt16) STUB(SetUInt32) STUB(SetUInt64)
STUB(SetUInt8) STUB(Reset) STUB(UpdateDiscreteStates)
