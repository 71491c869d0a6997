#include "rig.h"
#include "rig_drives.h"
#include "rig_motion.h"
#include "rig_sensors.h"
#include "rig_supervisor.h"

/* Whether the ball is where nobody sees it. */
static int hidden(const Rig *rig) {
    const double *low = rig->v + SENSORS_TOUCH_HIDDEN, *high = low + 2;
    return rig->x > low[0] && rig->y > low[1] && rig->x < high[0] && rig->y < high[1];
}

static void measure(Rig *rig) {
    double *v = rig->v, ball[2], plate[2], age;
    int felt, slot = (int)(rig->tick % RING), unseen = hidden(rig);
    if (unseen && rig->tick > 0) { /* it is where it was seen last */
        memcpy(rig->past[slot], rig->past[(slot + RING - 1) % RING], sizeof *rig->past);
    } else {
        rig->past[slot][0] = rig->x;
        rig->past[slot][1] = rig->y;
    }
    rig->felt[slot] = !rig->fallen && !unseen;
    touch(rig, ball, &age, &felt);
    encoders(rig, plate);
    of_axes(ball);
    of_axes(plate);
    if (rig->tick == 0) { /* the drives hold the plate where it is measured */
        memcpy(rig->believed, plate, sizeof plate);
        memcpy(rig->aimed, plate, sizeof plate);
    }
    watch(rig, ball, plate, felt);
    v[TIME] = rig->start + (double)rig->tick * PERIOD;
    v[MEASURED_X] = ball[0];
    v[MEASURED_PHI] = plate[0];
    v[MEASURED_Y] = ball[1];
    v[MEASURED_THETA] = plate[1];
    v[AGE] = age;
    v[TOUCHED] = felt;
    v[FAULT] = rig->fault;
    v[APPLIED_PHI_RATE] = rig->commanded[0];
    v[APPLIED_THETA_RATE] = rig->commanded[1];
    v[TRUE_X] = rig->x;
    v[TRUE_X_RATE] = rig->vx;
    v[TRUE_PHI] = rig->angle[0];
    v[TRUE_PHI_RATE] = rig->rate[0];
    v[TRUE_Y] = rig->y;
    v[TRUE_Y_RATE] = rig->vy;
    v[TRUE_THETA] = rig->angle[1];
    v[TRUE_THETA_RATE] = rig->rate[1];
    v[TRUE_ON_PLATE] = !rig->fallen;
#if PATH_ROWS
    double row = smaller(larger(0, rint(v[TIME] / PERIOD)), PATH_ROWS - 1);
    memcpy(v + REFERENCE_X, PATH[(int)row], sizeof *PATH);
#endif
}

/* What follows from the variables alone. */
static Fixed fixed_by(const double *v) {
    double share = 2 * PI * v[PLANT_SERVO_BANDWIDTH_HZ] * PERIOD;
    Fixed fixed;
    fixed.ball = ball_of(v);
    fixed.hold = (int64_t)rint(larger(v[SENSORS_NOISE_HOLD], PERIOD) / PERIOD);
    fixed.left = share > 0 ? exp(-share) : 0;
    fixed.of_mean = share > 0 ? -expm1(-share) / share : 0;
    for (int i = 0; i < 2; i++) {
        fixed.ratio[i] = ratio(v, i);
        fixed.touch[i] = sqrt(v[SENSORS_TOUCH_VARIANCE + i]);
        fixed.encoders[i] = sqrt(v[SENSORS_ENCODERS_VARIANCE + i]);
        fixed.disturbance[i] = fixed.ratio[i] * PERIOD * sqrt(v[DISTURBANCE_VARIANCE + i]);
    }
    return fixed;
}

void model_reset(Rig *rig, double start) {
    memset(rig, 0, sizeof *rig);
    for (int i = 0; i < VARIABLES; i++)
        rig->v[i] = KINDS[i].start;
    rig->kind = KIND;
    rig->start = start;
}

const char *model_set(Rig *rig, unsigned variable, double value) {
    static const char *const wrong = "is not in the range that the model description gives";
    if (variable != RATE_PHI && variable != RATE_THETA)
        if (!(KINDS[variable].lowest <= value && value <= KINDS[variable].highest))
            return wrong;
    rig->v[variable] = value;
    rig->known = rig->known && (variable == RATE_PHI || variable == RATE_THETA);
    return NULL;
}

const char *model_begin(Rig *rig) {
    double v[VARIABLES], start = rig->start;
    double frames = rig->v[SENSORS_TOUCH_FRAME_RATE];
    if (frames > 0 && frames < 1)
        return "sensors.touch.frame_rate must be 0 or at least 1";
    double latest = rig->v[SENSORS_TOUCH_DEAD_TIME] + 4 * rig->v[SENSORS_TOUCH_DEAD_TIME_SPREAD];
    if (2 + ceil((latest + (frames > 0 ? 1 / frames : 0)) / PERIOD) > RING)
        return "sensors.touch: the dead time is longer than this FMU remembers; export one from a "
               "scenario that has it";
    if (BALL_SPIN != FREE && rig->v[PLANT_START_SPIN] != 0)
        return "plant.start.spin must be 0: the ball of this FMU has no spin as a state";
    const char *wrong = misfit(rig->v);
    if (!wrong)
        wrong = misplaced(rig->v);
    if (wrong)
        return wrong;
    memcpy(v, rig->v, sizeof v);
    model_reset(rig, start);
    memcpy(rig->v, v, sizeof v);
    rig->x = v[PLANT_START_X];
    rig->vx = v[PLANT_START_X_RATE];
    rig->y = AXES == 1 ? 0 : v[PLANT_START_Y];
    rig->vy = AXES == 1 ? 0 : v[PLANT_START_Y_RATE];
    rig->fixed = fixed_by(v);
    rig->known = 1;
    rig->q = rig->fixed.ball.share * v[PLANT_BALL_RADIUS] * v[PLANT_START_SPIN];
    have_age(rig);
    for (int i = 0; i < RING; i++) {
        rig->past[i][0] = rig->x;
        rig->past[i][1] = rig->y;
        rig->felt[i] = !hidden(rig);
    }
    rig->held_felt = !hidden(rig);
    rig->frame = rig->shown = NAN;
    rig->before[0] = rig->before[1] = NAN;
    measure(rig);
    rig->running = 1;
    return NULL;
}

void model_advance(Rig rigs[]) {
    double mean[LANES][2];
    EACH(l) {
        Rig *rig = &rigs[l];
        double rate[2];
        if (!rig->known)
            rig->fixed = fixed_by(rig->v);
        rig->known = 1;
        command(rig, rate);
        follow(rig, rate, mean[l]);
        for (int i = 0; i < 2; i++) {
            rig->drift[i] += drawn(rig, SHAKE_PHI + i, rig->fixed.disturbance[i]);
            mean[l][i] += rig->drift[i];
        }
        of_axes(mean[l]);
        have_age(rig);
    }
    move(rigs, mean);
    EACH(l) {
        rigs[l].tick++;
        measure(&rigs[l]);
    }
}
