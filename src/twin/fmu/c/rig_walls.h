/* Walls.

   A rim or end stops, twin.sim.plant.rim: a ball that meets a wall rolls away at its restitution,
   and rests against it if it would meet it twice within a step. */

#ifndef RIG_WALLS_H
#define RIG_WALLS_H

#include "rig_shared.h"

static const double ON_THE_WALL = 1e-9; /* share by which a ball on a round wall may be short */

/* How far the middle of the ball can go along an axis, m. */
static double reach(const double *v, int i) {
    double between = v[PLANT_RIM_SIZE + i];
    return between > 0 ? between / 2 - v[PLANT_BALL_RADIUS] : INFINITY;
}

static int circle(const double *v) { return ROUND && isfinite(reach(v, 0)); }

/* Whether a ball is beyond a wall; at is (x, x', y, y'). */
static int met(const double *v, const double at[4]) {
    double far = reach(v, 0);
    return fabs(at[0]) > far || fabs(at[2]) > reach(v, 1) ||
           (circle(v) && at[0] * at[0] + at[2] * at[2] > far * far);
}

/* Direction from the middle to the ball. */
static void outwards(double x, double y, double n[2]) {
    double far = sqrt(x * x + y * y), by = far > 0 ? far : 1;
    n[0] = x / by;
    n[1] = y / by;
}

/* Place and speed along one direction after a step with constant acceleration. */
static void stop(const double *v, double far, double before, double *x, double *speed) {
    double side = *x < 0 ? -1 : 1, depth = side * *x - far, out = side * *speed;
    if (!(depth > 0))
        return;
    double a = side * (*speed - before) / STEP;
    double hit = sqrt(larger(out * out - 2 * a * depth, 0)), total = out + hit;
    double left = smaller(2 * depth / (total > 0 ? total : 1), STEP);
    double away = v[PLANT_RIM_RESTITUTION] * hit, gap = left * (away - a / 2 * left);
    *x = side * (far - (gap <= 0 ? 0 : gap));
    *speed = gap <= 0 ? 0 : side * (a * left - away);
}

static void rebound(const double *v, double vx, double vy, double at[4]) {
    if (!circle(v)) {
        stop(v, reach(v, 0), vx, &at[0], &at[1]);
        stop(v, reach(v, 1), vy, &at[2], &at[3]);
        return;
    }
    double n[2], far = sqrt(at[0] * at[0] + at[2] * at[2]);
    outwards(at[0], at[2], n);
    double there = far, speed = n[0] * at[1] + n[1] * at[3], after = speed;
    stop(v, reach(v, 0), n[0] * vx + n[1] * vy, &there, &after);
    for (int i = 0; i < 2; i++) {
        at[2 * i] += (there - far) * n[i];
        at[2 * i + 1] += (after - speed) * n[i];
    }
}

/* What is wrong with the walls and where the ball begins; NULL if nothing is. */
static const char *misplaced(const double *v) {
    double x = v[PLANT_START_X], y = v[PLANT_START_Y], far = reach(v, 0);
    if (AXES == 1 && v[PLANT_RIM_SIZE + 1] > 0)
        return "plant.rim.size: must be 0 along y, which a rig of one axis does not have";
    for (int i = 0; i < 2; i++) {
        double between = v[PLANT_RIM_SIZE + i];
        if (between > 0 && !(reach(v, i) > 0 && between <= v[PLANT_SIZE + i]))
            return "plant.rim.size: must be 0, or above the ball's diameter and at most the plate's side";
    }
    if (ROUND && v[PLANT_RIM_SIZE] != v[PLANT_RIM_SIZE + 1])
        return "plant.rim.size: of a round plate its diameter twice";
    if (fabs(x) > far || fabs(y) > reach(v, 1) || (circle(v) && x * x + y * y > far * far))
        return "plant.start: the ball begins beyond a wall";
    return NULL;
}

/* Acceleration that is left to a ball at rest on a wall. */
static void support(const double *v, double x, double vx, double y, double vy, double a[2]) {
    if (vx != 0 || vy != 0)
        return;
    if (circle(v)) {
        double n[2];
        outwards(x, y, n);
        double push = larger(n[0] * a[0] + n[1] * a[1], 0);
        if (!(n[0] * x + n[1] * y >= reach(v, 0) * (1 - ON_THE_WALL)))
            return;
        a[0] -= push * n[0];
        a[1] -= push * n[1];
        return;
    }
    if (fabs(x) >= reach(v, 0) && a[0] * x > 0)
        a[0] = 0;
    if (fabs(y) >= reach(v, 1) && a[1] * y > 0)
        a[1] = 0;
}

#endif
