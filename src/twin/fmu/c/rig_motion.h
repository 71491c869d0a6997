/* Motion of plates and balls in a control period: Runge-Kutta, friction that holds, walls. */

#ifndef RIG_MOTION_H
#define RIG_MOTION_H

#include "rig_ball.h"
#include "rig_linkage.h"
#include "rig_walls.h"

/* Accelerations with resistance: a moving ball is slowed against its velocity, a resting one starts
   only when the free acceleration exceeds the limit, a bent contact pushes back. */
static void accelerate(const Rig rigs[], const Feel *feel, const Rolling *at, const Balls *b,
                       Lanes ax, Lanes ay, Lanes most) {
    Lanes speed;
    int rests = 0;
    ALL(l)
        speed[l] = sqrt(b->vx[l] * b->vx[l] + b->vy[l] * b->vy[l]);
    limits(rigs, feel, at, b, speed, most);
    free_balls(rigs, at, b, ax, ay);
    if (feel->bends) {
        EACH(l) {
            if (feel->slides[l] > 0)
                continue;
            ax[l] -= most[l] * (rigs[l].bend[0] / rigs[l].v[PLANT_FRICTION_PRESLIDING]);
            ay[l] -= most[l] * (rigs[l].bend[1] / rigs[l].v[PLANT_FRICTION_PRESLIDING]);
        }
    }
    if (feel->walls) {
        EACH(l) {
            double a[2] = {ax[l], ay[l]};
            support(rigs[l].v, b->x[l], b->vx[l], b->y[l], b->vy[l], a);
            ax[l] = a[0];
            ay[l] = a[1];
        }
    }
    ALL(l) {
        double by = feel->slides[l] * most[l] / (speed[l] > 0 ? speed[l] : 1);
        ax[l] -= by * b->vx[l];
        ay[l] -= by * b->vy[l];
    }
    EACH(l)
        rests |= speed[l] == 0;
    if (!rests)
        return;
    EACH(l) {
        double push = sqrt(ax[l] * ax[l] + ay[l] * ay[l]);
        if (speed[l] == 0 && feel->slides[l] > 0) {
            double share = push > most[l] ? 1 - most[l] / push : 0;
            ax[l] *= share;
            ay[l] *= share;
        }
    }
}

/* Whether friction, by its limit, takes away a ball's last speed within this step, and holds it. */
static void hold(const Rig rigs[], const Feel *feel, const Rolling *at, const Balls *b,
                 const Lanes most, int held[LANES]) {
    Balls still = *b;
    Lanes ax, ay, holding, none;
    int any = 0;
    EACH(l) {
        double reach = most[l] * STEP;
        held[l] = feel->slides[l] > 0 && most[l] > 0 &&
                  b->vx[l] * b->vx[l] + b->vy[l] * b->vy[l] <= reach * reach;
        any |= held[l];
    }
    if (!any)
        return;
    EACH(l)
        still.vx[l] = still.vy[l] = none[l] = 0;
    free_balls(rigs, at, &still, ax, ay);
    limits(rigs, feel, at, &still, none, holding);
    EACH(l) {
        double a[2] = {ax[l], ay[l]};
        if (feel->walls)
            support(rigs[l].v, b->x[l], 0, b->y[l], 0, a);
        held[l] = held[l] && a[0] * a[0] + a[1] * a[1] <= holding[l] * holding[l];
    }
}

/* What the balls of rigs feel. */
static void feel_all(Rig rigs[], Feel *feel) {
    feel->sticks = feel->bends = feel->walls = 0;
    EACH(l) {
        Rig *rig = &rigs[l];
        const Ball *ball = &rig->fixed.ball;
        const double *v = rig->v;
        int bends = v[PLANT_FRICTION_PRESLIDING] > 0;
        feel->c1[l] = ball->c1;
        feel->c2[l] = ball->c2;
        feel->turn[l] = ball->turn;
        feel->lever_x[l] = ball->lever_x;
        feel->lever_y[l] = ball->lever_y;
        feel->share[l] = ball->share;
        feel->radius[l] = ball->radius;
        feel->gx[l] = ball->gravity[0];
        feel->gy[l] = ball->gravity[1];
        feel->gz[l] = ball->gravity[2];
        feel->length[l] = v[PLANT_FRICTION_ROLLING];
        feel->surplus[l] = larger(v[PLANT_FRICTION_BREAKAWAY_RATIO] - 1, 0);
        feel->stribeck[l] = v[PLANT_FRICTION_STRIBECK_SPEED];
        feel->viscous[l] = v[PLANT_FRICTION_VISCOUS];
        feel->ages[l] = rig->ageing;
        feel->age[l] = rig->age;
        feel->slides[l] = !bends;
        feel->sticks |= sticking(v);
        feel->bends |= bends;
        feel->walls |= isfinite(reach(v, 0)) || isfinite(reach(v, 1));
        if (!bends)
            rig->bend[0] = rig->bend[1] = 0;
    }
}

