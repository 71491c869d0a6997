/* The functions of FMI 3.0 for co-simulation; those of other kinds are there and refuse. */

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "instance.h"

typedef void *fmi3Instance, *fmi3InstanceEnvironment, *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8, fmi3Byte;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean, fmi3Clock;
typedef const char *fmi3String;
typedef const fmi3Byte *fmi3Binary;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum {
    fmi3Independent,
    fmi3Constant,
    fmi3Fixed,
    fmi3Tunable,
    fmi3Discrete,
    fmi3Dependent
} fmi3DependencyKind;
typedef enum {
    fmi3IntervalNotYetKnown,
    fmi3IntervalUnchanged,
    fmi3IntervalChanged
} fmi3IntervalQualifier;

typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3IntermediateUpdateCallback)(fmi3InstanceEnvironment, fmi3Float64, fmi3Boolean,
                                               fmi3Boolean, fmi3Boolean, fmi3Boolean,
                                               fmi3Boolean *, fmi3Float64 *);
typedef void (*fmi3ClockUpdateCallback)(fmi3InstanceEnvironment);
typedef void (*fmi3LockPreemptionCallback)(void);
typedef void (*fmi3UnlockPreemptionCallback)(void);

typedef struct {
    Instance it; /* first, so that a pointer to one is a pointer to the other */
    fmi3InstanceEnvironment host;
    fmi3LogMessageCallback log;
} Own;

static fmi3Status told(fmi3Instance instance, int done) {
    Own *own = instance;
    if (done)
        return fmi3OK;
    if (own->log)
        own->log(own->host, fmi3Error, "logStatusError", own->it.message);
    return fmi3Error;
}

static fmi3Status refused(fmi3Instance instance, const char *what) {
    return told(instance, instance_refuse(instance, what));
}

/* ---- From instantiation to the end ------------------------------------------------------------- */

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n,
                                      const fmi3String categories[]) {
    (void)instance, (void)on, (void)n, (void)categories; /* errors are always told */
    return fmi3OK;
}

EXPORT fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
    const fmi3ValueReference intermediate[], size_t n, fmi3InstanceEnvironment host,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early;
    (void)intermediate, (void)n, (void)update;
    if (!token || strcmp(token, TOKEN) != 0) {
        if (log)
            log(host, fmi3Error, "logStatusError", "this FMU has another instantiation token");
        return NULL;
    }
    Own *own = calloc(1, sizeof *own);
    if (!own)
        return NULL;
    instance_reset(&own->it);
    own->host = host;
    own->log = log;
    return own;
}

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

EXPORT void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerant,
                                              fmi3Float64 tolerance, fmi3Float64 start,
                                              fmi3Boolean stops, fmi3Float64 stop) {
    (void)tolerant, (void)tolerance, (void)stops, (void)stop;
    return told(instance, instance_enter(instance, start));
}

EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    return told(instance, instance_exit(instance));
}

EXPORT fmi3Status fmi3Terminate(fmi3Instance instance) {
    return told(instance, instance_end(instance));
}

EXPORT fmi3Status fmi3Reset(fmi3Instance instance) {
    instance_reset(instance);
    return fmi3OK;
}

EXPORT fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 length,
                             fmi3Boolean forward, fmi3Boolean *event, fmi3Boolean *terminate,
                             fmi3Boolean *early, fmi3Float64 *last) {
    Own *own = instance;
    (void)forward;
    *event = *terminate = *early = false;
    int done = instance_step(&own->it, time, length);
    *last = own->it.state.rig.v[TIME];
    return told(instance, done);
}

/* ---- Values: Float64, Int32 and Boolean; there are none of another type ------------------------ */

#define GET_AND_SET(Name, type, kind)                                                              \
    EXPORT fmi3Status fmi3Get##Name(fmi3Instance instance, const fmi3ValueReference vr[],          \
                                    size_t n, type value[], size_t m) {                            \
        if (n != m)                                                                                \
            return refused(instance, "an array");                                                  \
        for (size_t i = 0; i < n; i++) {                                                           \
            double found;                                                                          \
            if (!instance_get(instance, kind, vr[i], &found))                        \
                return told(instance, 0);                                                          \
            value[i] = (type)found;                                                                \
        }                                                                                          \
        return fmi3OK;                                                                             \
    }                                                                                              \
    EXPORT fmi3Status fmi3Set##Name(fmi3Instance instance, const fmi3ValueReference vr[],          \
                                    size_t n, const type value[], size_t m) {                      \
        if (n != m)                                                                                \
            return refused(instance, "an array");                                                  \
        for (size_t i = 0; i < n; i++)                                                             \
            if (!instance_set(instance, kind, vr[i], (double)value[i]))              \
                return told(instance, 0);                                                          \
        return fmi3OK;                                                                             \
    }

