/* Runs of many rigs: each rig with its controller in one loop, its noise drawn before. */

#include "controller.h"
#include "rig.h"

#include <math.h>
#include <string.h>

const double (*SURFACE)[SURFACE_X ? SURFACE_Y : 1][3];

static const double *const *streams; /* numbers of each stream, of variance 1 */
static const int64_t *strides;       /* from one number of a stream to the next */

double noise(uint64_t seed, uint64_t stream, uint64_t number) {
    (void)seed;
    return streams[stream][(int64_t)number * strides[stream]];
}

/* What the controller is handed of a measurement. */
static struct controller_measurement seen(const double *v) {
    struct controller_measurement m = {v[MEASURED_X],     v[MEASURED_PHI], v[MEASURED_Y],
                                       v[MEASURED_THETA], v[AGE],          v[TOUCHED] != 0};
    return m;
}

/* Simulate a rig for a number of control periods, or until its plate is levelled or its ball has
   left the screen. Values are those of its variables, surface is NULL where SURFACE_X is 0.
   Returns the number of periods if all were simulated to a good end, else fewer; state (5.5) and
   applied accelerations of each period. */
EXPORT int64_t simulate(const double values[VARIABLES], const void *surface,
                        const double *const numbers[], const int64_t number_strides[],
                        int64_t ticks, double state[][8], double applied[][2]) {
    Rig rig;
    struct controller controller;
    struct controller_reference reference;
    struct controller_command command;
    SURFACE = surface;
    streams = numbers;
    strides = number_strides;
    model_reset(&rig, 0);
    memcpy(rig.v, values, sizeof rig.v);
    if (model_begin(&rig))
        return 0;
    controller_init(&controller);
    for (int64_t tick = 0; tick < ticks; tick++) {
        double *v = rig.v, before[2] = {rig.commanded[0], rig.commanded[1]};
        struct controller_measurement measured = seen(v);
        memcpy(state[tick], v + TRUE_X, sizeof state[tick]);
        controller_reference_at((double)tick * PERIOD, &reference);
        controller_step(&controller, &measured, &reference, &command);
        v[RATE_PHI] = command.valid ? command.rate[0] : NAN;
        v[RATE_THETA] = command.valid ? command.rate[1] : NAN;
        model_advance(&rig);
        for (int i = 0; i < 2; i++)
            applied[tick][i] = (rig.commanded[i] - before[i]) / PERIOD;
        if (rig.fault || rig.fallen)
            return tick;
    }
    return ticks;
}
