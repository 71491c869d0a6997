/* Friction between ball and plate, by place, time of contact and way: twin.sim.plant.friction. */

#ifndef RIG_FRICTION_H
#define RIG_FRICTION_H

#include "rig_shared.h"

static int sticking(const double *v) { return v[PLANT_FRICTION_BREAKAWAY_RATIO] > 1; }

/* Relative friction and slope along x and y where a ball is, straight between the grid's points;
   beyond the screen its edge counts. */
static void surface(const Rig *rig, double x, double y, double found[3]) {
    double width = rig->v[PLANT_SIZE], depth = rig->v[PLANT_SIZE + 1];
    double along = smaller(larger((x / width + 0.5) * (SURFACE_X - 1), 0), SURFACE_X - 1);
    double across = smaller(larger((y / depth + 0.5) * (SURFACE_Y - 1), 0), SURFACE_Y - 1);
    int i = (int)smaller(floor(along), SURFACE_X - 2);
    int j = (int)smaller(floor(across), SURFACE_Y - 2);
    double s = along - i, t = across - j;
    for (int k = 0; k < 3; k++) {
        double near = (1 - t) * SCREEN(rig)[i][j][k] + t * SCREEN(rig)[i][j + 1][k];
        double far = (1 - t) * SCREEN(rig)[i + 1][j][k] + t * SCREEN(rig)[i + 1][j + 1][k];
        found[k] = (1 - s) * near + s * far;
    }
}

/* Age of a contact that has long rolled at a speed: the Stribeck curve of Hess and Soom. */
static double settled(const double *v, double speed) {
    double share = speed / v[PLANT_FRICTION_STRIBECK_SPEED];
    return 1 / (1 + share * share);
}

/* dwell_time age' = 1 - age (1 + (v / stribeck_speed)^2), solved for a constant speed. */
static double aged(const double *v, double age, double speed, double time) {
    double goal = settled(v, speed);
    return goal + (age - goal) * exp(-time / (goal * v[PLANT_FRICTION_DWELL_TIME]));
}

/* A contact has an age where it takes more to break a ball away, and that after a while. */
static void have_age(Rig *rig) {
    int wanted = sticking(rig->v) && rig->v[PLANT_FRICTION_DWELL_TIME] > 0;
    if (wanted && !rig->ageing)
        rig->age = settled(rig->v, hypot(rig->vx, rig->vy));
    rig->ageing = wanted;
}

/* Dahl (1968) in the plane: z' = v - |v| z / s along a straight way; s the presliding distance. */
static void bend_on(Rig *rig, double vx, double vy, double time) {
    double s = rig->v[PLANT_FRICTION_PRESLIDING];
    if (s == 0) {
        rig->bend[0] = rig->bend[1] = 0;
        return;
    }
    double speed = sqrt(vx * vx + vy * vy), by = speed > 0 ? speed : 1;
    double left = expm1(-(speed * time) / s);
    rig->bend[0] -= left * (s * (vx / by) - rig->bend[0]);
    rig->bend[1] -= left * (s * (vy / by) - rig->bend[1]);
}

#endif
