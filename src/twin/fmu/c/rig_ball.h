/* Newton and Euler of the rolling ball, of several rigs at once: twin.sim.plant.exact. */

#ifndef RIG_BALL_H
#define RIG_BALL_H

#include "rig_friction.h"

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

#endif
