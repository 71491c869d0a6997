/* A drive as a node of a simulated CAN bus: the functions of FMI 3.0, with FMI-LS-BUS 1.0.

   In event mode operations of the bus come in by Rx_Data while Rx_Clock is active, and go out by
   Tx_Data while Tx_Clock is. Tx_Clock is a triggered output: it ticks in the first event mode after
   the drive has sent something, so an answer is one communication step later than its request. */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "drive.h"
#include "fmi3.h"
#include "variables.h"

enum Phase { MADE, BEGINNING, EVENTS, STEPPING, ENDED };
enum { RX_DATA = VARIABLES, TX_DATA, RX_CLOCK, TX_CLOCK };

static const double MAX_STEP_S = 0.001; /* of the drive, within a communication step */

typedef struct {
    uint64_t kind; /* which FMU wrote it; a state of another is refused */
    int phase, has_events;
    double time;
    double v[VARIABLES]; /* every variable of the description but those of the bus */
    int rx_clock, tx_clock;
    Operations rx, tx;
    Drive drive;
} State; /* what is saved and restored */

typedef struct {
    State state;
    fmi3InstanceEnvironment host;
    fmi3LogMessageCallback log;
} Node;

/* ---- What is logged ---------------------------------------------------------------------------- */

static fmi3Status log_line(Node *node, fmi3Status status, const char *what, const char *why) {
    char line[256];
    snprintf(line, sizeof line, "%s %s", what, why);
    if (node->log)
        node->log(node->host, status, status == fmi3Warning ? "logStatusWarning" : "logStatusError",
                  line);
    return status;
}

static fmi3Status fail(Node *node, const char *what, const char *why) {
    return log_line(node, fmi3Error, what, why);
}

fmi3Status fmi3_refuse(fmi3Instance instance, const char *what) {
    return fail(instance, what, "is not a part of this FMU");
}

/* Whether the node is in a phase; else says what needs it. */
static int is_in(Node *node, int phase, const char *what) {
    static const char *const NEEDED[] = {
        "needs a new or reset instance", "needs initialization mode", "needs event mode",
        "needs step mode", "needs an ended simulation",
    };
    if (node->state.phase == phase)
        return 1;
    fail(node, what, NEEDED[phase]);
    return 0;
}

/* ---- From instantiation to the end ------------------------------------------------------------- */

/* Give the drive what is set from outside. */
static void pass_inputs(State *state) {
    Drive *drive = &state->drive;
    drive->load_torque = state->v[LOAD_TORQUE];
    drive->sto_closed = state->v[STO_CLOSED] != 0.0;
    drive->dc_link = state->v[DC_LINK] != 0.0;
}

/* Power the drive on with the present parameters, its configuration of the bus and boot-up first. */
static void power_on(State *state) {
    Drive *drive = &state->drive;
    memset(drive, 0, sizeof *drive);
    drive->node = (int)state->v[NODE];
    drive->start_counts = (int32_t)state->v[START_COUNTS];
    drive->inertia = state->v[SHAFT_INERTIA];
    drive->friction = state->v[SHAFT_FRICTION];
    pass_inputs(state);
    write_bit_rate(&drive->sent, (uint32_t)state->v[BIT_RATE]);
    write_buffering(&drive->sent);
    drive_power_on(drive);
}

static void show_outputs(State *state) {
    state->v[TIME] = state->time;
    state->v[ANGLE] = state->drive.angle;
    state->v[RATE] = state->drive.rate;
    state->v[TORQUE] = state->drive.torque;
    state->v[STATUS_WORD] = drive_status(&state->drive);
    state->v[NMT_STATE] = state->drive.nmt;
}

static void reset(State *state) {
    int has_events = state->has_events;
    memset(state, 0, sizeof *state);
    state->kind = KIND;
    state->has_events = has_events;
    for (int i = 0; i < VARIABLES; i++)
        state->v[i] = KINDS[i].start;
    power_on(state);
    show_outputs(state);
}

EXPORT fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
    const fmi3ValueReference intermediate[], size_t n, fmi3InstanceEnvironment host,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    if (!fmi3_is_own_token(token, TOKEN, host, log))
        return NULL;
    Node *node = calloc(1, sizeof *node);
    if (!node)
        return NULL;
    node->host = host;
    node->log = log;
    node->state.has_events = events;
    reset(&node->state);
    return node;
}

EXPORT void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerant,
                                              fmi3Float64 tolerance, fmi3Float64 start,
                                              fmi3Boolean stops, fmi3Float64 stop) {
    Node *node = instance;
    if (!is_in(node, MADE, "initialization mode"))
        return fmi3Error;
    node->state.phase = BEGINNING;
    node->state.time = start;
    show_outputs(&node->state);
    return fmi3OK;
}

