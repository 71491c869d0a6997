#include "instance.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int fail(Instance *it, const char *what, const char *why) {
    snprintf(it->message, sizeof it->message, "%s %s", what, why);
    return 0;
}

int instance_refuse(Instance *it, const char *what) {
    return fail(it, what, "is not a part of this FMU");
}

void instance_reset(Instance *it) {
    memset(it, 0, sizeof *it);
    model_reset(&it->state.model, 0);
}

/* Whether there is a variable of this type. */
static int known(Instance *it, int type, unsigned variable) {
    char what[64];
    if (variable < VARIABLES && KINDS[variable].type == type)
        return 1;
    snprintf(what, sizeof what, "value reference %u", variable);
    return fail(it, what, "is none of a variable of this type");
}

int instance_get(Instance *it, int type, unsigned variable, double *value) {
    const char *why = NULL;
    if (!known(it, type, variable))
        return 0;
    if (it->state.phase == BEGINNING) /* what is measured follows from what has been set */
        why = model_begin(&it->state.model);
    *value = it->state.model.v[variable];
    return why ? fail(it, "begin:", why) : 1;
}

int instance_set(Instance *it, int type, unsigned variable, double value) {
    if (!known(it, type, variable))
        return 0;
    const Kind *kind = &KINDS[variable];
    if (kind->set == NEVER)
        return fail(it, kind->name, "cannot be set");
    if (kind->set == AT_START && it->state.phase > BEGINNING)
        return fail(it, kind->name, "can be set before the first step only");
    const char *why = model_set(&it->state.model, variable, value);
    return why ? fail(it, kind->name, why) : 1;
}

int instance_enter(Instance *it, double start) {
    if (it->state.phase != MADE)
        return fail(it, "initialization mode", "is entered once, after instantiation or reset");
    it->state.model.start = start;
    it->state.phase = BEGINNING;
    return 1;
}

int instance_exit(Instance *it) {
    if (it->state.phase != BEGINNING)
        return fail(it, "initialization mode", "has to be entered before");
    const char *why = model_begin(&it->state.model);
    if (why)
        return fail(it, "begin:", why);
    it->state.phase = STEPPING;
    return 1;
}

/* A communication step: so many control periods, the commanded rates held. */
int instance_step(Instance *it, double time, double length) {
    Model *model = &it->state.model;
    double periods = length / PERIOD, whole = rint(periods);
    double now = model->start + (double)model->tick * PERIOD;
    char what[96];
    if (it->state.phase != STEPPING)
        return fail(it, "a step", "can be done after initialization only");
    if (!(whole >= 1 && whole < 1e9 && fabs(periods - whole) < 1e-3)) {
        snprintf(what, sizeof what, "a step of %g s", length);
        return fail(it, what, "is no multiple of the control period, rig.period");
    }
    if (!(fabs(time - now) < 0.4 * PERIOD)) { /* a host that adds up steps drifts off a little */
        snprintf(what, sizeof what, "a step from %.9g s", time);
        snprintf(it->message, sizeof it->message, "%s, but this FMU is at %.9g s", what, now);
        return 0;
    }
    for (int64_t i = (int64_t)whole; i > 0; i--)
        model_advance(model);
    return 1;
}

int instance_end(Instance *it) {
    if (it->state.phase != STEPPING)
        return fail(it, "a simulation", "that does not run cannot be ended");
    it->state.phase = ENDED;
    return 1;
}

static int copied(Instance *it, const void *bytes, void **saved) {
    if (!*saved)
        *saved = malloc(sizeof(State));
    if (!*saved)
        return fail(it, "a state", "does not fit into the memory");
    memcpy(*saved, bytes, sizeof(State));
    return 1;
}

/* Whether bytes are a state of this very FMU, exported from the same scenario. */
static int own(Instance *it, const void *bytes, size_t size) {
    State state;
    if (size == sizeof state) {
        memcpy(&state, bytes, size);
        if (state.model.kind == KIND && state.phase >= MADE && state.phase <= ENDED)
            return 1;
    }
    return fail(it, "a state", "of another FMU cannot be restored");
}

int instance_save(Instance *it, void **saved) { return copied(it, &it->state, saved); }

int instance_restore(Instance *it, const void *bytes, size_t size) {
    if (!own(it, bytes, size))
        return 0;
    memcpy(&it->state, bytes, size);
    return 1;
}

int instance_serialize(Instance *it, const void *saved, void *bytes, size_t size) {
    if (size < sizeof(State))
        return fail(it, "a state", "needs more bytes than it is given");
    memcpy(bytes, saved, sizeof(State));
    return 1;
}

int instance_deserialize(Instance *it, const void *bytes, size_t size, void **saved) {
    return own(it, bytes, size) && copied(it, bytes, saved);
}

void instance_forget(void **saved) {
    if (saved) {
        free(*saved);
        *saved = NULL;
    }
}
