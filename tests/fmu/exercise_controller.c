/* What an importer does with a controller, for the compiler's sanitizers: any numbers in, finite
   rates out, a state saved and restored. It ends with 0 if every answer was right. */

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "instance.h"

typedef void *Handle;
Handle fmi3InstantiateCoSimulation(const char *, const char *, const char *, bool, bool, bool, bool,
                                   const uint32_t *, size_t, void *,
                                   void (*)(void *, int, const char *, const char *), void *);
int fmi3EnterInitializationMode(Handle, bool, double, double, bool, double);
int fmi3ExitInitializationMode(Handle), fmi3Terminate(Handle), fmi3Reset(Handle);
int fmi3SetFloat64(Handle, const uint32_t *, size_t, const double *, size_t);
int fmi3GetFloat64(Handle, const uint32_t *, size_t, double *, size_t);
int fmi3SetBoolean(Handle, const uint32_t *, size_t, const bool *, size_t);
int fmi3DoStep(Handle, double, double, bool, bool *, bool *, bool *, double *);
int fmi3GetFMUState(Handle, Handle *), fmi3SetFMUState(Handle, Handle);
int fmi3FreeFMUState(Handle, Handle *);
void fmi3FreeInstance(Handle);

static const double EXTREME[] = {0, 0.1, -0.1, 1e30, -1e30, 1e308, INFINITY, -INFINITY, NAN};
enum { EXTREMES = sizeof EXTREME / sizeof *EXTREME, PERIODS = 4000 };

static double any(void) {
    int n = rand() % (2 * EXTREMES);
    return n < EXTREMES ? EXTREME[n] : 0.2 * (rand() / (double)RAND_MAX - 0.5);
}

int main(void) {
    static const uint32_t inputs[] = {MEASURED_X, MEASURED_PHI, MEASURED_Y, MEASURED_THETA, AGE};
    static const uint32_t outputs[] = {RATE_PHI, RATE_THETA}, flag[] = {TOUCHED};
    Handle it = fmi3InstantiateCoSimulation("it", TOKEN, NULL, false, false, false, false, NULL, 0,
                                            NULL, NULL, NULL);
    Handle saved = NULL;
    int wrong = !it;
    for (int run = 0; run < 3 && !wrong; run++) {
        wrong |= fmi3EnterInitializationMode(it, false, 0, run, false, 0);
        wrong |= fmi3ExitInitializationMode(it);
        for (int k = 0; k < PERIODS; k++) {
            double given[5] = {0.01, 0.01, -0.01, 0.01, 0}, rates[2], last;
            bool touched[] = {run == 0 || rand() % 3 > 0}, event, end, early;
            for (int i = 0; i < 5 && run; i++)
                given[i] = any();
            wrong |= fmi3SetFloat64(it, inputs, 5, given, 5);
            wrong |= fmi3SetBoolean(it, flag, 1, touched, 1);
            wrong |= fmi3DoStep(it, run + k * PERIOD, PERIOD, true, &event, &end, &early, &last);
            wrong |= fmi3GetFloat64(it, outputs, 2, rates, 2);
            wrong |= !(isfinite(rates[0]) && isfinite(rates[1]));
            if (k == PERIODS / 2)
                wrong |= fmi3GetFMUState(it, &saved);
        }
        wrong |= fmi3SetFMUState(it, saved);
        wrong |= fmi3Terminate(it) | fmi3Reset(it);
    }
    wrong |= fmi3FreeFMUState(it, &saved);
    fmi3FreeInstance(it);
    return wrong;
}
