/* Supervisor: limits, and levelling the plate when one is passed. */

#ifndef RIG_SUPERVISOR_H
#define RIG_SUPERVISOR_H

#include "rig_linkage.h"

static const double ANGLE_SLACK = 0.5 * 0.017453292519943295; /* rad */
static const double DRIFT_TIME = 0.1, LOST_AFTER = 0.1, PACE = 0.04, ANCHOR = 0.02; /* s */

/* What there is not of a rig of one axis. */
static void of_axes(double pair[2]) {
    for (int i = AXES; i < 2; i++)
        pair[i] = 0;
}

static void judge(Rig *rig, int is, int fault) {
    if (is && rig->running && !rig->fault)
        rig->fault = fault;
}

static void watch(Rig *rig, const double ball[2], const double plate[2], int felt) {
    const double *v = rig->v;
    int outside = 0, tilted = 0, fast = 0, paces = (int)larger(1, rint(PACE / PERIOD));
    for (int i = 0; i < 2; i++) {
        rig->believed[i] += PERIOD / DRIFT_TIME * (plate[i] - rig->believed[i]);
        outside |= fabs(ball[i]) > v[RIG_LIMITS_AREA + i] + v[RIG_LIMITS_MARGIN];
        tilted |= fabs(plate[i]) > v[RIG_LIMITS_ANGLE] + ANGLE_SLACK;
    }
    judge(rig, outside, BALL_OUTSIDE);
    judge(rig, tilted, PLATE_TILTED);
    rig->unseen = felt ? 0 : rig->unseen + PERIOD;
    judge(rig, rig->unseen > LOST_AFTER, BALL_LOST);
    if (++rig->pace < paces)
        return;
    rig->pace = 0;
    for (int i = 0; i < 2; i++) { /* where the ball was not felt, NaN is never too fast */
        fast |= fabs(ball[i] - rig->before[i]) > v[RIG_LIMITS_BALL_SPEED] * paces * PERIOD;
        rig->before[i] = felt ? ball[i] : NAN;
    }
    judge(rig, fast, BALL_TOO_FAST);
}

/* The rate of an axis that may be commanded: within rate and acceleration limits, and within what
   can be braked before the angle limit. A rate v braked by one step a period covers at most
   (v + step / 2)^2 / (2 a). */
static double clamped(const Rig *rig, int i, double wanted) {
    double a = rig->v[RIG_LIMITS_ACCELERATION], step = a * PERIOD, half = step / 2;
    double most = rig->v[RIG_LIMITS_RATE] + half;
    double towards = wanted < 0 ? -rig->believed[i] : rig->believed[i];
    double square = 2 * a * rig->v[RIG_LIMITS_ANGLE] - 2 * a * towards;
    double largest = sqrt(smaller(larger(square, half * half), most * most)) - half;
    double size = smaller(largest, fabs(wanted)), rate = wanted < 0 ? -size : size;
    return smaller(larger(rate, rig->commanded[i] - step), rig->commanded[i] + step);
}

/* The rate that brings the plate level, with half of the acceleration allowed. */
static double levelling(const Rig *rig, int i) {
    double far = fabs(rig->believed[i]);
    double rate = smaller(sqrt(rig->v[RIG_LIMITS_ACCELERATION] * far), far / (10 * PERIOD));
    return rig->believed[i] > 0 ? -rate : rate;
}

/* Servo angles for the plate angles that are commanded, by what the rig knows of its linkage. */
static void reckoned(const Rig *rig, double motor[2]) {
    const double *v = rig->v;
    double plate[2];
    for (int i = 0; i < 2; i++)
        plate[i] = (1 + v[RIG_CAM_ERROR + i]) * rig->aimed[i] +
                   v[RIG_CAM_COUPLING] * rig->aimed[1 - i];
    motor_of(v, plate, motor);
}

/* Rates of the servos. */
static void command(Rig *rig, double rate[2]) {
    const double *v = rig->v;
    double wanted[2], before[2];
    int in_full = transmits(v) && v[RIG_KNOWS_LINKAGE];
    if (++rig->unaimed % (int)larger(1, rint(ANCHOR / PERIOD)) == 0) /* rates add up to drift */
        memcpy(rig->aimed, rig->believed, sizeof rig->aimed);
    if (in_full)
        reckoned(rig, before);
    double asked[2] = {v[RATE_PHI], v[RATE_THETA]};
    of_axes(asked);
    judge(rig, !(isfinite(asked[0]) && isfinite(asked[1])), BAD_REQUEST);
    for (int i = 0; i < 2; i++) {
        wanted[i] = rig->fault ? levelling(rig, i) : asked[i];
        rig->commanded[i] = clamped(rig, i, wanted[i]);
        rig->believed[i] += PERIOD * rig->commanded[i];
        rig->aimed[i] += PERIOD * rig->commanded[i];
    }
    if (in_full) {
        reckoned(rig, rate);
        for (int i = 0; i < 2; i++)
            rate[i] = (rate[i] - before[i]) / PERIOD;
        return;
    }
    for (int i = 0; i < 2; i++) /* what the rig knows of its cams may be wrong */
        rate[i] = rig->fixed.ratio[i] * ((1 + v[RIG_CAM_ERROR + i]) * rig->commanded[i] +
                                 v[RIG_CAM_COUPLING] * rig->commanded[1 - i]);
}

#endif
