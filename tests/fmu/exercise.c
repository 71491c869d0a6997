/* Everything that an importer may do with the rig, for the compiler's sanitizers: both versions in
   one program. It ends with 0 if every answer was what the standard asks for. */

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "rig.h"

typedef void *Handle;
typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *host;
} Callbacks;

Handle fmi2Instantiate(const char *, int, const char *, const char *, const Callbacks *, int, int);
int fmi2SetupExperiment(Handle, int, double, double, int, double);
int fmi2EnterInitializationMode(Handle), fmi2ExitInitializationMode(Handle);
int fmi2Terminate(Handle), fmi2Reset(Handle);
int fmi2SetReal(Handle, const unsigned *, size_t, const double *);
int fmi2GetReal(Handle, const unsigned *, size_t, double *);
int fmi2SetBoolean(Handle, const unsigned *, size_t, const int *);
int fmi2GetInteger(Handle, const unsigned *, size_t, int *);
int fmi2DoStep(Handle, double, double, int);
int fmi2GetFMUstate(Handle, Handle *), fmi2SetFMUstate(Handle, Handle);
int fmi2FreeFMUstate(Handle, Handle *);
int fmi2SerializedFMUstateSize(Handle, Handle, size_t *);
int fmi2SerializeFMUstate(Handle, Handle, char *, size_t);
int fmi2DeSerializeFMUstate(Handle, const char *, size_t, Handle *);
int fmi2EnterEventMode(Handle);
void fmi2FreeInstance(Handle);

Handle fmi3InstantiateCoSimulation(const char *, const char *, const char *, bool, bool, bool, bool,
                                   const uint32_t *, size_t, void *,
                                   void (*)(void *, int, const char *, const char *), void *);
int fmi3EnterInitializationMode(Handle, bool, double, double, bool, double);
int fmi3ExitInitializationMode(Handle);
int fmi3SetFloat64(Handle, const uint32_t *, size_t, const double *, size_t);
int fmi3GetFloat64(Handle, const uint32_t *, size_t, double *, size_t);
int fmi3GetString(Handle, const uint32_t *, size_t, const char **, size_t);
int fmi3DoStep(Handle, double, double, bool, bool *, bool *, bool *, double *);
int fmi3GetFMUState(Handle, Handle *), fmi3SetFMUState(Handle, Handle);
int fmi3FreeFMUState(Handle, Handle *);
int fmi3SerializedFMUStateSize(Handle, Handle, size_t *);
int fmi3SerializeFMUState(Handle, Handle, uint8_t *, size_t);
int fmi3DeserializeFMUState(Handle, const uint8_t *, size_t, Handle *);
void fmi3FreeInstance(Handle);

enum { OK, ERROR = 3 };
static int said;

static void told2(void *host, const char *name, int status, const char *kind, const char *text, ...) {
    (void)host, (void)name, (void)kind, (void)text;
    said += status == ERROR;
}

static void told3(void *host, int status, const char *kind, const char *text) {
    (void)host, (void)kind;
    said += status == ERROR && strlen(text) > 0;
}

