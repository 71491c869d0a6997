/* Drives: lag, dead time, play, hysteresis, resonance and vibration of the servos. */

#ifndef RIG_DRIVES_H
#define RIG_DRIVES_H

#include "rig_linkage.h"

/* A servo that goes to a position: to the sum of the turns commanded a dead time ago, between two
   periods by a straight line, on its grid, once that is
   further away than its dead band, as fast as it can; where its acceleration is limited, with the
   largest turn from which it can still brake: with n smaller ones after it,
   (n + 1) turn - more n (n + 1) / 2 is the way. As of all drives its angles are those of the servo,
   whose ratio to the plate is given; those of the scenario are the plate's at level. */
static double servo(Rig *rig, int i, double ratio, double turn) {
    const double *v = rig->v;
    double most = v[PLANT_SERVO_SLEW] > 0 ? v[PLANT_SERVO_SLEW] * ratio * PERIOD : INFINITY;
    double step = v[PLANT_SERVO_RESOLUTION] * ratio, before = rig->servo[i];
    double back = v[PLANT_SERVO_DEAD_TIME] / PERIOD, whole = floor(back + 1e-9);
    int64_t now = rig->tick + RING, late = now - (int64_t)whole;
    rig->ordered[now % RING][i] = rig->ordered[(now - 1) % RING][i] + turn;
    double goal = rig->ordered[late % RING][i], older = rig->ordered[(late - 1) % RING][i];
    goal += larger(back - whole, 0) * (older - goal);
    if (step > 0)
        goal = rint(goal / step) * step;
    double more = v[PLANT_SERVO_ACCELERATION] * ratio * PERIOD * PERIOD, way = goal - before;
    int moves = more > 0 && fabs(rig->servo_turn[i]) > more;
    if (!rig->goes[i] && !moves && fabs(way) <= v[PLANT_SERVO_DEADBAND] * ratio)
        return rig->servo_turn[i] = 0;
    rig->servo[i] = smaller(larger(goal, before - most), before + most);
    if (more > 0) {
        double last = rig->servo_turn[i], n = floor((sqrt(1 + 8 * fabs(way) / more) - 1) / 2);
        double turn = copysign(smaller(fabs(way) / (n + 1) + more * n / 2, most), way);
        turn = smaller(larger(turn, last - more), last + more);
        if (turn != way)
            rig->servo[i] = before + turn;
    }
    rig->goes[i] = rig->servo[i] != goal;
    return rig->servo_turn[i] = rig->servo[i] - before;
}

/* A gap: the output stands until the input has crossed it. */
static double play(Rig *rig, int i, double ratio, double turn) {
    double half = rig->v[PLANT_SERVO_BACKLASH] * ratio / 2, before = rig->play_out[i];
    rig->play_in[i] += turn;
    rig->play_out[i] =
        smaller(larger(before, rig->play_in[i] - half), rig->play_in[i] + half);
    return rig->play_out[i] - before;
}

/* Dahl's elastic part against friction: dh/ds = (1 - h sgn(s') / h_max) / 2. */
static double hysteresis(Rig *rig, int i, double ratio, double turn) {
    double width = rig->v[PLANT_SERVO_HYSTERESIS] * ratio, before = rig->lost[i];
    double end = copysign(width / 2, turn);
    rig->lost[i] = end + (before - end) * exp(-fabs(turn) / width);
    return turn - (rig->lost[i] - before);
}

/* d'' + 2 zeta w d' + w^2 d = -(acceleration of the motor), for rates constant over a period. */
static double resonance(Rig *rig, int i, double turn) {
    double w = 2 * PI * rig->v[PLANT_SERVO_RESONANCE_HZ], zeta = rig->v[PLANT_SERVO_RESONANCE_DAMPING];
    double decay = zeta * w, swing = w * sqrt(1 - zeta * zeta), fade = exp(-decay * PERIOD);
    double cosine = fade * cos(swing * PERIOD), sine = fade * sin(swing * PERIOD) / swing;
    double rate = turn / PERIOD, d = rig->swing[i];
    double d_rate = rig->swing_rate[i] - (rate - rig->motor_rate[i]);
    rig->motor_rate[i] = rate;
    rig->swing[i] = (cosine + decay * sine) * d + sine * d_rate;
    rig->swing_rate[i] = -(w * w) * sine * d + (cosine - decay * sine) * d_rate;
    return turn + (rig->swing[i] - d);
}

