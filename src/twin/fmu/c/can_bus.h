/* Operations on a CAN bus as FMI-LS-BUS 1.0 has them: bytes that simulated nodes exchange.

   An operation is 4 bytes of a code, 4 of its whole length and its arguments, little-endian. */

#ifndef CAN_BUS_H
#define CAN_BUS_H

#include <stddef.h>
#include <stdint.h>

enum Operation {
    MALFORMED = 0x00, /* none of the standard: what cannot be an operation */
    FORMAT_ERROR = 0x01,
    CAN_TRANSMIT = 0x10,
    CAN_FD_TRANSMIT = 0x11,
    CAN_XL_TRANSMIT = 0x12,
    CONFIRM = 0x20,
    ARBITRATION_LOST = 0x30,
    BUS_ERROR = 0x31,
    CONFIGURATION = 0x40,
    STATUS = 0x41,
    WAKE_UP = 0x42
};

enum { OPERATION_BYTES = 8192 }; /* the most that is sent or received in one event */

/* A frame of classic CAN. */
typedef struct {
    uint32_t id;
    int extended, remote;
    size_t length;
    uint8_t data[8];
} CanFrame;

/* Operations one after the other. */
typedef struct {
    size_t size;
    int lost; /* operations that found no place */
    uint8_t bytes[OPERATION_BYTES];
} Operations;

void write_frame(Operations *to, const CanFrame *frame);
void write_bit_rate(Operations *to, uint32_t bits_per_s);
void write_buffering(Operations *to); /* the bus repeats frames that lose arbitration */
void write_format_error(Operations *to, const uint8_t *operation, size_t size);

/* The kind of the operation at the start of some bytes, and how many of them it has. The bytes of
   a MALFORMED one belong in a format error. A frame is filled in for CAN_TRANSMIT. */
enum Operation read_operation(const uint8_t *bytes, size_t size, size_t *length, CanFrame *frame);

uint32_t read_number(const uint8_t *bytes, size_t size); /* of up to 4 bytes, little-endian */
void write_number(uint8_t *bytes, uint32_t value, size_t size);

#endif
