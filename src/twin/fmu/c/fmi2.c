/* The functions of FMI 2.0 for co-simulation; those of model exchange are there and refuse. */

#include <stdlib.h>
#include <string.h>

#include "instance.h"

typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum {
    fmi2DoStepStatus,
    fmi2PendingStatus,
    fmi2LastSuccessfulTime,
    fmi2Terminated
} fmi2StatusKind;

typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

typedef struct {
    fmi2Boolean newDiscreteStatesNeeded, terminateSimulation, nominalsOfContinuousStatesChanged;
    fmi2Boolean valuesOfContinuousStatesChanged, nextEventTimeDefined;
    fmi2Real nextEventTime;
} fmi2EventInfo;

typedef struct {
    Instance it; /* first, so that a pointer to one is a pointer to the other */
    double start;
    fmi2CallbackFunctions host;
    char name[];
} Component;

static void say(const fmi2CallbackFunctions *host, const char *name, const char *text) {
    if (host && host->logger) /* the text is an argument: it may hold a per cent sign */
        host->logger(host->componentEnvironment, name, fmi2Error, "logStatusError", "%s", text);
}

static fmi2Status status_of(fmi2Component c, int done) {
    Component *own = c;
    if (done)
        return fmi2OK;
    say(&own->host, own->name, own->it.message);
    return fmi2Error;
}

static fmi2Status refuse(fmi2Component c, const char *what) {
    return status_of(c, instance_refuse(c, what));
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }

EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n,
                                      const fmi2String categories[]) {
    (void)c, (void)on, (void)n, (void)categories; /* errors are always logged, nothing else is */
    return fmi2OK;
}

EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid,
                                     fmi2String resources, const fmi2CallbackFunctions *host,
                                     fmi2Boolean visible, fmi2Boolean logging) {
    (void)resources, (void)visible, (void)logging;
    name = name ? name : "";
    if (type != fmi2CoSimulation || !guid || strcmp(guid, TOKEN) != 0) {
        say(host, name, "this FMU is one for co-simulation, and has another GUID than the one given");
        return NULL;
    }
    Component *own = calloc(1, sizeof *own + strlen(name) + 1);
    if (!own)
        return NULL;
    instance_reset(&own->it);
    strcpy(own->name, name);
    if (host)
        own->host = *host;
    return own;
}

EXPORT void fmi2FreeInstance(fmi2Component c) { free(c); }

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerant, fmi2Real tolerance,
                                      fmi2Real start, fmi2Boolean stops, fmi2Real stop) {
    (void)tolerant, (void)tolerance, (void)stops, (void)stop;
    ((Component *)c)->start = start;
    return fmi2OK;
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Component *own = c;
    return status_of(c, instance_enter(&own->it, own->start));
}

EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    return status_of(c, instance_exit(c));
}

EXPORT fmi2Status fmi2Terminate(fmi2Component c) {
    return status_of(c, instance_end(c));
}

EXPORT fmi2Status fmi2Reset(fmi2Component c) {
    instance_reset(c);
    return fmi2OK;
}

#define GET_AND_SET(Name, type, kind)                                                              \
    EXPORT fmi2Status fmi2Get##Name(fmi2Component c, const fmi2ValueReference vr[], size_t n,      \
                                    type value[]) {                                                \
        for (size_t i = 0; i < n; i++) {                                                           \
            double found;                                                                          \
            if (!instance_get(c, kind, vr[i], &found))                         \
                return status_of(c, 0);                                                                 \
            value[i] = (type)found;                                                                \
        }                                                                                          \
        return fmi2OK;                                                                             \
    }                                                                                              \
    EXPORT fmi2Status fmi2Set##Name(fmi2Component c, const fmi2ValueReference vr[], size_t n,      \
                                    const type value[]) {                                          \
        for (size_t i = 0; i < n; i++)                                                             \
            if (!instance_set(c, kind, vr[i], (double)value[i]))               \
                return status_of(c, 0);                                                                 \
        return fmi2OK;                                                                             \
    }

