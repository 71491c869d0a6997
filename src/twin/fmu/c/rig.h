/* The rig: ball on a tilting plate, drives, touch screen, encoders and supervisor, in C99.

   A second implementation of twin.sim and twin.hal, rig by rig the same numbers. Frames, signs and
   units are those of the Python code: state (x, x', phi, phi', y, y', theta, theta') (5.5) in m,
   m/s, rad, rad/s in plate axes; pairs are ordered (phi, theta); SI units throughout. */

#ifndef RIG_H
#define RIG_H

#include <stdint.h>

#include "scenario.h" /* written with each FMU: PERIOD, RING, SURFACE, ... */
#include "variables.h"

enum BallSpin { FREE, LOCKED, THESIS };

extern const double CURVE[CURVE_ROWS + 1][3]; /* angles of servo and plate, slope */
extern const double PATH[PATH_ROWS ? PATH_ROWS : 1][6];
#ifdef LANES /* a program that simulates so many rigs side by side, with screens of their own */
#define SCREEN(rig) ((rig)->screen)
#else
#define LANES 1
#define SCREEN(rig) SURFACE
extern const double SURFACE[SURFACE_X ? SURFACE_X : 1][SURFACE_X ? SURFACE_Y : 1][3];
#endif

enum Fault {
    NO_FAULT,
    BALL_OUTSIDE,
    PLATE_TILTED,
    BALL_LOST,
    BALL_TOO_FAST,
    BAD_REQUEST
};

typedef struct {
    double c1, c2;           /* (5.1) */
    double turn;             /* factor of the plate's rate about its normal */
    double lever_x, lever_y; /* of products of the plate's rates, m */
    double share;            /* sqrt(1 - c1) where the spin is a state, else 0 */
    double radius;
    double gravity[3]; /* in the axes of the base, m/s^2 */
} Ball;

/* What follows from a rig's variables alone, and is calculated where one of them was set. */
typedef struct {
    Ball ball;
    int64_t hold;         /* control periods for which a draw of noise is held */
    double ratio[2];      /* of angles of servo and plate at level */
    double left, of_mean; /* of what a lagging servo lacks: after a period, and as its mean */
    double touch[2], encoders[2], disturbance[2]; /* deviations of their noise */
} Fixed;

/* One rig, all of it: plain data, so that a copy of the bytes is a copy of the rig. */
typedef struct {
    uint64_t kind;       /* which program wrote it; a state of another is refused */
    double v[VARIABLES]; /* every variable of the model description by its value reference */
#if LANES > 1
    const double (*screen)[SURFACE_X ? SURFACE_Y : 1][3];
#endif
    Fixed fixed;
    int known;    /* whether it is that of these variables */
    double start; /* time of the first period, s */
    int64_t tick; /* control periods since then */

    /* plate and ball */
    double angle[2], rate[2];
    double x, vx, y, vy;
    double q;   /* speed of the spin, sqrt(1 - c1) r n */
    double age; /* of the contact, 0 to 1 */
    int ageing; /* whether it has one */
    double bend[2];
    int fallen;

    /* drives */
    double ordered[RING][2]; /* angle commanded in each of the last periods */
    int ordering;            /* whether there is any */
    double servo[2];         /* where the servo is */
    double servo_turn[2];    /* in the last period */
    int goes[2];
    double lagging[2];
    double play_in[2], play_out[2];
    double lost[2];
    double swing[2], swing_rate[2], motor_rate[2];
    int64_t shaken; /* periods that a vibration has lasted */
    double sizes[4];
    double drift[2];

    /* touch screen */
    double past[RING][2];
    int felt[RING];
    double frame;              /* number of the newest frame */
    double due, last_due, shown; /* when it, the one before and the one shown come, s */
    double held[2];
    int held_felt;

    /* supervisor */
    int running;
    int fault;
    double commanded[2];
    double believed[2]; /* plate angle: commands added up, drawn to what is measured */
    double aimed[2];    /* plate angle: commands added up since it was looked at */
    int64_t unaimed;    /* commands until now */
    double unseen;
    int pace;
    double before[2];
} Rig;

/* Fill a rig with the start values of the scenario, at a time in s. */
void model_reset(Rig *rig, double start);

/* Set a variable; a text that says what is wrong, NULL if nothing is. */
const char *model_set(Rig *rig, unsigned variable, double value);

/* Put plate and ball to their start and measure; a text that says what is wrong, or NULL. */
const char *model_begin(Rig *rig);

/* Simulate one control period of LANES rigs with the rates that are commanded now, and measure. */
void model_advance(Rig rigs[]);

/* Streams of noise. */
enum Stream {
    TOUCH_X,
    TOUCH_Y,
    ENCODER_PHI,
    ENCODER_THETA,
    SHAKE_PHI,
    SHAKE_THETA,
    DELAY,
    WANDER, /* and the three after it */
    JITTER = WANDER + 4,
    LOST,
    STREAMS
};

/* White noise of variance 1: the same for the same seed, stream and number. */
double noise(uint64_t seed, uint64_t stream, uint64_t number);

#endif
