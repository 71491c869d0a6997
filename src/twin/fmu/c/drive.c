#include "drive.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double PARAMETER_UNIT = 0.001 * RPM; /* a count of limits and ramps, rad/s, rad/s^2 */
static const double MODE_CHANGE_RAD_S = 0.01;     /* at which the mode may not change */
static const double STANDSTILL_RAD_S = 1e-3;
static const double REST_RAD_S = 1e-4; /* below which a motor without power stands */

static void obey_object(Drive *drive, uint16_t index);

/* ---- Frames ------------------------------------------------------------------------------------ */

static void send(Drive *drive, uint32_t id, const uint8_t *data, size_t length) {
    CanFrame frame = {id, 0, 0, length, {0}};
    memcpy(frame.data, data, length);
    write_frame(&drive->sent, &frame);
}

static void send_emergency(Drive *drive, uint32_t code, uint8_t error_register, const char *extra) {
    uint8_t data[8] = {0};
    write_number(data, code, 2);
    data[2] = error_register;
    for (size_t i = 0; i < 5 && extra[i]; i++)
        data[3 + i] = (uint8_t)extra[i];
    send(drive, 0x080u + (uint32_t)drive->node, data, sizeof data);
}

/* ---- Objects ----------------------------------------------------------------------------------- */

static int compare_objects(const void *a, const void *b) {
    const ObjectKind *left = a, *right = b;
    int by_index = (left->index > right->index) - (left->index < right->index);
    return by_index ? by_index : (left->sub > right->sub) - (left->sub < right->sub);
}

static const ObjectKind *find_object(uint16_t index, uint8_t sub) {
    ObjectKind wanted = {index, sub, 0, 0, 0, 0, 0, 0};
    return bsearch(&wanted, OBJECT_KINDS, OBJECTS, sizeof wanted, compare_objects);
}

static int has_index(uint16_t index) {
    for (size_t i = 0; i < OBJECTS; i++)
        if (OBJECT_KINDS[i].index == index)
            return 1;
    return 0;
}

static int64_t wrap_counts(double counts, int64_t offset) {
    int64_t wrapped = ((int64_t)floor(counts) + offset + (INT64_C(1) << 31)) & 0xFFFFFFFF;
    return wrapped - (INT64_C(1) << 31);
}

static int64_t motor_counts(const Drive *drive) {
    return wrap_counts(drive->angle / TURN_RAD * MOTOR_COUNTS, drive->start_counts);
}

static int64_t plate_counts(const Drive *drive) {
    return wrap_counts(PLATE_PER_MOTOR * drive->angle / TURN_RAD * PLATE_COUNTS, 0);
}

/* Value of an object that exists. */
static int64_t get_object(const Drive *drive, uint16_t index, uint8_t sub) {
    switch (index) {
    case 0x1001:
        return drive->fault_count > 0;
    case 0x2001:
        if (sub)
            return sub <= drive->fault_count ? drive->faults[sub - 1] : 0;
        break;
    case 0x2050:
        return plate_counts(drive);
    case 0x6041:
        return drive_status(drive);
    case 0x6061:
        return get_object(drive, 0x6060, 0);
    case 0x6064:
        return motor_counts(drive);
    case 0x606C:
        return (int64_t)rint(drive->rate / VELOCITY_UNIT);
    case 0x60E4:
        if (sub == 1)
            return motor_counts(drive);
        if (sub == 2)
            return plate_counts(drive);
        break;
    }
    return drive->objects[find_object(index, sub) - OBJECT_KINDS];
}

static int64_t decode_value(const uint8_t *data, size_t size, int is_signed) {
    int64_t value = read_number(data, size);
    int64_t range = INT64_C(1) << 8 * size;
    return is_signed && size && value >= range / 2 ? value - range : value;
}

enum Abort {
    NO_ABORT = 0,
    UNKNOWN_COMMAND = 0x05040001,
    READ_ONLY = 0x06010002,
    NO_OBJECT = 0x06020000,
    NOT_MAPPABLE = 0x06040041,
    PDO_TOO_LONG = 0x06040042,
    WRONG_LENGTH = 0x06070010,
    NO_SUBINDEX = 0x06090011,
    OUT_OF_RANGE = 0x06090030,
    NOT_NOW = 0x08000022
};