/* Contacts bent on by half a step. */
static void bend_all(Rig rigs[], const Feel *feel, const Balls *b) {
    if (feel->bends)
        EACH(l)
            if (!(feel->slides[l] > 0))
                bend_on(&rigs[l], b->vx[l], b->vy[l], STEP / 2);
}

/* Walls met within a step that began with speeds. */
static void rebound_all(Rig rigs[], const Feel *feel, const Balls *before, Balls *b) {
    if (!feel->walls)
        return;
    EACH(l) {
        Rig *rig = &rigs[l];
        double at[4] = {b->x[l], b->vx[l], b->y[l], b->vy[l]};
        if (!met(rig->v, at))
            continue;
        rebound(rig->v, before->vx[l], before->vy[l], at);
        b->x[l] = at[0];
        b->vx[l] = at[1];
        b->y[l] = at[2];
        b->vy[l] = at[3];
    }
}

/* Balls after a time with velocities, accelerations and what slows their spin. */
static void after(const Balls *b, double time, const Balls *by, const Lanes ax, const Lanes ay,
                  const Rolling *at, Balls *found) {
    ALL(l) {
        found->x[l] = b->x[l] + time * by->vx[l];
        found->y[l] = b->y[l] + time * by->vy[l];
        found->vx[l] = b->vx[l] + time * ax[l];
        found->vy[l] = b->vy[l] + time * ay[l];
        found->q[l] = b->q[l] - time * (at->hx[l] * by->vx[l] + at->hy[l] * by->vy[l]);
    }
}

/* One step of RK4, by the equations at its begin, middle and end. */
static void roll_on(Rig rigs[], Feel *feel, const Rolling at[3], Balls *b) {
    double h = STEP, sixth = STEP / 6;
    Lanes ax[4], ay[4], most, unused;
    Balls first = *b, two, three, four;
    int held[LANES];
    bend_all(rigs, feel, b);
    accelerate(rigs, feel, &at[0], b, ax[0], ay[0], most);
    after(b, h / 2, b, ax[0], ay[0], &at[0], &two);
    accelerate(rigs, feel, &at[1], &two, ax[1], ay[1], unused);
    after(b, h / 2, &two, ax[1], ay[1], &at[1], &three);
    accelerate(rigs, feel, &at[1], &three, ax[2], ay[2], unused);
    after(b, h, &three, ax[2], ay[2], &at[1], &four);
    accelerate(rigs, feel, &at[2], &four, ax[3], ay[3], unused);
    hold(rigs, feel, &at[0], b, most, held);
    ALL(l) {
        double v1 = b->vx[l], v2 = two.vx[l], v3 = three.vx[l], v4 = four.vx[l];
        double w1 = b->vy[l], w2 = two.vy[l], w3 = three.vy[l], w4 = four.vy[l];
        double q1 = at[0].hx[l] * v1 + at[0].hy[l] * w1, q2 = at[1].hx[l] * v2 + at[1].hy[l] * w2;
        double q3 = at[1].hx[l] * v3 + at[1].hy[l] * w3, q4 = at[2].hx[l] * v4 + at[2].hy[l] * w4;
        b->q[l] -= sixth * (q1 + 2 * (q2 + q3) + q4);
        b->x[l] += sixth * (v1 + 2 * (v2 + v3) + v4);
        b->y[l] += sixth * (w1 + 2 * (w2 + w3) + w4);
        b->vx[l] += sixth * (ax[0][l] + 2 * (ax[1][l] + ax[2][l]) + ax[3][l]);
        b->vy[l] += sixth * (ay[0][l] + 2 * (ay[1][l] + ay[2][l]) + ay[3][l]);
    }
    rebound_all(rigs, feel, &first, b);
    EACH(l)
        if (held[l])
            b->vx[l] = b->vy[l] = 0;
    bend_all(rigs, feel, b);
    EACH(l) {
        if (rigs[l].ageing) {
            double speed = hypot(first.vx[l] + b->vx[l], first.vy[l] + b->vy[l]) / 2;
            feel->age[l] = rigs[l].age = aged(rigs[l].v, rigs[l].age, speed, h);
        }
    }
}