/* A vibration that nobody commands: steady, or narrow-band noise about one frequency. */
static void vibrate(Rig *rig, double mean[2]) {
    const double *v = rig->v;
    double frequency = v[PLANT_SERVO_VIBRATION_HZ], wander = v[PLANT_SERVO_VIBRATION_WANDER];
    double amplitude = v[PLANT_SERVO_VIBRATION] / (2 * PI * frequency);
    if (amplitude == 0)
        return;
    rig->shaken++;
    double phase = 2 * PI * frequency * PERIOD * (double)rig->shaken;
    double sine = sin(phase), cosine = cos(phase), moved[2] = {sine, cosine};
    if (wander > 0) {
        /* Ornstein-Uhlenbeck; begun as it goes on: at no instant is it known to be still */
        double kept = exp(-PERIOD / wander), fresh = sqrt(1 - kept * kept);
        for (int i = 0; i < 4; i++) {
            double n = v[NOISE] ? sqrt(0.5) * noise((uint64_t)v[SEED], (uint64_t)(WANDER + i),
                                                    (uint64_t)(rig->shaken - 1))
                                : 0;
            rig->sizes[i] = rig->shaken == 1 ? n : kept * rig->sizes[i] + fresh * n;
        }
        for (int i = 0; i < 2; i++)
            moved[i] = rig->sizes[i] * sine + rig->sizes[i + 2] * cosine;
    }
    for (int i = 0; i < 2; i++)
        mean[i] += rig->fixed.ratio[i] * amplitude * moved[i];
}

/* Mean rates of the servos over the next period for the commanded ones. */
static void follow(Rig *rig, const double command[2], double mean[2]) {
    const double *v = rig->v;
    int goes_to = v[PLANT_SERVO_SLEW] > 0 || v[PLANT_SERVO_ACCELERATION] > 0 ||
                  v[PLANT_SERVO_DEADBAND] > 0 || v[PLANT_SERVO_RESOLUTION] > 0 ||
                  v[PLANT_SERVO_DEAD_TIME] > 0;
    if (!goes_to && rig->ordering)
        memset(rig->ordered, 0, sizeof rig->ordered);
    rig->ordering = goes_to;
    for (int i = 0; i < 2; i++) { /* a part that a rig gets while it runs begins at 0 */
        double asked = command[i], by = rig->fixed.ratio[i];
        if (goes_to) {
            asked = servo(rig, i, by, asked * PERIOD) / PERIOD;
        } else {
            rig->servo[i] = rig->goes[i] = 0;
            rig->servo_turn[i] = asked * PERIOD;
        }
        double lacking = rig->lagging[i] - asked;
        mean[i] = asked + rig->fixed.of_mean * lacking;
        rig->lagging[i] = asked + rig->fixed.left * lacking;
        if (v[PLANT_SERVO_BACKLASH] > 0)
            mean[i] = play(rig, i, by, mean[i] * PERIOD) / PERIOD;
        else
            rig->play_in[i] = rig->play_out[i] = 0;
        if (v[PLANT_SERVO_HYSTERESIS] > 0)
            mean[i] = hysteresis(rig, i, by, mean[i] * PERIOD) / PERIOD;
        else
            rig->lost[i] = 0;
        if (v[PLANT_SERVO_RESONANCE_HZ] > 0) {
            mean[i] = resonance(rig, i, mean[i] * PERIOD) / PERIOD;
        } else {
            rig->motor_rate[i] = command[i];
            rig->swing[i] = rig->swing_rate[i] = 0;
        }
    }
    vibrate(rig, mean);
}

#endif
