/* The model of this FMU: the rig. */

#ifndef MODEL_H
#define MODEL_H

#include "rig.h"

typedef Rig Model;

#endif