/* Enter event mode: what the drive has sent is on the bus now. */
static void begin_events(State *state) {
    Drive *drive = &state->drive;
    state->phase = EVENTS;
    state->rx_clock = 0;
    state->rx.size = 0;
    state->tx_clock = drive->sent.size > 0;
    memcpy(state->tx.bytes, drive->sent.bytes, drive->sent.size);
    state->tx.size = drive->sent.size;
    drive->sent.size = 0;
}

EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    Node *node = instance;
    if (!is_in(node, BEGINNING, "the end of initialization"))
        return fmi3Error;
    node->state.phase = STEPPING;
    if (node->state.has_events)
        begin_events(&node->state);
    return fmi3OK;
}

EXPORT fmi3Status fmi3Terminate(fmi3Instance instance) {
    Node *node = instance;
    node->state.phase = ENDED;
    return fmi3OK;
}

EXPORT fmi3Status fmi3Reset(fmi3Instance instance) {
    Node *node = instance;
    reset(&node->state);
    return fmi3OK;
}

/* ---- Steps and events -------------------------------------------------------------------------- */

EXPORT fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 length,
                             fmi3Boolean forward, fmi3Boolean *event, fmi3Boolean *terminate,
                             fmi3Boolean *early, fmi3Float64 *last) {
    Node *node = instance;
    State *state = &node->state;
    *event = *terminate = *early = false;
    *last = state->time;
    if (!is_in(node, STEPPING, "a step"))
        return fmi3Error;
    if (!(length > 0.0 && length < 1e6))
        return fail(node, "a step", "must be longer than 0 s and shorter than 1e6 s");
    pass_inputs(state);
    double steps = ceil(length / MAX_STEP_S - 1e-6);
    double dt = steps > 1.0 ? length / steps : length;
    for (double done = 0.0; done == 0.0 || done < steps; done++)
        drive_step(&state->drive, dt);
    state->time = time + length;
    show_outputs(state);
    *event = state->drive.sent.size > 0;
    *last = state->time;
    if (!state->has_events)
        state->drive.sent.size = 0; /* there is no bus */
    if (!state->drive.sent.lost)
        return fmi3OK;
    state->drive.sent.lost = 0;
    return log_line(node, fmi3Warning, "the transmit buffer",
                    "is full: frames are lost; take shorter communication steps");
}

EXPORT fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
    Node *node = instance;
    if (!is_in(node, STEPPING, "event mode"))
        return fmi3Error;
    if (!node->state.has_events)
        return fail(node, "event mode", "was not asked for at the instantiation");
    begin_events(&node->state);
    return fmi3OK;
}

/* Give the drive each frame of the operations that were received. */
static void receive_operations(State *state) {
    CanFrame frame;
    size_t length;
    for (size_t at = 0; at < state->rx.size; at += length) {
        const uint8_t *bytes = state->rx.bytes + at;
        enum Operation kind = read_operation(bytes, state->rx.size - at, &length, &frame);
        if (kind == CAN_TRANSMIT)
            drive_receive(&state->drive, &frame);
        else if (kind == MALFORMED)
            write_format_error(&state->drive.sent, bytes, length);
    }
}

EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *update,
                                           fmi3Boolean *terminate, fmi3Boolean *nominals,
                                           fmi3Boolean *values, fmi3Boolean *next,
                                           fmi3Float64 *time) {
    Node *node = instance;
    State *state = &node->state;
    *update = *terminate = *nominals = *values = *next = false;
    *time = 0.0;
    if (!is_in(node, EVENTS, "an update of discrete states"))
        return fmi3Error;
    pass_inputs(state);
    if (state->rx_clock)
        receive_operations(state);
    state->rx_clock = state->tx_clock = 0;
    state->rx.size = state->tx.size = 0;
    show_outputs(state);
    return fmi3OK;
}

EXPORT fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance) { return fmi3OK; }

EXPORT fmi3Status fmi3EnterStepMode(fmi3Instance instance) {
    Node *node = instance;
    if (!is_in(node, EVENTS, "step mode"))
        return fmi3Error;
    node->state.phase = STEPPING;
    return fmi3OK;
}

/* ---- Values ------------------------------------------------------------------------------------ */

static const Kind *find_variable(Node *node, int type, fmi3ValueReference variable) {
    char what[64];
    if (variable < VARIABLES && KINDS[variable].type == type)
        return &KINDS[variable];
    snprintf(what, sizeof what, "value reference %u", (unsigned)variable);
    fail(node, what, "is none of a variable of this type");
    return NULL;
}

fmi3Status fmi3_get(fmi3Instance instance, int type, fmi3ValueReference variable, double *value) {
    Node *node = instance;
    if (!find_variable(node, type, variable))
        return fmi3Error;
    *value = node->state.v[variable];
    return fmi3OK;
}