#define MUST(what)                                                                                 \
    do {                                                                                           \
        if (!(what)) {                                                                             \
            printf("line %d: %s\n", __LINE__, #what);                                              \
            exit(1);                                                                               \
        }                                                                                          \
    } while (0)

static void effects(double value[], uint32_t at[]) {
    const double wanted[][2] = {
        {PLANT_FRICTION_BREAKAWAY_RATIO, 3}, {PLANT_FRICTION_DWELL_TIME, 0.2},
        {PLANT_SERVO_BANDWIDTH_HZ, 9},       {PLANT_SERVO_BACKLASH, 1e-3},
        {PLANT_SERVO_HYSTERESIS, 1e-3},      {PLANT_SERVO_RESONANCE_HZ, 13},
        {PLANT_SERVO_VIBRATION, 1},          {PLANT_SERVO_VIBRATION_WANDER, 0.2},
        {SENSORS_TOUCH_FRAME_RATE, 133},     {SENSORS_TOUCH_DEAD_TIME_SPREAD, 2e-3},
        {SENSORS_TOUCH_ROTATION, 0.02},      {DISTURBANCE_VARIANCE, 1e-4},
    };
    for (int i = 0; i < 12; i++) {
        at[i] = (uint32_t)wanted[i][0];
        value[i] = wanted[i][1];
    }
}

static const uint32_t INPUT[2] = {RATE_PHI, RATE_THETA};
static const uint32_t OUTPUT[4] = {MEASURED_X, MEASURED_Y, TRUE_X, TRUE_Y};

static void run3(Handle rig, int from, int to, double found[4]) {
    for (int i = from; i < to; i++) {
        bool flag[3];
        double last, rate[2] = {0.3 * sin(0.02 * i), 0.2 * cos(0.017 * i)};
        MUST(fmi3SetFloat64(rig, INPUT, 2, rate, 2) == OK);
        MUST(fmi3DoStep(rig, i * PERIOD, PERIOD, true, flag, flag + 1, flag + 2, &last) == OK);
        MUST(fabs(last - (i + 1) * PERIOD) < 1e-9);
    }
    MUST(fmi3GetFloat64(rig, OUTPUT, 4, found, 4) == OK);
}

static void version3(void) {
    double value[12], first[4], again[4], last;
    uint32_t at[12], beyond = VARIABLES;
    bool flag[3];
    const char *text;
    MUST(!fmi3InstantiateCoSimulation("", "other", "", 0, 0, 0, 0, NULL, 0, NULL, told3, NULL));
    Handle rig = fmi3InstantiateCoSimulation("", TOKEN, "", 0, 0, 0, 0, NULL, 0, NULL, told3, NULL);
    effects(value, at);
    MUST(fmi3SetFloat64(rig, at, 12, value, 12) == OK);
    MUST(fmi3DoStep(rig, 0, PERIOD, true, flag, flag, flag, &last) == ERROR);
    MUST(fmi3EnterInitializationMode(rig, false, 0, 0, false, 0) == OK);
    MUST(fmi3GetFloat64(rig, OUTPUT, 4, first, 4) == OK);
    MUST(fmi3ExitInitializationMode(rig) == OK);
    MUST(fmi3SetFloat64(rig, &beyond, 1, value, 1) == ERROR);
    MUST(fmi3GetString(rig, NULL, 0, &text, 0) == OK);
    MUST(fmi3GetString(rig, at, 1, &text, 1) == ERROR);
    run3(rig, 0, 500, first);
    Handle saved = NULL, read = NULL;
    size_t size;
    MUST(fmi3GetFMUState(rig, &saved) == OK && saved);
    MUST(fmi3SerializedFMUStateSize(rig, saved, &size) == OK);
    uint8_t *bytes = malloc(size);
    MUST(fmi3SerializeFMUState(rig, saved, bytes, size) == OK);
    MUST(fmi3SerializeFMUState(rig, saved, bytes, size - 1) == ERROR);
    run3(rig, 500, 1500, first);
    MUST(fmi3SetFMUState(rig, saved) == OK);
    run3(rig, 500, 1500, again);
    MUST(memcmp(first, again, sizeof first) == 0);
    MUST(fmi3DeserializeFMUState(rig, bytes, size - 1, &read) == ERROR && !read);
    MUST(fmi3DeserializeFMUState(rig, bytes, size, &read) == OK && read);
    MUST(fmi3SetFMUState(rig, read) == OK);
    run3(rig, 500, 1500, again);
    MUST(memcmp(first, again, sizeof first) == 0);
    MUST(fmi3FreeFMUState(rig, &saved) == OK && !saved && fmi3FreeFMUState(rig, &saved) == OK);
    MUST(fmi3FreeFMUState(rig, &read) == OK && fmi3FreeFMUState(rig, NULL) == OK);
    free(bytes);
    fmi3FreeInstance(rig);
    fmi3FreeInstance(NULL);
}

static void version2(void) {
    Callbacks callbacks = {told2, NULL, NULL, NULL, NULL};
    unsigned rate[2] = {RATE_PHI, RATE_THETA}, noise = NOISE, fault = FAULT, x = TRUE_X;
    double value[2] = {0.1, NAN}, found, again;
    int off = 0, code;
    MUST(!fmi2Instantiate("rig", 1, "other", "", &callbacks, 0, 0));
    MUST(!fmi2Instantiate("rig", 0, TOKEN, "", &callbacks, 0, 0));
    Handle rig = fmi2Instantiate("rig", 1, TOKEN, "", &callbacks, 0, 0);
    MUST(fmi2SetBoolean(rig, &noise, 1, &off) == OK);
    MUST(fmi2SetupExperiment(rig, 0, 0, 1.0, 0, 0) == OK);
    MUST(fmi2EnterInitializationMode(rig) == OK && fmi2ExitInitializationMode(rig) == OK);
    MUST(fmi2SetBoolean(rig, &noise, 1, &off) == ERROR);
    MUST(fmi2DoStep(rig, 0.0, PERIOD, 1) == ERROR && fmi2DoStep(rig, 1.0, 0.7 * PERIOD, 1) == ERROR);
    MUST(fmi2SetReal(rig, rate, 1, value) == OK);
    MUST(fmi2DoStep(rig, 1.0, 10 * PERIOD, 1) == OK);
    Handle saved = NULL, read = NULL;
    size_t size;
    MUST(fmi2GetFMUstate(rig, &saved) == OK);
    MUST(fmi2SerializedFMUstateSize(rig, saved, &size) == OK);
    char *bytes = malloc(size);
    MUST(fmi2SerializeFMUstate(rig, saved, bytes, size) == OK);
    MUST(fmi2SetReal(rig, rate, 2, value) == OK && fmi2DoStep(rig, 1 + 10 * PERIOD, PERIOD, 1) == OK);
    MUST(fmi2GetReal(rig, &x, 1, &found) == OK && fmi2GetInteger(rig, &fault, 1, &code) == OK);
    MUST(code == BAD_REQUEST && isfinite(found));
    MUST(fmi2DeSerializeFMUstate(rig, bytes, size, &read) == OK && fmi2SetFMUstate(rig, read) == OK);
    MUST(fmi2SetReal(rig, rate, 2, value) == OK && fmi2DoStep(rig, 1 + 10 * PERIOD, PERIOD, 1) == OK);
    MUST(fmi2GetReal(rig, &x, 1, &again) == OK && memcmp(&found, &again, sizeof found) == 0);
    MUST(fmi2FreeFMUstate(rig, &saved) == OK && fmi2FreeFMUstate(rig, &read) == OK);
    MUST(fmi2EnterEventMode(rig) == ERROR);
    MUST(fmi2Terminate(rig) == OK && fmi2Terminate(rig) == ERROR && fmi2Reset(rig) == OK);
    free(bytes);
    fmi2FreeInstance(rig);
}

int main(void) {
    version3();
    version2();
    MUST(said > 10);
    return 0;
}
