/* Numbers of the rig: servos, plate, and when the board levels the plate by itself.
 * Edit them before flashing; each may also be given to the compiler, -DNEUTRAL_US_PHI=1490. */
#ifndef RIG_H
#define RIG_H

/* Width of the servo pulses at which the plate is level, us. This trim also takes in the error of
 * the board's clock: one that is 1 % fast makes every pulse 1 % shorter. */
#ifndef NEUTRAL_US_PHI
#define NEUTRAL_US_PHI 1500
#endif
#ifndef NEUTRAL_US_THETA
#define NEUTRAL_US_THETA 1500
#endif

/* Change of the pulse width per plate angle, us/rad; negative for a servo mounted the other way.
 * 1910: a servo of 180 deg for 2000 us, with rods that turn the plate by a third. */
#ifndef US_PER_RAD_PHI
#define US_PER_RAD_PHI 1910
#endif
#ifndef US_PER_RAD_THETA
#define US_PER_RAD_THETA 1910
#endif

/* Limits of the plate angle, rad, and of every pulse, us. */
#ifndef MAX_ANGLE_RAD
#define MAX_ANGLE_RAD 0.21f
#endif
#ifndef MIN_PULSE_US
#define MIN_PULSE_US 1000
#endif
#ifndef MAX_PULSE_US
#define MAX_PULSE_US 2000
#endif

/* Time after the last valid frame of the host until the plate is levelled, ms. */
#ifndef HOST_TIMEOUT_MS
#define HOST_TIMEOUT_MS 100
#endif

/* 1 if controller.c, written by `ballplate export`, is compiled in: the board may compute. */
#ifndef BOARD_COMPUTES
#define BOARD_COMPUTES 0
#endif

/* The rest is for a board that computes. Time constant with which the plate follows its servos, s:
 * the plate has no encoder. The ball must be within this distance of the middle along x and y, m,
 * and must not be unseen for longer than this time, ms, or the plate is levelled. */
#ifndef PLATE_LAG_S
#define PLATE_LAG_S 0.06f
#endif
#ifndef MAX_BALL_M
#define MAX_BALL_M 0.13f
#endif
#ifndef BALL_TIMEOUT_MS
#define BALL_TIMEOUT_MS 200
#endif

#endif
