/* A controller as an FMU of either version, as little of it as an importer asks for: state feedback
   u = -G (x - x_ref) of the equivalent state, and with SUM a sum that it remembers.
   Compiled with FMI=2 or 3 and the gains as GAINS; at the time AT it does what BAD says. */

#include <math.h>
#include <stdlib.h>
#include <unistd.h>

typedef struct {
    double in[12], out[2], sum;
} Controller;

static const double gains[2][8] = GAINS;

static int set(Controller *c, const unsigned *which, size_t count, const double *values) {
    for (size_t i = 0; i < count; i++)
        c->in[which[i]] = values[i];
    return 0;
}

static int get(Controller *c, const unsigned *which, size_t count, double *values) {
    for (size_t i = 0; i < count; i++)
        values[i] = c->out[which[i] - 12];
    return 0;
}

static int step(Controller *c, double time) {
    for (int row = 0; row < 2; row++) {
        c->out[row] = 0;
        for (int i = 0; i < 8; i++) {
            double wanted = i == 0 ? c->in[8] : i == 1 ? c->in[9] : i == 4 ? c->in[10] : i == 5 ? c->in[11] : 0;
            c->out[row] -= gains[row][i] * (c->in[i] - wanted);
        }
    }
    c->sum += SUM * (c->in[0] - c->in[8]);
    c->out[0] -= c->sum;
    if (time >= AT) {
        if (BAD == 1)
            c->out[0] = NAN;
        if (BAD == 2)
            sleep(60);
        if (BAD == 3)
            abort();
        if (BAD == 4)
            return 3;
    }
    return 0;
}

#if FMI == 2
void *fmi2Instantiate(const char *name, int type, const char *guid, const char *where, const void *calls, int seen,
                      int logs) {
    return calloc(1, sizeof(Controller));
}
void fmi2FreeInstance(void *c) { free(c); }
int fmi2SetupExperiment(void *c, int a, double tolerance, double start, int b, double stop) { return 0; }
int fmi2EnterInitializationMode(void *c) { return 0; }
int fmi2ExitInitializationMode(void *c) { return 0; }
int fmi2SetReal(void *c, const unsigned *which, size_t count, const double *values) {
    return set(c, which, count, values);
}
int fmi2GetReal(void *c, const unsigned *which, size_t count, double *values) { return get(c, which, count, values); }
int fmi2DoStep(void *c, double time, double length, int final) { return step(c, time); }
#else
#include <stdbool.h>
#include <stdint.h>
void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *where, bool seen, bool logs,
                                  bool events, bool early, const unsigned *needed, size_t count, void *host,
                                  void *log, void *update) {
    return calloc(1, sizeof(Controller));
}
void fmi3FreeInstance(void *c) { free(c); }
int fmi3EnterInitializationMode(void *c, bool a, double tolerance, double start, bool b, double stop) { return 0; }
int fmi3ExitInitializationMode(void *c) { return 0; }
int fmi3SetFloat64(void *c, const unsigned *which, size_t count, const double *values, size_t length) {
    return set(c, which, count, values);
}
int fmi3GetFloat64(void *c, const unsigned *which, size_t count, double *values, size_t length) {
    return get(c, which, count, values);
}
int fmi3DoStep(void *c, double time, double length, bool final, bool *event, bool *end, bool *early, double *last) {
    *event = *end = *early = false;
    *last = time + length;
    return step(c, time);
}
#endif