static const int64_t PDO_IS_OFF = INT64_C(1) << 31;

static int is_pdo_parameter(unsigned index) {
    return (index >= 0x1400 && index < 0x1400 + PDOS) || (index >= 0x1800 && index < 0x1800 + PDOS);
}

static enum Abort check_mapping_entry(int64_t entry, int is_received) {
    const ObjectKind *known = find_object((uint16_t)(entry >> 16), (uint8_t)(entry >> 8));
    if (!known || !known->in_pdo || 8 * known->size != (entry & 0xFF))
        return NOT_MAPPABLE;
    return is_received && known->access != PDO_WRITE_ACCESS ? NOT_MAPPABLE : NO_ABORT;
}

/* CiA 301's order: switch the PDO off, count to 0, entries, count, switch it on. */
static enum Abort check_pdo(const Drive *drive, uint16_t index, uint8_t sub, int64_t value) {
    if (is_pdo_parameter(index) && sub == 1) {
        int64_t present = get_object(drive, index, 1);
        if (!((present | value) & PDO_IS_OFF) && present != value)
            return NOT_NOW;
    }
    if (index < 0x200 || !is_pdo_parameter(index - 0x200u))
        return NO_ABORT;
    if (!(get_object(drive, (uint16_t)(index - 0x200), 1) & PDO_IS_OFF))
        return NOT_NOW;
    if (sub)
        return get_object(drive, index, 0) ? NOT_NOW
               : value                     ? check_mapping_entry(value, index < 0x1800)
                                           : NO_ABORT;
    if (value > PDO_ENTRIES)
        return OUT_OF_RANGE;
    int64_t bits = 0;
    for (int i = 1; i <= value; i++)
        bits += get_object(drive, index, (uint8_t)i) & 0xFF;
    return bits > 64 ? PDO_TOO_LONG : NO_ABORT;
}

static enum Abort check_mode(const Drive *drive, int64_t mode) {
    if (mode < -3 || mode > 8 || !(AKD_MODES >> (mode + 3) & 1))
        return OUT_OF_RANGE;
    int turning = fabs(drive->rate) >= MODE_CHANGE_RAD_S;
    return turning && mode != get_object(drive, 0x6060, 0) ? NOT_NOW : NO_ABORT;
}

static enum Abort find_or_abort(uint16_t index, uint8_t sub, const ObjectKind **found) {
    *found = find_object(index, sub);
    if (*found)
        return NO_ABORT;
    return has_index(index) ? NO_SUBINDEX : NO_OBJECT;
}

static enum Abort write_object(Drive *drive, uint16_t index, uint8_t sub, const uint8_t *data,
                               size_t size) {
    const ObjectKind *known;
    enum Abort abort_code = find_or_abort(index, sub, &known);
    if (abort_code)
        return abort_code;
    if (known->access == READ_ONLY_ACCESS)
        return READ_ONLY;
    if (size != known->size)
        return WRONG_LENGTH;
    int64_t value = decode_value(data, size, known->is_signed);
    if (index == 0x6060)
        abort_code = check_mode(drive, value);
    if (!abort_code)
        abort_code = check_pdo(drive, index, sub, value);
    if (!abort_code)
        drive->objects[known - OBJECT_KINDS] = value;
    return abort_code;
}

/* ---- SDO server: expedited transfers, as the objects need no others ---------------------------- */

static enum Abort answer_read(const Drive *drive, uint16_t index, uint8_t sub, uint8_t answer[8]) {
    const ObjectKind *known;
    enum Abort abort_code = find_or_abort(index, sub, &known);
    if (abort_code)
        return abort_code;
    answer[0] = (uint8_t)(0x43 | (4 - known->size) << 2);
    write_number(answer + 4, (uint32_t)get_object(drive, index, sub), known->size);
    return NO_ABORT;
}

static enum Abort answer_write(Drive *drive, uint16_t index, uint8_t sub, const uint8_t *request,
                               uint8_t answer[8]) {
    size_t size = 4 - (request[0] >> 2 & 3u);
    if (request[0] == 0x22) { /* the client leaves the size open */
        const ObjectKind *known;
        enum Abort missing = find_or_abort(index, sub, &known);
        if (missing)
            return missing;
        size = known->size;
    }
    enum Abort abort_code = write_object(drive, index, sub, request + 4, size);
    if (abort_code)
        return abort_code;
    obey_object(drive, index);
    answer[0] = 0x60;
    return NO_ABORT;
}

