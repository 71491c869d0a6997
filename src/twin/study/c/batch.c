/* Runs of many rigs: each rig with its controller in one loop, its noise drawn before. */

#include "controller.h"
#include "rig.h"

#include <math.h>
#include <string.h>

static const double *const *streams; /* numbers of each stream of each rig, of variance 1 */
static const int64_t *strides;       /* from one number of a stream to the next */

/* The seed is the number of the rig, from 0 on. */
double noise(uint64_t seed, uint64_t stream, uint64_t number) {
    uint64_t which = seed * STREAMS + stream;
    return streams[which][(int64_t)number * strides[which]];
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

/* Simulate LANES rigs for a number of control periods. Values are those of their variables, screens
   are their surfaces, where SURFACE_X is above 0; numbers are their noise by rig and stream; desired
   is filled by desire. In each period the place (x, y) of each ball, the angles (phi, theta) of its
   plate, and the applied accelerations. Whether each was simulated to a good end is in good: a
   levelled plate or a ball that has left the screen is none. */
EXPORT void simulate(double values[][VARIABLES], const void *const screens[],
                     const double *const numbers[], const int64_t number_strides[], int64_t ticks,
                     const struct controller_reference desired[], double *ball, double *plate,
                     double *applied, int32_t good[]) {
    Rig rigs[LANES];
    struct controller controllers[LANES];
    streams = numbers;
    strides = number_strides;
    for (int l = 0; l < LANES; l++) {
        model_reset(&rigs[l], 0);
        memcpy(rigs[l].v, values[l], sizeof rigs[l].v);
        rigs[l].v[SENSORS_NOISE_HOLD] = 0; /* its numbers come held */
        rigs[l].v[SEED] = l;
        good[l] = !model_begin(&rigs[l]); /* it clears what is no variable: the screen comes then */
        rigs[l].screen = screens[l];
        controller_init(&controllers[l]);
    }
    for (int64_t tick = 0; tick < ticks; tick++) {
        double before[LANES][2];
        int going = 0;
        for (int l = 0; l < LANES; l++) {
            double *v = rigs[l].v;
            int64_t at = 2 * (l * ticks + tick);
            struct controller_measurement measured = seen(v);
            struct controller_command command;
            if (!good[l]) /* what is left of its run is in nobody's way */
                rigs[l].x = rigs[l].vx = rigs[l].y = rigs[l].vy = rigs[l].q = 0;
            ball[at] = v[TRUE_X];
            ball[at + 1] = v[TRUE_Y];
            plate[at] = v[TRUE_PHI];
            plate[at + 1] = v[TRUE_THETA];
            controller_step(&controllers[l], &measured, &desired[tick], &command);
            v[RATE_PHI] = command.valid ? command.rate[0] : NAN;
            v[RATE_THETA] = command.valid ? command.rate[1] : NAN;
            memcpy(before[l], rigs[l].commanded, sizeof before[l]);
        }
        model_advance(rigs);
        for (int l = 0; l < LANES; l++) {
            for (int i = 0; i < 2; i++)
                applied[2 * (l * ticks + tick) + i] = (rigs[l].commanded[i] - before[l][i]) / PERIOD;
            good[l] = good[l] && !rigs[l].fault && !rigs[l].fallen;
            going |= good[l];
        }
        if (!going)
            return;
    }
}
