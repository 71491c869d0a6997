/* Firmware of a ball-and-plate rig with two hobby servos, for an ATmega328P at 16 MHz.
 *
 * Pins (Arduino Uno or Nano): D9 servo of phi, D10 servo of theta, D0 and D1 serial line.
 * Timer 1 makes the servo pulses, timer 2 counts milliseconds. Interrupts only move bytes and count;
 * everything else is done in `main`, which a hardware watchdog guards.
 *
 * Serial line: 115,200 baud, 8N1. A frame is 0xB5, length of the content (1 byte), content, CRC-16
 * (2 bytes, polynomial 0x1021, begins at 0, over length and content); all numbers little-endian.
 * The first byte of the content is the type, the second a number that the status repeats.
 *
 *   from the host
 *     'A'  plate angles phi, theta (int16, 1e-5 rad): the host computes
 *     'B'  ball x, y (int16, 1e-5 m), age (uint8, ms), seen (uint8): the board computes
 *     'L'  level the plate; only after it 'A' and 'B' are obeyed, again
 *   to the host
 *     'R'  after a reset, number 0, and as the answer to 'L': cause of the reset (uint8, as MCUSR),
 *          version of this protocol, enum control
 *     'S'  once per servo frame: struct status
 *
 * What levels the plate (a reset, a host that is not heard, a ball that is not seen) holds until 'L'.
 */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>
#include <math.h>
#include <stdint.h>
#include <string.h>
#include <util/atomic.h>
#include <util/crc16.h>

#include "rig.h"

#if BOARD_COMPUTES
#include "controller.h"
#endif

#ifndef F_CPU
#define F_CPU 16000000UL
#endif

#define VERSION 1
#define FRAME_START 0xB5
#define MAX_CONTENT 32
#ifndef BUFFER_BYTES
#define BUFFER_BYTES 64 /* a power of two, more than a status with its frame */
#endif

#define TICKS_PER_US (F_CPU / 8 / 1000000UL)
#define SERVO_FRAME_US 20000UL
#define COMPARE(ticks) (uint16_t)((ticks) - 1) /* a pulse ends a tick after the match */
#define UNIT_RAD 1e-5f
#define UNIT_M 1e-5f

/* Bits of `status.state`: who moves the plate, or why it was levelled. */
enum { BY_HOST = 1, BY_BOARD = 2, HOST_LOST = 4, BALL_LOST = 8, NOT_FINITE = 16, RESTARTED = 32 };
#define MOVED (BY_HOST | BY_BOARD)

/* Whether the board has a controller, and whether its period is a servo frame. */
enum control { NO_CONTROLLER, CONTROLLER_FITS, OTHER_PERIOD };

/* Content of the frame 'S'. */
struct status {
    uint8_t type;
    uint8_t number;     /* of the last valid frame of the host */
    uint8_t state;      /* who moves the plate, or why it was levelled */
    uint8_t cause;      /* of the last reset, as MCUSR: 1 power-on, 2 pin, 4 brown-out, 8 watchdog */
    uint16_t time_ms;   /* of the board */
    uint16_t valid;     /* frames of the host */
    uint16_t invalid;   /* bytes of the host outside valid frames */
    uint16_t overruns;  /* bytes lost because a buffer was full */
    int16_t angle[2];   /* commanded plate angles phi, theta, 1e-5 rad */
    int16_t plate[2];   /* the same behind the lag of the servos: where the plate is computed to be */
    uint16_t pulse[2];  /* width of the servo pulses, in ticks of 0.5 us */
    uint16_t step_us;   /* computing time of the last control period; 0 if the host computes */
} __attribute__((packed));

struct buffer {
    uint8_t byte[BUFFER_BYTES];
    volatile uint8_t in, out;
};

static struct buffer received, to_send;
static volatile uint16_t milliseconds, overruns, pulse_ticks[2];
static volatile uint8_t servo_frame;
static uint16_t heard_at;
static struct status status = {.type = 'S'};
static float angle_rad[2], plate_rad[2];

