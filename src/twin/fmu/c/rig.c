#include "rig.h"

#include <math.h>
#include <string.h>

static const double PI = 3.14159265358979323846;

static double smaller(double a, double b) { return b < a ? b : a; }
static double larger(double a, double b) { return b > a ? b : a; }

/* ---- Noise ------------------------------------------------------------------------------------ */

/* The draw of a stream in this control period, held as long as the scenario says. */
static double drawn(const Rig *rig, int stream, double deviation) {
    if (deviation == 0 || !rig->v[NOISE])
        return 0;
    uint64_t number = (uint64_t)(rig->tick / rig->fixed.hold);
    return deviation * noise((uint64_t)rig->v[SEED], (uint64_t)stream, number);
}

/* ---- Friction ---------------------------------------------------------------------------------- */

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

/* ---- What lies between servos and plate --------------------------------------------------------

   Cranks and rods in closed form (twin.hal.linkage), or a measured table, cut finely into straight
   lines; without either the servos turn the plate itself. All angles in rad; axis 0 is phi. */

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

/* ---- Ball -------------------------------------------------------------------------------------- */

static Ball ball_of(const double *v) {
    double m = v[PLANT_BALL_MASS], r = v[PLANT_BALL_RADIUS], J = v[PLANT_BALL_INERTIA];
    double g = v[GRAVITY], phi = v[PLANT_LEVEL], theta = AXES == 1 ? 0 : v[PLANT_LEVEL + 1];
    Ball ball;
    double d = v[PLANT_PLATE_HEIGHT] + r, c4 = (J + d * m * r) / (m * r);
    ball.radius = r;
    ball.c1 = m * (r * r) / (m * (r * r) + J);
    ball.c2 = (d * m * (r * r) + J * r) / (m * (r * r) + J);
    ball.turn = BALL_SPIN == THESIS ? 2 * ball.c1 : 1 + ball.c1;
    ball.lever_x = BALL_SPIN == FREE ? c4 : d;
    ball.lever_y = BALL_SPIN == FREE ? 2 * c4 : (J + 2 * d * m * r) / (m * r);
    ball.share = BALL_SPIN == FREE ? sqrt(1 - ball.c1) : 0;
    ball.gravity[0] = g * sin(phi) * cos(theta);
    ball.gravity[1] = -g * sin(theta);
    ball.gravity[2] = -g * cos(phi) * cos(theta);
    return ball;
}

/* Instants of a control period: its begin, and the middle and the end of each step. */
enum { INSTANTS = 2 * STEPS + 1 };

/* A number of each of the rigs that are simulated side by side. Where ALL of them do the same, the
   compiler calculates them at once; loops over EACH may differ from rig to rig. */
typedef double Lanes[LANES];
#define EACH(l) for (int l = 0; l < LANES; l++)
#if LANES > 1
#define ALL(l) _Pragma("omp simd") EACH(l)
#else
#define ALL(l) EACH(l)
#endif

/* How plates move, at each instant. */
typedef struct {
    Lanes angle[2][INSTANTS], rate[2][INSTANTS], u[2][INSTANTS];
    Lanes sine[2][INSTANTS], cosine[2][INSTANTS];
} Plates;

/* Newton and Euler of rolling balls where the plates' motion is given, (R5) and (R4) of
   twin.sim.plant.exact; q = sqrt(1 - c1) r n is the speed of the spin n about the normal:
   x'' = xx x + xy y + turn y' + px + hx q,  y'' = yx x + yy y - turn x' + py + hy q,
   q' = -hx x' - hy y' */
typedef struct {
    Lanes xx, xy, yx, yy, turn, px, py, hx, hy;
    Lanes normal; /* force per mass that presses the ball on the plate, m/s^2 */
} Rolling;

/* What balls do. */
typedef struct {
    Lanes x, vx, y, vy, q;
} Balls;

/* What of a rig its ball feels in a period. */
typedef struct {
    Lanes c1, c2, turn, lever_x, lever_y, share, radius, gx, gy, gz; /* as of Ball */
    Lanes length, surplus, stribeck, viscous;                       /* of friction */
    Lanes ages, age; /* 1 and the age where the contact has one, else 0 */
    Lanes slides;    /* 0 where a bent contact resists instead, else 1 */
    int sticks, bends, walls; /* of any of them */
} Feel;

static const double SMALL = 0.3; /* rad, up to which the series below are exact to rounding */

