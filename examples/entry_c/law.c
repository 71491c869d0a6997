/* A PID law with feedforward as an entry of the benchmark: docs/benchmark.md has the messages.
 *
 *     cc -O2 -ffp-contract=off -o law law.c
 *     ballplate bench run . --out ../entry
 */
#include <stdio.h>
#include <string.h>

enum { START, COMMAND };              /* kinds of message */
enum { X = 0, EQUIVALENT = 8, RATE = 16, REQUESTED = 18, PATH = 20, PER_RIG = 30 }; /* of each rig */
enum { MOST = 4096 };                 /* rigs side by side */

static double message[2 + PER_RIG * MOST], u[2 * MOST], q[2 * MOST];
static double period;

/* Plate accelerations of one rig in rad/s^2; q is the integral of its error. */
static void command(const double *rig, double *u, double *q)
{
    static const double sign[2] = {1.0, -1.0}; /* of a tilt that accelerates the ball along the axis */
    for (int axis = 0; axis < 2; axis++) {
        const double *x = rig + EQUIVALENT + 4 * axis; /* position, speed, tilt, its rate */
        const double *path = rig + PATH + axis;        /* position, speed, acceleration: 2 apart */
        double e = path[0] - x[0], v = path[2] - x[1];
        double desired = path[4] + 4.0 * e + 4.0 * v + 1.0 * q[axis];
        double tilt = sign[axis] * desired / 7.0; /* a ball rolls with 5/7 of 9.81 m/s^2 */
        u[axis] = 400.0 * (tilt - x[2]) - 40.0 * x[3];
        q[axis] += period * e;
    }
}

int main(void)
{
    double count;
    while (fread(&count, sizeof count, 1, stdin) == 1) {
        size_t n = (size_t)count, rigs;
        if (n < 2 || n > sizeof message / sizeof *message || fread(message, sizeof *message, n, stdin) != n)
            return 1;
        if (message[0] == START) {
            period = message[1];
            memset(q, 0, sizeof q);
            continue;
        }
        rigs = (n - 2) / PER_RIG;
        for (size_t k = 0; k < rigs; k++)
            command(message + 2 + PER_RIG * k, u + 2 * k, q + 2 * k);
        count = 2.0 * (double)rigs;
        fwrite(&count, sizeof count, 1, stdout);
        fwrite(u, sizeof *u, 2 * rigs, stdout);
        fflush(stdout);
    }
    return 0;
}
