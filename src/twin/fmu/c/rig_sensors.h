/* Sensors: touch screen and encoders. */

#ifndef RIG_SENSORS_H
#define RIG_SENSORS_H

#include "rig_shared.h"

/* Ball a time in s ago, between two samples by a straight line. */
static void look_back(const Rig *rig, double time, double seen[2], int *felt) {
    double back = time / PERIOD, whole = floor(back), share = back - whole;
    int64_t newer = rig->tick - (int64_t)whole;
    const double *after = rig->past[(newer % RING + RING) % RING];
    const double *before = rig->past[((newer - 1) % RING + RING) % RING];
    *felt = rig->felt[(newer % RING + RING) % RING];
    for (int i = 0; i < 2; i++) /* rounding is not a share of a period */
        seen[i] = share < 1e-9 ? after[i] : (1 - share) * after[i] + share * before[i];
}

/* Dead time of a new sample, s: at most four standard deviations late. */
static double delay(const Rig *rig) {
    double mean = rig->v[SENSORS_TOUCH_DEAD_TIME], spread = rig->v[SENSORS_TOUCH_DEAD_TIME_SPREAD];
    double late = mean + drawn(rig, DELAY, spread);
    return smaller(larger(late, 0), mean + 4 * spread);
}

/* A position as the screen reports it: turned, noisy, on its grid. */
static void imperfect(const Rig *rig, double seen[2]) {
    const double *v = rig->v;
    double turn = v[SENSORS_TOUCH_ROTATION], grid = v[SENSORS_TOUCH_GRID];
    if (turn != 0) {
        double x = seen[0], y = seen[1];
        seen[0] = x * cos(turn) + y * sin(turn);
        seen[1] = y * cos(turn) - x * sin(turn);
    }
    for (int i = 0; i < 2; i++) {
        seen[i] += drawn(rig, TOUCH_X + i, rig->fixed.touch[i]);
        if (grid > 0) {
            double pitch = v[PLANT_SIZE + i] / grid;
            seen[i] = rint(seen[i] / pitch) * pitch;
        }
    }
}

/* A normal number of this period, 0 without noise. */
static double irregular(const Rig *rig, int stream) {
    if (!rig->v[NOISE])
        return 0;
    return noise((uint64_t)rig->v[SEED], (uint64_t)stream, (uint64_t)rig->tick);
}

/* The newest touch: a fresh sample every period, or the newest frame, which arrive on a clock. */
static void touch(Rig *rig, double seen[2], double *age, int *felt) {
    const double *v = rig->v;
    double frames = v[SENSORS_TOUCH_FRAME_RATE];
    if (frames == 0) {
        *age = 0;
        look_back(rig, delay(rig), seen, felt);
        imperfect(rig, seen);
        return;
    }
    double length = 1 / frames;
    double lag = (double)rig->tick * PERIOD - v[SENSORS_TOUCH_DEAD_TIME] -
                 v[SENSORS_TOUCH_FRAME_PHASE] * length;
    /* a frame may come up to half of one early or late, or not at all; the first one comes */
    double jitter = v[SENSORS_TOUCH_JITTER], early = jitter > 0 ? length / 2 : 0;
    double frame = floor((lag + early) / length);
    if (frame != rig->frame) {
        int first = isnan(rig->frame);
        double shift = jitter * irregular(rig, JITTER), other = irregular(rig, LOST);
        rig->frame = frame;
        if (first || !(v[NOISE] && erfc(-other / sqrt(2)) / 2 < v[SENSORS_TOUCH_LOST])) {
            rig->last_due = rig->due;
            rig->due = frame * length + (first ? -early : smaller(larger(shift, -early), early));
        }
    }
    double last = rig->due <= lag || early == 0 ? rig->due : rig->last_due;
    *age = lag - last;
    if (last != rig->shown) {
        look_back(rig, delay(rig) + *age, rig->held, &rig->held_felt);
        imperfect(rig, rig->held);
        rig->shown = last;
    }
    memcpy(seen, rig->held, sizeof rig->held);
    *felt = rig->held_felt;
}

/* Plate angles as the encoders count them. */
static void encoders(const Rig *rig, double angle[2]) {
    const double *v = rig->v;
    double counts = v[SENSORS_ENCODERS_COUNTS];
    for (int i = 0; i < 2; i++) {
        angle[i] = rig->angle[i] + drawn(rig, ENCODER_PHI + i, rig->fixed.encoders[i]);
        if (counts > 0)
            angle[i] = rint(angle[i] / (2 * PI / counts)) * (2 * PI / counts);
    }
}

#endif