GET_AND_SET(Real, fmi2Real, REAL)
GET_AND_SET(Integer, fmi2Integer, INTEGER)
GET_AND_SET(Boolean, fmi2Boolean, BOOLEAN)

/* ---- State: a copy of the bytes of one struct -------------------------------------------------- */

EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *saved) {
    return status_of(c, instance_save(c, saved));
}

EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate saved) {
    return status_of(c, instance_restore(c, saved, sizeof(State)));
}

EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *saved) {
    instance_forget(saved);
    return status_of(c, 1);
}

EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate saved, size_t *size) {
    *size = sizeof(State);
    return status_of(c, saved != NULL);
}

EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate saved, fmi2Byte bytes[],
                                        size_t size) {
    return status_of(c, instance_serialize(c, saved, bytes, size));
}

EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                          fmi2FMUstate *saved) {
    return status_of(c, instance_deserialize(c, bytes, size, saved));
}

/* ---- Co-simulation ----------------------------------------------------------------------------- */

EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real length, fmi2Boolean forward) {
    (void)forward;
    return status_of(c, instance_step(c, time, length));
}

EXPORT fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (kind != fmi2LastSuccessfulTime)
        return refuse(c, "a pending status");
    *value = ((Component *)c)->it.state.model.v[TIME];
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind,
                                       fmi2Boolean *value) {
    if (kind != fmi2Terminated)
        return refuse(c, "a pending status");
    *value = 0;
    return fmi2OK;
}

/* ---- What else the header declares ------------------------------------------------------------- */

#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

#define WITHOUT(Name, what, ...)                                                                   \
    EXPORT fmi2Status fmi2##Name(fmi2Component c, const fmi2ValueReference vr[], size_t n,         \
                                 __VA_ARGS__) {                                                    \
        return n ? refuse(c, what) : fmi2OK;                                                      \
    }
#define REFUSED(Name, what, ...)                                                                   \
    EXPORT fmi2Status fmi2##Name(__VA_ARGS__) { return refuse(c, what); }

WITHOUT(GetString, "a string", fmi2String value[])
WITHOUT(SetString, "a string", const fmi2String value[])
WITHOUT(SetRealInputDerivatives, "an input's derivative", const fmi2Integer order[],
        const fmi2Real value[])
WITHOUT(GetRealOutputDerivatives, "an output's derivative", const fmi2Integer order[],
        fmi2Real value[])
REFUSED(CancelStep, "a pending step", fmi2Component c)
REFUSED(GetStatus, "a pending status", fmi2Component c, fmi2StatusKind kind, fmi2Status *value)
REFUSED(GetIntegerStatus, "a status number", fmi2Component c, fmi2StatusKind kind,
        fmi2Integer *value)
REFUSED(GetStringStatus, "a pending status", fmi2Component c, fmi2StatusKind kind,
        fmi2String *value)
REFUSED(GetDirectionalDerivative, "a directional derivative", fmi2Component c,
        const fmi2ValueReference unknown[], size_t n, const fmi2ValueReference known[], size_t m,
        const fmi2Real by[], fmi2Real value[])
REFUSED(EnterEventMode, "model exchange", fmi2Component c)
REFUSED(NewDiscreteStates, "model exchange", fmi2Component c, fmi2EventInfo *info)
REFUSED(EnterContinuousTimeMode, "model exchange", fmi2Component c)
REFUSED(CompletedIntegratorStep, "model exchange", fmi2Component c, fmi2Boolean forward,
        fmi2Boolean *event, fmi2Boolean *terminate)
REFUSED(SetTime, "model exchange", fmi2Component c, fmi2Real time)
REFUSED(SetContinuousStates, "model exchange", fmi2Component c, const fmi2Real x[], size_t n)
REFUSED(GetDerivatives, "model exchange", fmi2Component c, fmi2Real x[], size_t n)
REFUSED(GetEventIndicators, "model exchange", fmi2Component c, fmi2Real x[], size_t n)
REFUSED(GetContinuousStates, "model exchange", fmi2Component c, fmi2Real x[], size_t n)
REFUSED(GetNominalsOfContinuousStates, "model exchange", fmi2Component c, fmi2Real x[], size_t n)