fmi3Status fmi3_set(fmi3Instance instance, int type, fmi3ValueReference variable, double value) {
    Node *node = instance;
    State *state = &node->state;
    const Kind *kind = find_variable(node, type, variable);
    if (!kind)
        return fmi3Error;
    if (kind->set == NEVER)
        return fail(node, kind->name, "cannot be set");
    if (kind->set == AT_START && state->phase > BEGINNING)
        return fail(node, kind->name, "can be set before the first step only");
    if (!(value >= kind->lowest && value <= kind->highest))
        return fail(node, kind->name, "is not in the range that the model description gives");
    state->v[variable] = value;
    if (state->phase <= BEGINNING) {
        power_on(state);
        show_outputs(state);
    }
    return fmi3OK;
}

GET_AND_SET(Float64, fmi3Float64, REAL)
GET_AND_SET(Int32, fmi3Int32, INTEGER)
GET_AND_SET(Boolean, fmi3Boolean, BOOLEAN)

/* ---- The bus ----------------------------------------------------------------------------------- */

EXPORT fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                               fmi3Clock value[]) {
    Node *node = instance;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] != TX_CLOCK && vr[i] != RX_CLOCK)
            return fmi3_refuse(node, "another clock than Rx_Clock and Tx_Clock");
        value[i] = vr[i] == TX_CLOCK ? node->state.tx_clock != 0 : node->state.rx_clock != 0;
    }
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                               const fmi3Clock value[]) {
    Node *node = instance;
    if (!is_in(node, EVENTS, "Rx_Clock"))
        return fmi3Error;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] != RX_CLOCK)
            return fmi3_refuse(node, "another input clock than Rx_Clock");
        node->state.rx_clock = value[i];
    }
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                                size_t sizes[], fmi3Binary value[], size_t m) {
    Node *node = instance;
    if (n != m)
        return fmi3_refuse(node, "an array");
    for (size_t i = 0; i < n; i++) {
        if (vr[i] != TX_DATA && vr[i] != RX_DATA)
            return fmi3_refuse(node, "another binary than Rx_Data and Tx_Data");
        const Operations *held = vr[i] == TX_DATA ? &node->state.tx : &node->state.rx;
        sizes[i] = held->size;
        value[i] = held->bytes;
    }
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                                const size_t sizes[], const fmi3Binary value[], size_t m) {
    Node *node = instance;
    if (n != m)
        return fmi3_refuse(node, "an array");
    for (size_t i = 0; i < n; i++) {
        if (vr[i] != RX_DATA)
            return fmi3_refuse(node, "another input than Rx_Data");
        if (sizes[i] && !is_in(node, EVENTS, "Rx_Data"))
            return fmi3Error;
        if (sizes[i] > OPERATION_BYTES)
            return fail(node, "Rx_Data", "is longer than its maxSize");
        node->state.rx.size = sizes[i];
        if (sizes[i])
            memcpy(node->state.rx.bytes, value[i], sizes[i]);
    }
    return fmi3OK;
}

WITHOUT(GetIntervalDecimal, "an interval", fmi3Float64 interval[],
        fmi3IntervalQualifier qualifier[])
WITHOUT(GetIntervalFraction, "an interval", fmi3UInt64 counter[], fmi3UInt64 resolution[],
        fmi3IntervalQualifier qualifier[])

/* ---- State: a copy of the bytes of one struct -------------------------------------------------- */

static fmi3Status copy_state(Node *node, const void *bytes, fmi3FMUState *saved) {
    if (!*saved)
        *saved = malloc(sizeof(State));
    if (!*saved)
        return fail(node, "a state", "does not fit into the memory");
    memcpy(*saved, bytes, sizeof(State));
    return fmi3OK;
}

/* Whether bytes are a state of this very FMU. */
static int is_own(Node *node, const void *bytes, size_t size) {
    uint64_t kind = 0;
    if (bytes && size == sizeof(State))
        memcpy(&kind, bytes, sizeof kind); /* the first member */
    if (kind != KIND)
        fail(node, "a state", "of another FMU cannot be restored");
    return kind == KIND;
}

EXPORT fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *saved) {
    Node *node = instance;
    return copy_state(node, &node->state, saved);
}

EXPORT fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState saved) {
    Node *node = instance;
    if (!is_own(node, saved, sizeof(State)))
        return fmi3Error;
    memcpy(&node->state, saved, sizeof(State));
    return fmi3OK;
}

EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *saved) {
    if (saved) {
        free(*saved);
        *saved = NULL;
    }
    return fmi3OK;
}

EXPORT fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState saved,
                                             size_t *size) {
    *size = sizeof(State);
    return fmi3OK;
}

EXPORT fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState saved,
                                        fmi3Byte bytes[], size_t size) {
    if (size < sizeof(State))
        return fail(instance, "a state", "needs more bytes than it is given");
    memcpy(bytes, saved, sizeof(State));
    return fmi3OK;
}

EXPORT fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[],
                                          size_t size, fmi3FMUState *saved) {
    return is_own(instance, bytes, size) ? copy_state(instance, bytes, saved) : fmi3Error;
}