/* How the plate moves in a control period: its accelerations at the begin, and its jerks. */
typedef struct {
    double u[2], jerk[2];
} Way;

/* That of all plates, from their angles and rates on. */
typedef struct {
    Lanes angle[2], rate[2], u[2], jerk[2];
} Ways;

/* Of a plate whose servos ramp to rates: they run linearly there; through a linkage it moves on
   the cubic that joins its angles and rates at both ends. */
static Way way_to(const Rig *rig, const double to[2]) {
    const double *v = rig->v, *angle = rig->angle, *before = rig->rate;
    double period = STEPS * STEP, motor[2], turn[2], there[2], after[2];
    Way way = {{0}, {0}};
    if (!transmits(v)) {
        for (int i = 0; i < 2; i++)
            way.u[i] = (to[i] - before[i]) / period;
        return way;
    }
    motor_of(v, angle, motor);
    motor_rate(v, angle, motor, before, turn);
    for (int i = 0; i < 2; i++)
        motor[i] += period / 2 * (turn[i] + to[i]);
    plate_of(v, motor, there);
    plate_rate(v, there, motor, to, after);
    for (int i = 0; i < 2; i++) {
        double mean = (there[i] - angle[i]) / period;
        way.u[i] = (6 * mean - 4 * before[i] - 2 * after[i]) / period;
        way.jerk[i] = 6 * (before[i] + after[i] - 2 * mean) / (period * period);
    }
    return way;
}

/* How plates move at each instant. */
static void turn(const Ways *ways, Plates *plates) {
    for (int i = 0; i < 2; i++) {
        for (int k = 0; k < INSTANTS; k++) {
            double time = STEP / 2 * k;
            ALL(l) {
                double u = ways->u[i][l], more = time * ways->jerk[i][l], rate = ways->rate[i][l];
                plates->angle[i][k][l] =
                    ways->angle[i][l] + time * (rate + time / 2 * (u + more / 3));
                plates->rate[i][k][l] = rate + time * (u + more / 2);
                plates->u[i][k][l] = u + more;
            }
            sines(plates->angle[i][k], plates->sine[i][k], plates->cosine[i][k]);
        }
    }
}

/* One control period of plates and balls, the servos on their way to rates. */
static void move(Rig rigs[], double to[][2]) {
    Ways ways;
    Plates plates;
    Rolling at[INSTANTS];
    Balls balls;
    Feel feel;
    feel_all(rigs, &feel);
    EACH(l) {
        Balls *b = &balls;
        Way way = way_to(&rigs[l], to[l]);
        for (int i = 0; i < 2; i++) {
            ways.angle[i][l] = rigs[l].angle[i];
            ways.rate[i][l] = rigs[l].rate[i];
            ways.u[i][l] = way.u[i];
            ways.jerk[i][l] = way.jerk[i];
        }
        b->x[l] = rigs[l].x;
        b->vx[l] = rigs[l].vx;
        b->y[l] = rigs[l].y;
        b->vy[l] = rigs[l].vy;
        b->q[l] = rigs[l].q;
    }
    turn(&ways, &plates);
    for (int k = 0; k < INSTANTS; k++)
        roll(&feel, &plates, k, &at[k]);
    for (int k = 0; k < 2 * STEPS; k += 2)
        roll_on(rigs, &feel, &at[k], &balls);
    EACH(l) {
        Rig *rig = &rigs[l];
        rig->x = balls.x[l];
        rig->vx = balls.vx[l];
        rig->y = balls.y[l];
        rig->vy = balls.vy[l];
        rig->q = balls.q[l];
        for (int i = 0; i < 2; i++) {
            rig->angle[i] = plates.angle[i][2 * STEPS][l];
            rig->rate[i] = plates.rate[i][2 * STEPS][l];
        }
        double half = rig->v[PLANT_SIZE] / 2, far = rig->x * rig->x + rig->y * rig->y;
        if (fabs(rig->x) > half || fabs(rig->y) > rig->v[PLANT_SIZE + 1] / 2)
            rig->fallen = 1;
        if (ROUND && far > half * half)
            rig->fallen = 1;
    }
}

#endif