static void receive_sdo(Drive *drive, const CanFrame *frame) {
    const uint8_t *request = frame->data;
    if (frame->length != 8 || request[0] == 0x80)
        return;
    uint16_t index = (uint16_t)read_number(request + 1, 2);
    uint8_t sub = request[3], answer[8] = {0};
    enum Abort abort_code = UNKNOWN_COMMAND;
    memcpy(answer + 1, request + 1, 3);
    if ((request[0] & 0xE0) == 0x40)
        abort_code = answer_read(drive, index, sub, answer);
    else if ((request[0] & 0xE3) == 0x23 || request[0] == 0x22)
        abort_code = answer_write(drive, index, sub, request, answer);
    if (abort_code) {
        answer[0] = 0x80;
        write_number(answer + 4, (uint32_t)abort_code, 4);
    }
    send(drive, 0x580u + (uint32_t)drive->node, answer, sizeof answer);
}

/* ---- PDOs -------------------------------------------------------------------------------------- */

enum { LAST_SYNCHRONOUS = 240 };
enum { PDO_TOO_SHORT_CODE = 0x8210, PDO_TOO_LONG_CODE = 0x8220 };

/* One entry of what a PDO carries; NULL for an empty one. */
static const ObjectKind *mapped_object(const Drive *drive, uint16_t record, int sub) {
    int64_t entry = get_object(drive, record, (uint8_t)sub);
    return find_object((uint16_t)(entry >> 16), (uint8_t)(entry >> 8));
}

static size_t mapped_bytes(const Drive *drive, uint16_t record) {
    size_t bytes = 0;
    for (int sub = 1; sub <= get_object(drive, record, 0); sub++)
        bytes += (size_t)(get_object(drive, record, (uint8_t)sub) & 0xFF) / 8;
    return bytes;
}

static void apply_pdo(Drive *drive, int number, const uint8_t *data, size_t length) {
    uint16_t record = (uint16_t)(0x1600 + number);
    int64_t entries = get_object(drive, record, 0);
    size_t at = 0;
    /* Values first: a control word must not enable with the target of an earlier cycle. */
    for (int sub = 1; sub <= entries; sub++) {
        const ObjectKind *object = mapped_object(drive, record, sub);
        if (!object)
            continue;
        size_t left = at < length ? length - at : 0;
        size_t size = object->size < left ? object->size : left;
        drive->objects[object - OBJECT_KINDS] = decode_value(data + at, size, object->is_signed);
        at += object->size;
    }
    for (int sub = 1; sub <= entries; sub++) {
        const ObjectKind *object = mapped_object(drive, record, sub);
        if (object)
            obey_object(drive, object->index);
    }
}

static void receive_pdo(Drive *drive, const CanFrame *frame) {
    for (int number = 0; number < PDOS; number++) {
        uint16_t parameters = (uint16_t)(0x1400 + number);
        int64_t cob_id = get_object(drive, parameters, 1);
        if (cob_id & PDO_IS_OFF || (cob_id & 0x7FF) != frame->id)
            continue;
        size_t needed = mapped_bytes(drive, (uint16_t)(0x1600 + number));
        if (frame->length < needed) {
            send_emergency(drive, PDO_TOO_SHORT_CODE, 0x10, "");
            return;
        }
        if (get_object(drive, parameters, 2) <= LAST_SYNCHRONOUS) {
            int waits = 0;
            for (int i = 0; i < drive->pendings; i++)
                waits |= drive->pending[i] == number;
            if (!waits)
                drive->pending[drive->pendings++] = number;
            memcpy(drive->received[number], frame->data, frame->length);
            drive->received_length[number] = frame->length;
        } else {
            apply_pdo(drive, number, frame->data, frame->length);
        }
        if (frame->length > needed)
            send_emergency(drive, PDO_TOO_LONG_CODE, 0x10, "");
        return;
    }
}