/* ---- Reset ---- */

static uint8_t reset_cause __attribute__((section(".noinit")));

/* Before anything else: the bootloader Optiboot clears MCUSR and hands it over in r2. */
void keep_cause(void) __attribute__((naked, used, section(".init0")));
void keep_cause(void)
{
    __asm__ volatile("sts %0, r2" : : "i"(&reset_cause));
}

/* A watchdog that has fired stays on, with its shortest time, until it is set anew. */
void keep_watchdog_quiet(void) __attribute__((naked, used, section(".init3")));
void keep_watchdog_quiet(void)
{
    if (MCUSR & 0x0F)
        reset_cause = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

/* ---- Time and servo pulses ---- */

ISR(TIMER2_COMPA_vect)
{
    milliseconds++;
}

/* Pulses change at the beginning of a servo frame only, both in the same one. */
ISR(TIMER1_OVF_vect)
{
    OCR1A = COMPARE(pulse_ticks[0]);
    OCR1B = COMPARE(pulse_ticks[1]);
    servo_frame = 1;
}

static uint16_t time_ms(void)
{
    uint16_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) now = milliseconds;
    return now;
}

static void start_timers(void)
{
    DDRB |= (1 << DDB1) | (1 << DDB2);
    ICR1 = SERVO_FRAME_US * TICKS_PER_US - 1;
    OCR1A = COMPARE(pulse_ticks[0]);
    OCR1B = COMPARE(pulse_ticks[1]);
    TCCR1A = (1 << COM1A1) | (1 << COM1B1) | (1 << WGM11);
    TCCR1B = (1 << WGM13) | (1 << WGM12) | (1 << CS11); /* fast PWM up to ICR1, clock / 8 */
    TIMSK1 = 1 << TOIE1;
    OCR2A = F_CPU / 64 / 1000 - 1;
    TCCR2A = 1 << WGM21;
    TCCR2B = 1 << CS22; /* up to OCR2A, clock / 64 */
    TIMSK2 = 1 << OCIE2A;
}

/* Command plate angles in rad, within their limit, to the servos; they act in the next frame. */
static void move_plate(const float angle[2])
{
    static const float neutral_us[2] = {NEUTRAL_US_PHI, NEUTRAL_US_THETA};
    static const float us_per_rad[2] = {US_PER_RAD_PHI, US_PER_RAD_THETA};
    uint8_t i;
    for (i = 0; i < 2; i++) {
        const float limited = fmaxf(-MAX_ANGLE_RAD, fminf(MAX_ANGLE_RAD, angle[i]));
        const float us = neutral_us[i] + us_per_rad[i] * limited;
        const float pulse = fmaxf(MIN_PULSE_US, fminf(MAX_PULSE_US, us));
        const uint16_t ticks = (uint16_t)(pulse * TICKS_PER_US + 0.5f);
        angle_rad[i] = limited;
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE) pulse_ticks[i] = ticks;
    }
}

static void level_because(uint8_t why)
{
    static const float level[2] = {0, 0};
    status.state = why;
    move_plate(level);
}

/* ---- Serial line ---- */

static uint8_t next(uint8_t place)
{
    return (uint8_t)(place + 1) & (BUFFER_BYTES - 1);
}

/* A byte that finds the buffer full is lost and counted; its frame then fails the check sum. */
static void put(struct buffer *b, uint8_t byte)
{
    const uint8_t after = next(b->in);
    if (after == b->out) {
        overruns++;
        return;
    }
    b->byte[b->in] = byte;
    b->in = after;
}

ISR(USART_RX_vect)
{
    const uint8_t errors = UCSR0A & ((1 << FE0) | (1 << DOR0));
    const uint8_t byte = UDR0;
    if (errors & (1 << DOR0))
        overruns++;
    put(&received, byte);
}

