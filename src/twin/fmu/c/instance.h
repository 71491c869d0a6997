/* What both versions of the interface share: one instance of the model, and what may be done to it.
   Each function returns 1 if it was done, 0 if not; then `message` says why. */

#ifndef INSTANCE_H
#define INSTANCE_H

#include <stddef.h>

#include "model.h" /* Model and its functions: the rig or a controller */

enum Phase { MADE, BEGINNING, STEPPING, ENDED };

typedef struct {
    int phase;
    Model model;
} State; /* what is saved and restored */

typedef struct {
    State state;
    char message[256]; /* what went wrong last */
} Instance;

void instance_reset(Instance *it);
int instance_get(Instance *it, int type, unsigned variable, double *value);
int instance_set(Instance *it, int type, unsigned variable, double value);
int instance_enter(Instance *it, double start); /* initialization mode */
int instance_exit(Instance *it);
int instance_step(Instance *it, double time, double length);
int instance_end(Instance *it);
int instance_save(Instance *it, void **saved); /* a copy of the bytes, made where there is none */
int instance_restore(Instance *it, const void *bytes, size_t size);
int instance_serialize(Instance *it, const void *saved, void *bytes, size_t size);
int instance_deserialize(Instance *it, const void *bytes, size_t size, void **saved);
void instance_forget(void **saved);
int instance_refuse(Instance *it, const char *what); /* what this kind of FMU cannot do */

#endif
