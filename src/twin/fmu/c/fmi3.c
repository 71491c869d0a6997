/* The functions of FMI 3.0 for co-simulation of a rig. */

#include <stdlib.h>

#include "fmi3.h"
#include "instance.h"

typedef struct {
    Instance it; /* first, so that a pointer to one is a pointer to the other */
    fmi3InstanceEnvironment host;
    fmi3LogMessageCallback log;
} Own;

static fmi3Status status_of(fmi3Instance instance, int done) {
    Own *own = instance;
    if (done)
        return fmi3OK;
    if (own->log)
        own->log(own->host, fmi3Error, "logStatusError", own->it.message);
    return fmi3Error;
}

fmi3Status fmi3_refuse(fmi3Instance instance, const char *what) {
    return status_of(instance, instance_refuse(instance, what));
}

/* ---- From instantiation to the end ------------------------------------------------------------- */

EXPORT fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
    const fmi3ValueReference intermediate[], size_t n, fmi3InstanceEnvironment host,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early;
    (void)intermediate, (void)n, (void)update;
    if (!fmi3_is_own_token(token, TOKEN, host, log))
        return NULL;
    Own *own = calloc(1, sizeof *own);
    if (!own)
        return NULL;
    instance_reset(&own->it);
    own->host = host;
    own->log = log;
    return own;
}

EXPORT void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerant,
                                              fmi3Float64 tolerance, fmi3Float64 start,
                                              fmi3Boolean stops, fmi3Float64 stop) {
    (void)tolerant, (void)tolerance, (void)stops, (void)stop;
    return status_of(instance, instance_enter(instance, start));
}

EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    return status_of(instance, instance_exit(instance));
}

EXPORT fmi3Status fmi3Terminate(fmi3Instance instance) {
    return status_of(instance, instance_end(instance));
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
    *last = own->it.state.model.v[TIME];
    return status_of(instance, done);
}

/* ---- Values ------------------------------------------------------------------------------------ */

fmi3Status fmi3_get(fmi3Instance instance, int type, fmi3ValueReference variable, double *value) {
    return status_of(instance, instance_get(instance, type, variable, value));
}

fmi3Status fmi3_set(fmi3Instance instance, int type, fmi3ValueReference variable, double value) {
    return status_of(instance, instance_set(instance, type, variable, value));
}

GET_AND_SET(Float64, fmi3Float64, REAL)
GET_AND_SET(Int32, fmi3Int32, INTEGER)
GET_AND_SET(Boolean, fmi3Boolean, BOOLEAN)
WITHOUT(GetBinary, "a binary", size_t sizes[], fmi3Binary value[], size_t m)
WITHOUT(SetBinary, "a binary", const size_t sizes[], const fmi3Binary value[], size_t m)
WITHOUT(GetClock, "a clock", fmi3Clock value[])
WITHOUT(SetClock, "a clock", const fmi3Clock value[])
WITHOUT(GetIntervalDecimal, "a clock", fmi3Float64 interval[], fmi3IntervalQualifier qualifier[])
WITHOUT(GetIntervalFraction, "a clock", fmi3UInt64 counter[], fmi3UInt64 resolution[],
        fmi3IntervalQualifier qualifier[])

/* ---- State: a copy of the bytes of one struct -------------------------------------------------- */

EXPORT fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *saved) {
    return status_of(instance, instance_save(instance, saved));
}

EXPORT fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState saved) {
    return status_of(instance, instance_restore(instance, saved, sizeof(State)));
}

EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *saved) {
    instance_forget(saved);
    return status_of(instance, 1);
}

EXPORT fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState saved,
                                             size_t *size) {
    *size = sizeof(State);
    return status_of(instance, saved != NULL);
}

EXPORT fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState saved,
                                        fmi3Byte bytes[], size_t size) {
    return status_of(instance, instance_serialize(instance, saved, bytes, size));
}

EXPORT fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[],
                                          size_t size, fmi3FMUState *saved) {
    return status_of(instance, instance_deserialize(instance, bytes, size, saved));
}

/* ---- Event mode -------------------------------------------------------------------------------- */

REFUSED(EnterEventMode, "event mode", fmi3Instance instance)
REFUSED(EnterStepMode, "event mode", fmi3Instance instance)
REFUSED(EvaluateDiscreteStates, "event mode", fmi3Instance instance)
REFUSED(UpdateDiscreteStates, "event mode", fmi3Instance instance, fmi3Boolean *update,
        fmi3Boolean *terminate, fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *next,
        fmi3Float64 *time)
