#include "can_bus.h"

#include <string.h>

enum { HEADER = 8, MAX_LENGTH = 0xFFFF };
enum { BIT_RATE = 0x01, ARBITRATION_LOST_BEHAVIOR = 0x04, BUFFER_AND_RETRANSMIT = 0x01 };

uint32_t read_number(const uint8_t *bytes, size_t size) {
    uint32_t value = 0;
    for (size_t i = 0; i < size; i++)
        value |= (uint32_t)bytes[i] << 8 * i;
    return value;
}

void write_number(uint8_t *bytes, uint32_t value, size_t size) {
    for (size_t i = 0; i < size; i++)
        bytes[i] = (uint8_t)(value >> 8 * i);
}

/* ---- Writing ----------------------------------------------------------------------------------- */

/* Where the arguments of a further operation begin; NULL if it has no place. */
static uint8_t *add_operation(Operations *to, enum Operation code, size_t arguments) {
    size_t length = HEADER + arguments;
    if (length > sizeof to->bytes - to->size) {
        to->lost++;
        return NULL;
    }
    uint8_t *at = to->bytes + to->size;
    write_number(at, (uint32_t)code, 4);
    write_number(at + 4, (uint32_t)length, 4);
    to->size += length;
    return at + HEADER;
}

void write_frame(Operations *to, const CanFrame *frame) {
    uint8_t *at = add_operation(to, CAN_TRANSMIT, 8 + frame->length);
    if (!at)
        return;
    write_number(at, frame->id, 4);
    at[4] = (uint8_t)frame->extended;
    at[5] = (uint8_t)frame->remote;
    write_number(at + 6, (uint32_t)frame->length, 2);
    memcpy(at + 8, frame->data, frame->length);
}

void write_bit_rate(Operations *to, uint32_t bits_per_s) {
    uint8_t *at = add_operation(to, CONFIGURATION, 5);
    if (!at)
        return;
    at[0] = BIT_RATE;
    write_number(at + 1, bits_per_s, 4);
}

void write_buffering(Operations *to) {
    uint8_t *at = add_operation(to, CONFIGURATION, 2);
    if (!at)
        return;
    at[0] = ARBITRATION_LOST_BEHAVIOR;
    at[1] = BUFFER_AND_RETRANSMIT;
}

void write_format_error(Operations *to, const uint8_t *operation, size_t size) {
    size_t kept = size < MAX_LENGTH ? size : MAX_LENGTH;
    uint8_t *at = add_operation(to, FORMAT_ERROR, 2 + kept);
    if (!at)
        return;
    write_number(at, (uint32_t)kept, 2);
    memcpy(at + 2, operation, kept);
}

/* ---- Reading ----------------------------------------------------------------------------------- */

/* Length of an operation whose last argument is `data` bytes, as many as 2 bytes in front of it
   say; 0 if it is shorter than that. */
static size_t length_with_data(const uint8_t *bytes, size_t length, size_t data_at) {
    return length < data_at ? 0 : data_at + read_number(bytes + data_at - 2, 2);
}

/* Whether an operation of a known code has the length of its kind. */
static int has_its_length(const uint8_t *bytes, size_t length) {
    switch ((enum Operation)read_number(bytes, 4)) {
    case FORMAT_ERROR:
        return length == length_with_data(bytes, length, 10);
    case CAN_TRANSMIT:
        return length == length_with_data(bytes, length, 16);
    case CAN_FD_TRANSMIT:
        return length == length_with_data(bytes, length, 17);
    case CAN_XL_TRANSMIT:
        return length == length_with_data(bytes, length, 22);
    case CONFIRM:
    case ARBITRATION_LOST:
        return length == 12;
    case BUS_ERROR:
        return length == 15;
    case CONFIGURATION:
        return length == 10 || length == 13;
    case STATUS:
        return length == 9;
    case WAKE_UP:
        return length == 8;
    case MALFORMED:
        break;
    }
    return 0;
}

/* Whether the arguments of a transmitted frame are those of classic CAN. */
static int read_frame(const uint8_t *bytes, CanFrame *frame) {
    frame->id = read_number(bytes + 8, 4);
    frame->extended = bytes[12];
    frame->remote = bytes[13];
    frame->length = read_number(bytes + 14, 2);
    if (frame->extended > 1 || frame->remote > 1 || frame->length > sizeof frame->data ||
        frame->id > (frame->extended ? 0x1FFFFFFFu : 0x7FFu))
        return 0;
    memcpy(frame->data, bytes + 16, frame->length);
    return 1;
}

enum Operation read_operation(const uint8_t *bytes, size_t size, size_t *length, CanFrame *frame) {
    size_t stated = size < HEADER ? 0 : read_number(bytes + 4, 4);
    int whole = stated >= HEADER && stated <= size;
    *length = whole ? stated : size; /* nobody knows where the next one would begin */
    if (!whole || !has_its_length(bytes, stated))
        return MALFORMED;
    enum Operation code = (enum Operation)read_number(bytes, 4);
    if (code == CAN_TRANSMIT && !read_frame(bytes, frame))
        return MALFORMED;
    return code;
}
