/* White noise of a counter generator.

   What is drawn depends on seed, stream and number of the draw alone, so it has no state. Each of
   the three goes through the finaliser of SplitMix64 (Steele, Lea, Flood 2014); two uniform numbers
   make a normal one after Box and Muller. */

#include "rig.h"

#include <math.h>

static const double PI = 3.14159265358979323846;

static uint64_t mixed(uint64_t z) {
    z += 0x9E3779B97F4A7C15u;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

double noise(uint64_t seed, uint64_t stream, uint64_t number) {
    uint64_t bits = mixed(mixed(mixed(seed) + stream) + number);
    double u = (double)((mixed(bits) >> 11) + 1) * 0x1p-53;
    double v = (double)(mixed(bits + 1) >> 11) * 0x1p-53;
    return sqrt(-2 * log(u)) * cos(2 * PI * v);
}
