/* An AKD-like CiA 402 drive on CANopen, frames in, frames out, time in steps, in C99.

   A second implementation of twin.emulator.drive, byte for byte the same answers. SI units; counts
   only in objects. The shaft is an inertia with viscous friction: with power the drive makes it
   follow its ramps exactly, without power friction and load move it. */

#ifndef DRIVE_H
#define DRIVE_H

#include <stdint.h>

#include "can_bus.h"
#include "drive_objects.h" /* written with each FMU: OBJECTS and the constants of the emulation */

enum ObjectAccess { READ_ONLY_ACCESS, WRITE_ACCESS, PDO_WRITE_ACCESS };

/* What is known of an object. */
typedef struct {
    uint16_t index;
    uint8_t sub, size; /* size in bytes */
    uint8_t is_signed, access, in_pdo, adds_node;
    int64_t start; /* at power-up; `adds_node`: and the node */
} ObjectKind;

extern const ObjectKind OBJECT_KINDS[OBJECTS]; /* in the order of index and subindex */
extern const uint32_t EMERGENCY_CODES[EMERGENCIES][2]; /* number of a fault, its code */

enum { PDOS = 4, MAX_FAULTS = 8 };

enum NmtState { STOPPED = 4, OPERATIONAL = 5, PRE_OPERATIONAL = 127 };

/* States of the power stage by bits 0 to 3, 5 and 6 of the status word. */
enum Power {
    SWITCH_ON_DISABLED = 0x40,
    READY = 0x21,
    SWITCHED_ON = 0x23,
    OPERATION_ENABLED = 0x27,
    QUICK_STOP = 0x07,
    FAULT_REACTION = 0x0F,
    FAULTED = 0x08
};

/* A drive, all of it: plain data, so that a copy of the bytes is a copy of the drive. */
typedef struct {
    /* set from outside; kept over a reboot */
    int node;
    int32_t start_counts;     /* motor position at power-up */
    double inertia, friction; /* of the shaft, kg m^2 and N m s/rad */
    double load_torque;       /* on the shaft, N m */
    int sto_closed, dc_link;

    /* communication */
    int nmt;
    int64_t objects[OBJECTS];
    int pending[PDOS], pendings; /* receive PDOs that wait for a SYNC, oldest first */
    uint8_t received[PDOS][8];
    size_t received_length[PDOS];
    int syncs[PDOS];     /* since the transmit PDO was sent */
    double beat;         /* time since the last heartbeat, s */
    double silence;      /* of the monitored node, s; negative: not monitored */
    Operations sent;     /* since the caller took them */

    /* power stage */
    int power;
    unsigned control;
    int quick_stop_option;
    uint16_t faults[MAX_FAULTS]; /* present ones, oldest first */
    int fault_count;
    double target; /* rad/s */

    /* motor */
    double angle, rate, torque; /* rad, rad/s, N m */
    int limited;                /* whether the velocity limit cut the target */
} Drive;

void drive_power_on(Drive *drive);
void drive_receive(Drive *drive, const CanFrame *frame); /* any frame on the bus */
void drive_step(Drive *drive, double dt);                /* let dt seconds pass */
unsigned drive_status(const Drive *drive);               /* status word */

#endif