ISR(USART_UDRE_vect)
{
    if (to_send.in == to_send.out) {
        UCSR0B &= (uint8_t)~(1 << UDRIE0);
        return;
    }
    UDR0 = to_send.byte[to_send.out];
    to_send.out = next(to_send.out);
}

static void start_line(void)
{
    UCSR0A = 1 << U2X0;
    UCSR0C = (1 << UCSZ01) | (1 << UCSZ00);
    UBRR0 = (F_CPU / 4 / 115200UL - 1) / 2; /* 16 at 16 MHz: 117,647 baud, 2.1 % fast */
    UCSR0B = (1 << RXCIE0) | (1 << RXEN0) | (1 << TXEN0);
}

static void send_byte(uint8_t byte)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) put(&to_send, byte);
}

static void send_frame(const void *content, uint8_t length)
{
    const uint8_t *bytes = content;
    uint16_t crc = _crc_xmodem_update(0, length);
    uint8_t i;
    send_byte(FRAME_START);
    send_byte(length);
    for (i = 0; i < length; i++) {
        crc = _crc_xmodem_update(crc, bytes[i]);
        send_byte(bytes[i]);
    }
    send_byte((uint8_t)crc);
    send_byte((uint8_t)(crc >> 8));
    UCSR0B |= 1 << UDRIE0;
}

static int16_t read_int16(const uint8_t *bytes)
{
    return (int16_t)(bytes[0] | (uint16_t)bytes[1] << 8);
}

static int16_t in_units(float value, float unit)
{
    return (int16_t)lroundf(value / unit);
}

/* ---- The board computes ---- */

#if BOARD_COMPUTES
#define FITS_SERVO_FRAME (fabsf(CONTROLLER_PERIOD_S - 1e-6f * SERVO_FRAME_US) < 1e-6f)
static struct controller controller;
static struct controller_measurement measurement;
static uint16_t arrived_at, seen_at;
static uint8_t age_ms;
static uint32_t periods;

/* Take in a ball position. The first one begins the control, and the time of the reference. */
static void take_ball(const uint8_t *content)
{
    const uint16_t now = time_ms();
    if (status.state != BY_BOARD) {
        controller_init(&controller);
        level_because(BY_BOARD);
        plate_rad[0] = plate_rad[1] = 0;
        periods = 0;
        seen_at = now;
    }
    measurement.x = UNIT_M * (float)read_int16(content);
    measurement.y = UNIT_M * (float)read_int16(content + 2);
    age_ms = content[4];
    measurement.touched = content[5] != 0;
    arrived_at = now;
    if (measurement.touched)
        seen_at = now;
}

/* One control period, at the beginning of a servo frame. */
static void control_plate(void)
{
    struct controller_reference reference;
    struct controller_command command;
    const uint16_t now = time_ms();
    float angle[2];
    uint8_t i;
    if ((uint16_t)(now - seen_at) > BALL_TIMEOUT_MS || fabsf(measurement.x) > MAX_BALL_M
        || fabsf(measurement.y) > MAX_BALL_M) {
        level_because(BALL_LOST);
        return;
    }
    measurement.phi = plate_rad[0];
    measurement.theta = plate_rad[1];
    measurement.age = 1e-3f * (float)(age_ms + (uint16_t)(now - arrived_at));
    controller_reference_at((float)periods++ * CONTROLLER_PERIOD_S, &reference);
    controller_step(&controller, &measurement, &reference, &command);
    if (!command.valid) {
        level_because(NOT_FINITE);
        return;
    }
    for (i = 0; i < 2; i++)
        angle[i] = angle_rad[i] + CONTROLLER_PERIOD_S * command.rate[i];
    move_plate(angle);
}
#endif

/* ---- Frames of the host ---- */

#if BOARD_COMPUTES
#define CONTROL (FITS_SERVO_FRAME ? CONTROLLER_FITS : OTHER_PERIOD)
#else
#define CONTROL NO_CONTROLLER
#endif