/* Whether the transmit PDO of a number is to be sent at this SYNC. */
static int is_due(Drive *drive, int number) {
    uint16_t parameters = (uint16_t)(0x1800 + number);
    int64_t kind = get_object(drive, parameters, 2);
    if (get_object(drive, parameters, 1) & PDO_IS_OFF || kind < 1 || kind > LAST_SYNCHRONOUS)
        return 0;
    if (++drive->syncs[number] < kind)
        return 0;
    drive->syncs[number] = 0;
    return 1;
}

static CanFrame sample_pdo(const Drive *drive, int number) {
    uint16_t record = (uint16_t)(0x1A00 + number);
    CanFrame frame = {0, 0, 0, 0, {0}};
    frame.id = get_object(drive, (uint16_t)(0x1800 + number), 1) & 0x7FF;
    for (int sub = 1; sub <= get_object(drive, record, 0); sub++) {
        const ObjectKind *object = mapped_object(drive, record, sub);
        if (!object)
            continue;
        int64_t value = get_object(drive, object->index, object->sub);
        write_number(frame.data + frame.length, (uint32_t)value, object->size);
        frame.length += object->size;
    }
    return frame;
}

/* Sample the synchronous transmit PDOs, then apply what was received for this SYNC. */
static void receive_sync(Drive *drive) {
    CanFrame sampled[PDOS];
    int count = 0;
    for (int number = 0; number < PDOS; number++)
        if (is_due(drive, number))
            sampled[count++] = sample_pdo(drive, number);
    for (int i = 0; i < drive->pendings; i++) {
        int number = drive->pending[i];
        apply_pdo(drive, number, drive->received[number], drive->received_length[number]);
    }
    drive->pendings = 0;
    for (int i = 0; i < count; i++)
        write_frame(&drive->sent, &sampled[i]);
}

/* ---- Power stage ------------------------------------------------------------------------------- */

enum { STO_FAULT = 602, UNDERVOLTAGE_FAULT = 502, NO_VOLTAGE = 247, MASTER_SILENT = 129 };

static int has_torque(const Drive *drive) {
    return drive->power == SWITCHED_ON || drive->power == OPERATION_ENABLED ||
           drive->power == QUICK_STOP || drive->power == FAULT_REACTION;
}

static int has_fault(const Drive *drive, int number) {
    for (int i = 0; i < drive->fault_count; i++)
        if (drive->faults[i] == number)
            return 1;
    return 0;
}

/* Go into fault; braked: with torque until standstill. */
static void fail(Drive *drive, int number, int braked) {
    uint32_t code = OTHER_EMERGENCY;
    char name[16];
    if (has_fault(drive, number) || drive->fault_count == MAX_FAULTS)
        return;
    drive->faults[drive->fault_count++] = (uint16_t)number;
    if (drive->power != FAULTED)
        drive->power = braked && has_torque(drive) ? FAULT_REACTION : FAULTED;
    for (size_t i = 0; i < EMERGENCIES; i++)
        if (EMERGENCY_CODES[i][0] == (uint32_t)number)
            code = EMERGENCY_CODES[i][1];
    snprintf(name, sizeof name, "F%d", number);
    send_emergency(drive, code, 0x01, name);
}

/* Whether a present fault has a cause that persists. */
static int cause_persists(const Drive *drive) {
    int no_voltage = has_fault(drive, UNDERVOLTAGE_FAULT) || has_fault(drive, NO_VOLTAGE);
    return (!drive->sto_closed && has_fault(drive, STO_FAULT)) || (!drive->dc_link && no_voltage);
}

static void switch_on(Drive *drive) {
    if (!drive->sto_closed)
        fail(drive, STO_FAULT, 0);
    else if (!drive->dc_link)
        fail(drive, NO_VOLTAGE, 0);
    else
        drive->power = SWITCHED_ON;
}

