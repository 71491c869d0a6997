// The board's firmware as a sketch: open this folder in the Arduino IDE, choose Uno or Nano, upload.
// The IDE compiles firmware.c along with this file. It has a main() of its own, with its own timers
// and serial line, in place of setup(), loop() and Serial; so nothing else is needed here.
// For a board that computes, put controller.c and controller.h of `ballplate export` into this
// folder, and set BOARD_COMPUTES in rig.h to 1.
#include "rig.h"