static void send_ready(uint8_t number)
{
    const uint8_t ready[] = {'R', number, reset_cause, VERSION, CONTROL};
    send_frame(ready, sizeof ready);
}

static void obey(const uint8_t *content, uint8_t length)
{
    const uint8_t *given = content + 2;
    const uint8_t may_move = !(status.state & ~MOVED);
    if (content[0] == 'A' && length == 6) {
        const float angle[2] = {UNIT_RAD * (float)read_int16(given),
                                UNIT_RAD * (float)read_int16(given + 2)};
        if (may_move) {
            status.state = BY_HOST;
            move_plate(angle);
        }
#if BOARD_COMPUTES
    } else if (content[0] == 'B' && length == 8) {
        if (may_move && FITS_SERVO_FRAME)
            take_ball(given);
#endif
    } else if (content[0] == 'L' && length == 2) {
        level_because(0);
        send_ready(content[1]);
    } else
        return;
    status.number = content[1];
    heard_at = time_ms();
}

/* Take in a byte. After a failed check sum the next frame is sought within the bytes of this one, so
 * that a lost byte costs its own frame and no other. */
static void take_byte(uint8_t byte)
{
    static uint8_t frame[MAX_CONTENT + 4];
    static uint8_t count;
    frame[count++] = byte;
    while (count) {
        uint8_t i, valid = 1;
        if (frame[0] != FRAME_START)
            valid = 0;
        else if (count > 1 && (frame[1] < 2 || frame[1] > MAX_CONTENT))
            valid = 0;
        else if (count < 2 || count < frame[1] + 4)
            return;
        else {
            uint16_t crc = 0;
            for (i = 1; i < frame[1] + 2; i++)
                crc = _crc_xmodem_update(crc, frame[i]);
            valid = crc == (uint16_t)read_int16(frame + frame[1] + 2);
        }
        if (valid) {
            status.valid++;
            obey(frame + 2, frame[1]);
            count = 0;
        } else {
            status.invalid++;
            memmove(frame, frame + 1, --count);
        }
    }
}

static void take_bytes(void)
{
    while (received.in != received.out) {
        const uint8_t byte = received.byte[received.out];
        received.out = next(received.out);
        take_byte(byte);
    }
}

/* ---- Watchdog of the host, status ---- */

static void watch_host(void)
{
    if ((status.state & MOVED) && (uint16_t)(time_ms() - heard_at) >= HOST_TIMEOUT_MS)
        level_because(HOST_LOST);
}

static void begin_servo_frame(void)
{
    const float share = 1 - expf(-1e-6f * SERVO_FRAME_US / PLATE_LAG_S);
    uint8_t i;
    for (i = 0; i < 2; i++)
        plate_rad[i] += share * (angle_rad[i] - plate_rad[i]);
    status.step_us = 0;
#if BOARD_COMPUTES
    if (status.state & BY_BOARD) {
        const uint16_t begin = TCNT1;
        control_plate();
        status.step_us = (uint16_t)(TCNT1 - begin) / TICKS_PER_US;
    }
#endif
    status.time_ms = time_ms();
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        status.overruns = overruns;
        for (i = 0; i < 2; i++)
            status.pulse[i] = pulse_ticks[i];
    }
    for (i = 0; i < 2; i++) {
        status.angle[i] = in_units(angle_rad[i], UNIT_RAD);
        status.plate[i] = in_units(plate_rad[i], UNIT_RAD);
    }
    send_frame(&status, sizeof status);
}

int main(void)
{
    status.cause = reset_cause;
    level_because(RESTARTED);
    start_timers();
    start_line();
    wdt_enable(WDTO_120MS);
    sei();
    send_ready(0);
    for (;;) {
        wdt_reset();
        take_bytes();
        watch_host();
        if (servo_frame) {
            servo_frame = 0;
            begin_servo_frame();
        }
    }
}
