/* The functions of FMI 3.0 that all FMUs of this project have alike; most of them refuse. */

#include <string.h>

#include "fmi3.h"

/* ---- Alike in all FMUs ------------------------------------------------------------------------- */

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n,
                                      const fmi3String categories[]) {
    (void)instance, (void)on, (void)n, (void)categories; /* errors are always logged */
    return fmi3OK;
}

int fmi3_is_own_token(fmi3String token, fmi3String own, fmi3InstanceEnvironment host,
                      fmi3LogMessageCallback log) {
    int is_own = token && strcmp(token, own) == 0;
    if (!is_own && log)
        log(host, fmi3Error, "logStatusError", "this FMU has another instantiation token");
    return is_own;
}

/* ---- Other kinds of FMU ------------------------------------------------------------------------ */

static fmi3Instance none(fmi3InstanceEnvironment host, fmi3LogMessageCallback log) {
    if (log)
        log(host, fmi3Error, "logStatusError", "this FMU is one for co-simulation only");
    return NULL;
}

EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token,
                                                 fmi3String resources, fmi3Boolean visible,
                                                 fmi3Boolean logging, fmi3InstanceEnvironment host,
                                                 fmi3LogMessageCallback log) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    return none(host, log);
}

EXPORT fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3InstanceEnvironment host, fmi3LogMessageCallback log,
    fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
    fmi3UnlockPreemptionCallback unlock) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    (void)update, (void)lock, (void)unlock;
    return none(host, log);
}

/* ---- Values of other types --------------------------------------------------------------------- */

GET_AND_SET(Float32, fmi3Float32, NOTHING)
GET_AND_SET(Int8, fmi3Int8, NOTHING)
GET_AND_SET(UInt8, fmi3UInt8, NOTHING)
GET_AND_SET(Int16, fmi3Int16, NOTHING)
GET_AND_SET(UInt16, fmi3UInt16, NOTHING)
GET_AND_SET(UInt32, fmi3UInt32, NOTHING)
GET_AND_SET(Int64, fmi3Int64, NOTHING)
GET_AND_SET(UInt64, fmi3UInt64, NOTHING)
WITHOUT(GetString, "a string", fmi3String value[], size_t m)
WITHOUT(SetString, "a string", const fmi3String value[], size_t m)
WITHOUT(GetShiftDecimal, "a clock", fmi3Float64 shift[])
WITHOUT(GetShiftFraction, "a clock", fmi3UInt64 counter[], fmi3UInt64 resolution[])
WITHOUT(SetIntervalDecimal, "a clock", const fmi3Float64 interval[])
WITHOUT(SetIntervalFraction, "a clock", const fmi3UInt64 counter[], const fmi3UInt64 resolution[])
WITHOUT(SetShiftDecimal, "a clock", const fmi3Float64 shift[])
WITHOUT(SetShiftFraction, "a clock", const fmi3UInt64 counter[], const fmi3UInt64 resolution[])
WITHOUT(GetOutputDerivatives, "an output's derivative", const fmi3Int32 order[],
        fmi3Float64 value[], size_t m)

/* ---- What else the header declares ------------------------------------------------------------- */

REFUSED(EnterConfigurationMode, "a structural parameter", fmi3Instance instance)
REFUSED(ExitConfigurationMode, "a structural parameter", fmi3Instance instance)
REFUSED(GetNumberOfVariableDependencies, "a dependency", fmi3Instance instance,
        fmi3ValueReference vr, size_t *n)
REFUSED(GetVariableDependencies, "a dependency", fmi3Instance instance, fmi3ValueReference of,
        size_t elements[], fmi3ValueReference on[], size_t their[], fmi3DependencyKind kind[],
        size_t n)
REFUSED(GetDirectionalDerivative, "a directional derivative", fmi3Instance instance,
        const fmi3ValueReference unknown[], size_t n, const fmi3ValueReference known[], size_t m,
        const fmi3Float64 seed[], size_t k, fmi3Float64 value[], size_t l)
REFUSED(GetAdjointDerivative, "an adjoint derivative", fmi3Instance instance,
        const fmi3ValueReference unknown[], size_t n, const fmi3ValueReference known[], size_t m,
        const fmi3Float64 seed[], size_t k, fmi3Float64 value[], size_t l)
REFUSED(EnterContinuousTimeMode, "model exchange", fmi3Instance instance)
REFUSED(CompletedIntegratorStep, "model exchange", fmi3Instance instance, fmi3Boolean forward,
        fmi3Boolean *event, fmi3Boolean *terminate)
REFUSED(SetTime, "model exchange", fmi3Instance instance, fmi3Float64 time)
REFUSED(SetContinuousStates, "model exchange", fmi3Instance instance, const fmi3Float64 x[],
        size_t n)
REFUSED(GetContinuousStateDerivatives, "model exchange", fmi3Instance instance, fmi3Float64 x[],
        size_t n)
REFUSED(GetEventIndicators, "model exchange", fmi3Instance instance, fmi3Float64 z[], size_t n)
REFUSED(GetContinuousStates, "model exchange", fmi3Instance instance, fmi3Float64 x[], size_t n)
REFUSED(GetNominalsOfContinuousStates, "model exchange", fmi3Instance instance, fmi3Float64 x[],
        size_t n)
REFUSED(GetNumberOfEventIndicators, "model exchange", fmi3Instance instance, size_t *n)
REFUSED(GetNumberOfContinuousStates, "model exchange", fmi3Instance instance, size_t *n)
REFUSED(ActivateModelPartition, "scheduled execution", fmi3Instance instance,
        fmi3ValueReference clock, fmi3Float64 time)