/* Sines and cosines. */
static void sines(const Lanes angle, Lanes sine, Lanes cosine) {
    ALL(l) {
        double a = angle[l], s = a * a, odd = 1. / 6227020800, even = 1. / 479001600;
        odd = -1. / 39916800 + s * odd;
        odd = 1. / 362880 + s * odd;
        odd = -1. / 5040 + s * odd;
        odd = 1. / 120 + s * odd;
        odd = -1. / 6 + s * odd;
        even = -1. / 3628800 + s * even;
        even = 1. / 40320 + s * even;
        even = -1. / 720 + s * even;
        even = 1. / 24 + s * even;
        even = -1. / 2 + s * even;
        sine[l] = a + a * s * odd;
        cosine[l] = 1 + s * even;
    }
    EACH(l) {
        if (!(fabs(angle[l]) <= SMALL)) {
            sine[l] = sin(angle[l]);
            cosine[l] = cos(angle[l]);
        }
    }
}

/* The equations of the balls at an instant. */
static void roll(const Feel *feel, const Plates *plates, int k, Rolling *at) {
    ALL(l) {
        double gx = feel->gx[l], gy = feel->gy[l], gz = feel->gz[l], c1 = feel->c1[l];
        double s3 = plates->sine[0][k][l], s7 = plates->sine[1][k][l];
        double c3 = plates->cosine[0][k][l], c7 = plates->cosine[1][k][l];
        double wy = plates->rate[0][k][l], w7 = plates->rate[1][k][l];
        double u1 = plates->u[0][k][l], u2 = plates->u[1][k][l];
        double wx = w7 * c3, wz = w7 * s3, down = c7 * gz - s7 * gy, xy = c1 * s3 * u2;
        at->xx[l] = c1 * (wz * wz + wy * wy);
        at->xy[l] = xy;
        at->yx[l] = -2 * c1 * wx * wy - xy;
        at->yy[l] = c1 * w7 * w7;
        at->turn[l] = feel->turn[l] * wz;
        at->px[l] = c1 * (c3 * gx - s3 * down - feel->lever_x[l] * wx * wz) - feel->c2[l] * u1;
        at->py[l] = c1 * (c7 * gy + s7 * gz - feel->lever_y[l] * wy * wz) + feel->c2[l] * c3 * u2;
        at->hx[l] = feel->share[l] * wx;
        at->hy[l] = feel->share[l] * wy;
        at->normal[l] = -s3 * gx - c3 * down;
    }
}

/* Accelerations without resistance. */
static void free_balls(const Rig rigs[], const Rolling *at, const Balls *b, Lanes ax, Lanes ay) {
    ALL(l) {
        ax[l] = at->xx[l] * b->x[l] + at->xy[l] * b->y[l] + at->turn[l] * b->vy[l] + at->px[l] +
                at->hx[l] * b->q[l];
        ay[l] = at->yx[l] * b->x[l] + at->yy[l] * b->y[l] - at->turn[l] * b->vx[l] + at->py[l] +
                at->hy[l] * b->q[l];
    }
    if (SLOPING) {
        EACH(l) {
            double found[3];
            surface(&rigs[l], b->x[l], b->y[l], found);
            ax[l] -= rigs[l].fixed.ball.c1 * at->normal[l] * found[1];
            ay[l] -= rigs[l].fixed.ball.c1 * at->normal[l] * found[2];
        }
    }
}

/* Largest accelerations that friction can take away, m/s^2, by
   arm = relative(x, y) rolling (1 + (breakaway_ratio - 1) age) + viscous v. */
static void limits(const Rig rigs[], const Feel *feel, const Rolling *at, const Balls *b,
                   const Lanes speed, Lanes most) {
    Lanes length;
    ALL(l)
        length[l] = feel->length[l];
    if (feel->sticks) {
        ALL(l) {
            double share = speed[l] / feel->stribeck[l], settled = 1 / (1 + share * share);
            length[l] *= 1 + feel->surplus[l] * (feel->ages[l] > 0 ? feel->age[l] : settled);
        }
    }
    if (SURFACE_X) {
        EACH(l) {
            double found[3];
            surface(&rigs[l], b->x[l], b->y[l], found);
            length[l] *= found[0];
        }
    }
    ALL(l) {
        double arm = length[l] + feel->viscous[l] * speed[l];
        most[l] = feel->c1[l] * (arm / feel->radius[l]) * at->normal[l];
    }
}

/* ---- Walls -------------------------------------------------------------------------------------

   A rim or end stops, twin.sim.plant.rim: a ball that meets a wall rolls away at its restitution,
   and rests against it if it would meet it twice within a step. */

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

/* ---- Motion ------------------------------------------------------------------------------------ */

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

/* ---- Drives ------------------------------------------------------------------------------------ */

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

/* ---- Sensors ----------------------------------------------------------------------------------- */

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

/* ---- Supervisor: limits, and levelling the plate when one is passed ---------------------------- */

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

/* ---- The rig ----------------------------------------------------------------------------------- */

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
