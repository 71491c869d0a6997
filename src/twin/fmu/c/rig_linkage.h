/* What lies between servos and plate.

   Cranks and rods in closed form (twin.hal.linkage), or a measured table, cut finely into straight
   lines; without either the servos turn the plate itself. All angles in rad; axis 0 is phi. */

#ifndef RIG_LINKAGE_H
#define RIG_LINKAGE_H

#include "rig_shared.h"

static const double STANDS = 1e-6; /* by how much the cosine is short of 1 where a linkage locks */

static int has_rods(const double *v) {
    return v[PLANT_LINKAGE_CRANK] > 0 || v[PLANT_LINKAGE_CRANK + 1] > 0;
}

static int transmits(const double *v) { return CURVE_ROWS || has_rods(v); }

/* A column of an axis's table where another one is the angle; at_end beyond, NAN for the last. */
static double curve(int i, double angle, int of, int wanted, double at_end) {
    const double(*row)[3] = i ? CURVE + CURVE_PHI : CURVE;
    int low = 0, high = (i ? CURVE_ROWS - CURVE_PHI : CURVE_PHI) - 1;
    if (angle < row[0][of] || angle > row[high][of])
        return isnan(at_end) ? row[angle < row[0][of] ? 0 : high][wanted] : at_end;
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (row[middle][of] <= angle)
            low = middle;
        else
            high = middle;
    }
    const double *a = row[low], *b = row[high];
    return (b[wanted] - a[wanted]) / (b[of] - a[of]) * (angle - a[of]) + a[wanted];
}

/* Lengths of one axis, m: crank r, arm a, distance d, depth h of the servo, and the rod's square;
   and the share c of the arm's height that is left where theta turns it aside. */
typedef struct {
    double r, a, d, h, square, c;
} Rod;

static double lean(const double *v, int i) {
    return v[PLANT_LINKAGE_ARM + i] - v[PLANT_LINKAGE_DISTANCE + i] - v[PLANT_LINKAGE_CRANK + i];
}

static Rod rod_of(const double *v, int i, double theta) {
    double rod = v[PLANT_LINKAGE_ROD + i], aside = lean(v, i);
    Rod found = {v[PLANT_LINKAGE_CRANK + i], v[PLANT_LINKAGE_ARM + i],
                 v[PLANT_LINKAGE_DISTANCE + i], sqrt(rod * rod - aside * aside),
                 rod * rod, i ? 1 : cos(theta)};
    return found;
}

static double angle_of(double cosine) {
    return acos(smaller(larger(cosine, STANDS - 1), 1 - STANDS));
}

/* Servo angles that hold plate angles. */
static void motor_of(const double *v, const double plate[2], double motor[2]) {
    for (int i = 0; i < 2; i++) {
        if (CURVE_ROWS) {
            motor[i] = curve(i, plate[i], 1, 0, NAN);
            continue;
        }
        Rod at = rod_of(v, i, plate[1]);
        double up = at.a * sin(plate[i]), p = at.a * cos(plate[i]) - at.d, q = at.c * up + at.h;
        double reach = p * p + q * q + (1 - at.c * at.c) * (up * up) + at.r * at.r - at.square;
        motor[i] = atan2(q, p) - angle_of(reach / (2 * at.r) / hypot(p, q));
    }
}

/* Plate angles where the servos are at angles; theta first, for phi depends on it. */
static void plate_of(const double *v, const double motor[2], double plate[2]) {
    for (int i = 1; i >= 0; i--) {
        if (CURVE_ROWS) {
            plate[i] = curve(i, motor[i], 0, 1, NAN);
            continue;
        }
        Rod at = rod_of(v, i, plate[1]);
        double x = at.d + at.r * cos(motor[i]), y = at.h - at.r * sin(motor[i]);
        double reach = (at.a * at.a + x * x + y * y - at.square) / (2 * at.a);
        plate[i] = angle_of(reach / hypot(x, at.c * y)) - atan2(at.c * y, x);
    }
}

/* Derivatives of a rod's squared length over -2 a: by crank, by its own and by the other angle. */
static void slopes(const double *v, int i, const double plate[2], double motor, double by[3]) {
    Rod at = rod_of(v, i, plate[1]);
    double sine = sin(plate[i]), cosine = cos(plate[i]);
    double dx = -at.r * sin(motor), dy = -at.r * cos(motor), x = at.d - dy, y = at.h + dx;
    by[0] = dx * cosine - at.c * dy * sine - (x * dx + y * dy) / at.a;
    by[1] = -x * sine - at.c * y * cosine;
    by[2] = i ? 0 : y * sine * sin(plate[1]);
}

/* Rates of the plate for those of the servos, where they are. */
static void plate_rate(const double *v, const double plate[2], const double motor[2],
                       const double rate[2], double found[2]) {
    double by[3];
    for (int i = 1; i >= 0; i--) {
        if (CURVE_ROWS) {
            found[i] = rate[i] * curve(i, motor[i], 0, 2, 0);
            continue;
        }
        slopes(v, i, plate, motor[i], by);
        found[i] = -by[0] * rate[i] / by[1];
        if (i == 0)
            found[0] -= by[2] * found[1] / by[1];
    }
}

/* Rates of the servos for those of the plate, where they are. */
static void motor_rate(const double *v, const double plate[2], const double motor[2],
                       const double rate[2], double found[2]) {
    double by[3];
    for (int i = 0; i < 2; i++) {
        if (CURVE_ROWS) {
            found[i] = rate[i] / curve(i, motor[i], 0, 2, NAN);
            continue;
        }
        slopes(v, i, plate, motor[i], by);
        found[i] = -(by[1] * rate[i] + by[2] * rate[1]) / by[0];
    }
}

/* Servo angle of an axis per plate angle at level. */
static double ratio(const double *v, int i) {
    if (CURVE_ROWS)
        return 1 / curve(i, curve(i, 0, 1, 0, NAN), 0, 2, NAN);
    return has_rods(v) ? v[PLANT_LINKAGE_ARM + i] / v[PLANT_LINKAGE_CRANK + i] : 1;
}

/* What is wrong with the lengths; NULL if nothing is. */
static const char *misfit(const double *v) {
    static const double spare = 1.1;
    if (!has_rods(v))
        return NULL;
    if (CURVE_ROWS)
        return "plant.linkage: this FMU has a table, and no lengths beside it";
    for (int i = 0; i < 2; i++) {
        double rod = v[PLANT_LINKAGE_ROD + i];
        if (!(v[PLANT_LINKAGE_CRANK + i] > 0 && rod > 0 && v[PLANT_LINKAGE_ARM + i] > 0))
            return "plant.linkage: crank, rod and arm must be above 0 for both axes";
        if (!(fabs(lean(v, i)) < rod))
            return "plant.linkage.rod: must be longer than crank and arm end are apart at level";
    }
    for (int n = 0; n < 9 * 111; n++) {
        double most = spare * v[RIG_LIMITS_ANGLE] * (n / 9) / 110, motor[2], found[2];
        double plate[2] = {(n % 3 - 1) * most, (n / 3 % 3 - 1) * most};
        motor_of(v, plate, motor);
        plate_of(v, motor, found);
        if (!(fabs(found[0] - plate[0]) <= STANDS && fabs(found[1] - plate[1]) <= STANDS))
            return "plant.linkage: locks within 1.1 times rig.limits.angle";
    }
    return NULL;
}

#endif
