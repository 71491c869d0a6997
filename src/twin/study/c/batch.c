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

/* The reference of a number of control periods: position and derivatives as the header has them. */
EXPORT void desire(int64_t ticks, struct controller_reference desired[]) {
    for (int64_t tick = 0; tick < ticks; tick++)
        controller_reference_at((double)tick * PERIOD, &desired[tick]);
}

/* Simulate a rig for a number of control periods, or until its plate is levelled or its ball has
   left the screen. Values are those of its variables, surface is NULL where SURFACE_X is 0, desired
   is filled by desire. Returns the number of periods if all were simulated to a good end, else
   fewer; in each period the ball's place (x, y), the plate's angles (phi, theta), and the applied
   accelerations. */
EXPORT int64_t simulate(const double values[VARIABLES], const void *surface,
                        const double *const numbers[], const int64_t number_strides[],
                        int64_t ticks, const struct controller_reference desired[],
                        double ball[][2], double plate[][2], double applied[][2]) {
    Rig rig;
    struct controller controller;
    struct controller_command command;
    SURFACE = surface;
    streams = numbers;
    strides = number_strides;
    model_reset(&rig, 0);
    memcpy(rig.v, values, sizeof rig.v);
    rig.v[SENSORS_NOISE_HOLD] = 0; /* its numbers come held */
    if (model_begin(&rig))
        return 0;
    controller_init(&controller);
    for (int64_t tick = 0; tick < ticks; tick++) {
        double *v = rig.v, before[2] = {rig.commanded[0], rig.commanded[1]};
        struct controller_measurement measured = seen(v);
        ball[tick][0] = v[TRUE_X];
        ball[tick][1] = v[TRUE_Y];
        plate[tick][0] = v[TRUE_PHI];
        plate[tick][1] = v[TRUE_THETA];
        controller_step(&controller, &measured, &desired[tick], &command);
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