/* Obey a control word, one transition at most. */
static void control_power(Drive *drive, unsigned word) {
    int resets = word & 0x80 && !(drive->control & 0x80);
    unsigned command = word & 0x0F;
    drive->control = word;
    if (drive->power == FAULTED) {
        if (resets && !cause_persists(drive)) {
            drive->fault_count = 0;
            drive->power = SWITCH_ON_DISABLED;
        }
    } else if (drive->power == FAULT_REACTION) {
        return;
    } else if (!(word & 0x02)) {
        drive->power = SWITCH_ON_DISABLED;
    } else if (!(word & 0x04)) {
        if (drive->power == OPERATION_ENABLED)
            drive->power = QUICK_STOP;
        else if (drive->power != QUICK_STOP)
            drive->power = SWITCH_ON_DISABLED;
    } else if (drive->power == QUICK_STOP) {
        if (command == 0x0F && drive->quick_stop_option >= 5)
            drive->power = OPERATION_ENABLED;
    } else if ((command & 0x07) == 0x06) {
        drive->power = READY;
    } else if (drive->power == READY) {
        switch_on(drive);
    } else if (drive->power == SWITCHED_ON || drive->power == OPERATION_ENABLED) {
        drive->power = command == 0x0F ? OPERATION_ENABLED : SWITCHED_ON;
    }
}

unsigned drive_status(const Drive *drive) {
    enum { VOLTAGE = 1 << 4, REMOTE = 1 << 9, LIMIT = 1 << 11 };
    return (unsigned)drive->power | (drive->dc_link ? VOLTAGE : 0u) | REMOTE |
           (drive->limited ? LIMIT : 0u);
}

/* What follows from a written object. */
static void obey_object(Drive *drive, uint16_t index) {
    if (index == 0x1017) {
        drive->beat = 0.0;
    } else if (index == 0x60FF) {
        drive->target = (double)get_object(drive, 0x60FF, 0) * VELOCITY_UNIT;
    } else if (index == 0x6040) {
        drive->quick_stop_option = (int)get_object(drive, 0x605A, 0);
        control_power(drive, (unsigned)get_object(drive, 0x6040, 0));
    }
}

/* ---- Motor ------------------------------------------------------------------------------------- */

/* Go on to a rate with the torque that this takes. */
static void drive_to_rate(Drive *drive, double rate, double dt) {
    double mean = (drive->rate + rate) / 2;
    drive->torque = drive->inertia * (rate - drive->rate) / dt + drive->friction * mean;
    drive->torque -= drive->load_torque;
    drive->angle += mean * dt;
    drive->rate = rate;
}

/* Ramp towards a target within limits. */
static void follow(Drive *drive, double target, double acceleration, double deceleration,
                   double lowest, double highest, double dt) {
    double clipped = fmax(lowest, fmin(highest, target));
    int faster = fabs(clipped) > fabs(drive->rate) && clipped * drive->rate >= 0;
    double step = (faster ? acceleration : deceleration) * dt;
    drive->limited = clipped != target;
    drive_to_rate(drive, drive->rate + fmax(-step, fmin(step, clipped - drive->rate)), dt);
}

/* Turn without torque of the drive, under friction and load. */
static void coast(Drive *drive, double dt) {
    double end = drive->load_torque / drive->friction;
    double rate = end + (drive->rate - end) * exp(-dt / (drive->inertia / drive->friction));
    drive->limited = 0;
    drive->torque = 0.0;
    if (drive->load_torque == 0.0 && !(fabs(rate) > REST_RAD_S))
        rate = 0.0;
    drive->angle += (drive->rate + rate) / 2 * dt;
    drive->rate = rate;
}

static void move(Drive *drive, double dt) {
    enum { PROFILE_VELOCITY = 3, HALT = 1 << 8 };
    if (drive->power == OPERATION_ENABLED) {
        int moving = get_object(drive, 0x6060, 0) == PROFILE_VELOCITY &&
                     !(get_object(drive, 0x6040, 0) & HALT);
        double most = (double)get_object(drive, 0x207F, 0);
        if (most == 0.0)
            most = 2147483648.0;
        double lowest = fmax((double)get_object(drive, 0x3623, 0), -most) * PARAMETER_UNIT;
        double highest = fmin((double)get_object(drive, 0x3622, 0), most) * PARAMETER_UNIT;
        follow(drive, moving ? drive->target : 0.0,
               (double)get_object(drive, 0x6083, 0) * PARAMETER_UNIT,
               (double)get_object(drive, 0x6084, 0) * PARAMETER_UNIT, lowest, highest, dt);
    } else if (has_torque(drive)) {
        follow(drive, 0.0, STOP_RAMP, STOP_RAMP, 0.0, 0.0, dt);
    } else {
        coast(drive, dt);
    }
}

