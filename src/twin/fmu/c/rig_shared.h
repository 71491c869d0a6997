/* What the chapters of the rig share: its numbers and the draws of its noise. */

#ifndef RIG_SHARED_H
#define RIG_SHARED_H

#include "rig.h"

#include <math.h>
#include <string.h>

static const double PI = 3.14159265358979323846;

static double smaller(double a, double b) { return b < a ? b : a; }
static double larger(double a, double b) { return b > a ? b : a; }

/* The draw of a stream in this control period, held as long as the scenario says. */
static double drawn(const Rig *rig, int stream, double deviation) {
    if (deviation == 0 || !rig->v[NOISE])
        return 0;
    uint64_t number = (uint64_t)(rig->tick / rig->fixed.hold);
    return deviation * noise((uint64_t)rig->v[SEED], (uint64_t)stream, number);
}

#endif