GET_AND_SET(Float64, fmi3Float64, REAL)
GET_AND_SET(Int32, fmi3Int32, INTEGER)
GET_AND_SET(Boolean, fmi3Boolean, BOOLEAN)
GET_AND_SET(Float32, fmi3Float32, NOTHING)
GET_AND_SET(Int8, fmi3Int8, NOTHING)
GET_AND_SET(UInt8, fmi3UInt8, NOTHING)
GET_AND_SET(Int16, fmi3Int16, NOTHING)
GET_AND_SET(UInt16, fmi3UInt16, NOTHING)
GET_AND_SET(UInt32, fmi3UInt32, NOTHING)
GET_AND_SET(Int64, fmi3Int64, NOTHING)
GET_AND_SET(UInt64, fmi3UInt64, NOTHING)

/* Functions that take an instance and what there is none of: nothing of it is done without error. */
#define WITHOUT(Name, what, ...)                                                                   \
    EXPORT fmi3Status fmi3##Name(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,   \
                                 __VA_ARGS__) {                                                    \
        (void)vr;                                                                                  \
        return n ? refused(instance, what) : fmi3OK;                                               \
    }

#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

WITHOUT(GetString, "a string", fmi3String value[], size_t m)
WITHOUT(SetString, "a string", const fmi3String value[], size_t m)
WITHOUT(GetBinary, "a binary", size_t sizes[], fmi3Binary value[], size_t m)
WITHOUT(SetBinary, "a binary", const size_t sizes[], const fmi3Binary value[], size_t m)
WITHOUT(GetClock, "a clock", fmi3Clock value[])
WITHOUT(SetClock, "a clock", const fmi3Clock value[])
WITHOUT(GetIntervalDecimal, "a clock", fmi3Float64 interval[], fmi3IntervalQualifier qualifier[])
WITHOUT(GetIntervalFraction, "a clock", fmi3UInt64 counter[], fmi3UInt64 resolution[],
        fmi3IntervalQualifier qualifier[])
WITHOUT(GetShiftDecimal, "a clock", fmi3Float64 shift[])
WITHOUT(GetShiftFraction, "a clock", fmi3UInt64 counter[], fmi3UInt64 resolution[])
WITHOUT(SetIntervalDecimal, "a clock", const fmi3Float64 interval[])
WITHOUT(SetIntervalFraction, "a clock", const fmi3UInt64 counter[], const fmi3UInt64 resolution[])
WITHOUT(SetShiftDecimal, "a clock", const fmi3Float64 shift[])
WITHOUT(SetShiftFraction, "a clock", const fmi3UInt64 counter[], const fmi3UInt64 resolution[])
WITHOUT(GetOutputDerivatives, "an output's derivative", const fmi3Int32 order[],
        fmi3Float64 value[], size_t m)

/* ---- State: a copy of the bytes of one struct -------------------------------------------------- */

EXPORT fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *saved) {
    return told(instance, instance_save(instance, saved));
}

EXPORT fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState saved) {
    return told(instance, instance_restore(instance, saved, sizeof(State)));
}

EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *saved) {
    instance_forget(saved);
    return told(instance, 1);
}

EXPORT fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState saved,
                                             size_t *size) {
    *size = sizeof(State);
    return told(instance, saved != NULL);
}

EXPORT fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState saved,
                                        fmi3Byte bytes[], size_t size) {
    return told(instance, instance_serialize(instance, saved, bytes, size));
}

EXPORT fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[],
                                          size_t size, fmi3FMUState *saved) {
    return told(instance, instance_deserialize(instance, bytes, size, saved));
}

/* ---- What else the header declares ------------------------------------------------------------- */

#define REFUSED(Name, what, ...)                                                                   \
    EXPORT fmi3Status fmi3##Name(__VA_ARGS__) { return refused(instance, what); }

REFUSED(EnterEventMode, "event mode", fmi3Instance instance)
REFUSED(EnterStepMode, "event mode", fmi3Instance instance)
REFUSED(EvaluateDiscreteStates, "event mode", fmi3Instance instance)
REFUSED(UpdateDiscreteStates, "event mode", fmi3Instance instance, fmi3Boolean *update,
        fmi3Boolean *terminate, fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *next,
        fmi3Float64 *time)
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