/* ---- Network management and heartbeats --------------------------------------------------------- */

void drive_power_on(Drive *drive) {
    static const uint8_t BOOT_UP[1] = {0};
    for (size_t i = 0; i < OBJECTS; i++)
        drive->objects[i] =
            OBJECT_KINDS[i].start + (OBJECT_KINDS[i].adds_node ? drive->node : 0);
    drive->nmt = PRE_OPERATIONAL;
    drive->pendings = 0;
    memset(drive->syncs, 0, sizeof drive->syncs);
    drive->beat = 0.0;
    drive->silence = -1.0;
    drive->power = SWITCH_ON_DISABLED;
    drive->control = 0;
    drive->quick_stop_option = 2;
    drive->fault_count = 0;
    drive->target = 0.0;
    drive->angle = 0.0;
    drive->torque = 0.0;
    drive->limited = 0;
    send(drive, 0x700u + (uint32_t)drive->node, BOOT_UP, sizeof BOOT_UP);
}

static void command_network(Drive *drive, uint8_t command) {
    if (command == 1) {
        drive->nmt = OPERATIONAL;
        drive->pendings = 0;
        memset(drive->syncs, 0, sizeof drive->syncs);
    } else if (command == 2) {
        drive->nmt = STOPPED;
    } else if (command == 128) {
        drive->nmt = PRE_OPERATIONAL;
    } else if (command == 129 || command == 130) {
        drive_power_on(drive);
    }
}

/* Monitoring begins with the first heartbeat of the node that 1016h names. */
static void hear_heartbeat(Drive *drive, uint32_t node) {
    int64_t watched = get_object(drive, 0x1016, 1);
    if (watched & 0xFFFF && (watched >> 16 & 0x7F) == node)
        drive->silence = 0.0;
}

static int misses_heartbeat(Drive *drive, double dt) {
    double patience = (double)(get_object(drive, 0x1016, 1) & 0xFFFF) / 1e3;
    if (drive->silence < 0.0 || patience == 0.0) {
        drive->silence = -1.0;
        return 0;
    }
    drive->silence += dt;
    if (drive->silence <= patience)
        return 0;
    drive->silence = -1.0;
    return 1;
}

static int is_heartbeat_due(Drive *drive, double dt) {
    double period = (double)get_object(drive, 0x1017, 0) / 1e3;
    drive->beat += dt;
    if (period == 0.0 || drive->beat < period)
        return 0;
    drive->beat = fmod(drive->beat, period);
    return 1;
}

void drive_receive(Drive *drive, const CanFrame *frame) {
    uint32_t node = (uint32_t)drive->node;
    if (frame->remote || frame->extended)
        return;
    if (frame->id == 0 && frame->length == 2 && (!frame->data[1] || frame->data[1] == node))
        command_network(drive, frame->data[0]);
    else if (frame->id == (get_object(drive, 0x1005, 0) & 0x7FF) && drive->nmt == OPERATIONAL)
        receive_sync(drive);
    else if (frame->id == 0x600 + node && drive->nmt != STOPPED)
        receive_sdo(drive, frame);
    else if ((frame->id & ~0x7Fu) == 0x700)
        hear_heartbeat(drive, frame->id & 0x7F);
    else if (drive->nmt == OPERATIONAL)
        receive_pdo(drive, frame);
}

void drive_step(Drive *drive, double dt) {
    if (has_torque(drive) && !drive->sto_closed)
        fail(drive, STO_FAULT, 0);
    else if (has_torque(drive) && !drive->dc_link)
        fail(drive, UNDERVOLTAGE_FAULT, 0);
    if (misses_heartbeat(drive, dt))
        fail(drive, MASTER_SILENT, 1);
    move(drive, dt);
    if (fabs(drive->rate) < STANDSTILL_RAD_S) {
        if (drive->power == FAULT_REACTION)
            drive->power = FAULTED;
        else if (drive->power == QUICK_STOP && drive->quick_stop_option == 2)
            drive->power = SWITCH_ON_DISABLED;
    }
    if (is_heartbeat_due(drive, dt)) {
        uint8_t state = (uint8_t)drive->nmt;
        send(drive, 0x700u + (uint32_t)drive->node, &state, sizeof state);
    }
}
