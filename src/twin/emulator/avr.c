/* An ATmega328P that executes a firmware in simavr, in lockstep with the program that asks.
 *
 *   avr FIRMWARE.elf CLOCK_HZ PORT
 *
 * PORT is the number of an open file, the master of a pseudo-terminal: the serial line at 115,200
 * baud. CLOCK_HZ is the true frequency of the chip's clock. A line on standard input is a command,
 * its answer a line on standard output:
 *
 *   run MICROSECONDS BYTES   take so many bytes from the port, then let the time pass;
 *                            answers the number of bytes put on the port, then AXIS:WIDTH of each
 *                            servo pulse that has ended, width in us
 *   reset CAUSE              reset the chip; the cause is a value of MCUSR
 *   hang                     the processor executes an endless loop with interrupts off
 *   clock HZ                 change the frequency of the clock from now on
 *   lose SHARE               of the bytes on the line in both directions, from now on
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <avr_ioport.h>
#include <avr_timer.h>
#include <avr_uart.h>
#include <sim_avr.h>
#include <sim_elf.h>

/* The functions of the type of `uart->input`. */
DEFINE_FIFO(uint16_t, uart_fifo);

#define BAUD 115200.0
#define BITS_PER_BYTE 10
/* The last of ten bits is sampled in its middle, which is known to an eighth of a bit. */
#define MAX_BAUD_ERROR ((0.5 - 0.125) / 9.5)
/* The chip has two bytes of buffer behind its shift register; simavr has 64 bytes. */
#define CHIP_BUFFER_BYTES 3
#define MAX_LINE_BYTES 65536
#define ENDLESS_LOOP 0xCFFF /* rjmp to itself */

static avr_t *avr;
static avr_uart_t *uart;
static avr_irq_t *line_in;
static double clock_hz;
static int port;
static uint64_t base;   /* cycles before the last reset, at which simavr's count begins anew */
static uint64_t counted; /* simavr's count when it was looked at last */
static uint64_t owed_end; /* up to where the chip is to run, cycles since the start */
static uint8_t from_host[MAX_LINE_BYTES];
static size_t in_count, in_taken;
static double byte_ends; /* when the byte that is on the line from the host has arrived, cycles */
static unsigned long sent;
static double lose;
static uint64_t chance = 88172645463325252ULL;
static uint64_t rises[2];
static char pulses[4096];

static void fail(const char *why, const char *what)
{
    fprintf(stderr, "%s: %s\n", why, what);
    exit(1);
}

/* Cycles of the chip since the start; a reset is noticed by a count that goes back. */
static uint64_t cycles(void)
{
    if (avr->cycle < counted)
        base += counted;
    counted = avr->cycle;
    return base + counted;
}

static int is_lost(void)
{
    chance ^= chance << 13;
    chance ^= chance >> 7;
    chance ^= chance << 17;
    return (double)(chance >> 11) / 9007199254740992.0 < lose;
}

/* Whether both ends of the line sample the right bits, by the divider that the firmware has set.
 * simavr counts 11 bits for a byte of 8N1; it has 10. */
static int is_in_step(void)
{
    const unsigned divider = (avr->data[uart->r_ucsra] & 2 ? 8U : 16U)
                             * (1U + avr->data[uart->ubrrl.reg] + 256U * avr->data[uart->ubrrh.reg]);
    uart->cycles_per_byte = BITS_PER_BYTE * divider;
    return fabs(clock_hz / divider / BAUD - 1) < MAX_BAUD_ERROR;
}

static void on_sent(struct avr_irq_t *irq, uint32_t value, void *param)
{
    const uint8_t byte = (uint8_t)value;
    (void)irq;
    (void)param;
    if (is_lost() || !is_in_step())
        return;
    if (write(port, &byte, 1) != 1)
        fail("port", "a byte cannot be written");
    sent++;
}

static void on_pin(struct avr_irq_t *irq, uint32_t value, void *param)
{
    const int axis = *(const int *)param;
    const uint64_t now = cycles();
    const size_t used = strlen(pulses);
    (void)irq;
    if (value)
        rises[axis] = now;
    else if (rises[axis])
        snprintf(pulses + used, sizeof pulses - used, " %d:%.3f", axis,
                 1e6 * (double)(now - rises[axis]) / clock_hz);
}

/* Hand the chip the bytes of the host that have arrived by now. */
static void receive(uint64_t now)
{
    while (in_taken < in_count && (double)now >= byte_ends) {
        const uint8_t byte = from_host[in_taken++];
        if (!is_lost() && is_in_step() && uart_fifo_get_read_size(&uart->input) < CHIP_BUFFER_BYTES)
            avr_raise_irq(line_in, byte);
        byte_ends += BITS_PER_BYTE * clock_hz / BAUD;
    }
    if (in_taken == in_count)
        in_taken = in_count = 0;
}

static void run(double microseconds, size_t bytes)
{
    static double due;
    size_t more;
    if (in_count + bytes > MAX_LINE_BYTES)
        fail("port", "too many bytes wait");
    if (bytes && in_taken == in_count)
        byte_ends = (double)cycles() + BITS_PER_BYTE * clock_hz / BAUD;
    while (bytes) {
        const ssize_t got = read(port, from_host + in_count, bytes);
        if (got <= 0)
            fail("port", "closed");
        more = (size_t)got;
        in_count += more;
        bytes -= more;
    }
    due += 1e-6 * microseconds * clock_hz;
    owed_end = (uint64_t)due;
    sent = 0;
    pulses[0] = 0;
    for (;;) {
        const uint64_t now = cycles();
        int state;
        if (now >= owed_end)
            break;
        receive(now);
        state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed)
            fail("the processor", state == cpu_Done ? "has ended" : "has crashed");
    }
    printf("%lu%s\n", sent, pulses);
}

static void reset(unsigned cause)
{
    cycles();
    avr_reset(avr);
    cycles();
    avr->data[avr->reset_flags.porf.reg] = (uint8_t)cause;
    puts("0");
}

/* Lead the processor to the endless loop in which every program of avr-libc would end. */
static void hang(void)
{
    avr_flashaddr_t at;
    for (at = 0; at < avr->codeend; at += 2)
        if ((avr->flash[at] | avr->flash[at + 1] << 8) == ENDLESS_LOOP)
            break;
    if (at >= avr->codeend)
        fail("hang", "the firmware has no endless loop");
    avr->pc = at;
    avr->sreg[S_I] = 0;
    puts("0");
}

static void quiet(avr_t *chip, const int level, const char *format, va_list arguments)
{
    (void)chip;
    if (level <= LOG_ERROR)
        vfprintf(stderr, format, arguments);
}

int main(int count, char *given[])
{
    static const int axes[2] = {0, 1};
    /* simavr takes mode 14 for phase-correct PWM, and keeps the first width of a pulse for ever. */
    static const avr_timer_wgm_t fast_pwm = AVR_TIMER_WGM_ICFASTPWM();
    elf_firmware_t firmware = {0};
    avr_io_t *io;
    uint32_t flags = 0;
    char line[256], word[16];
    int axis;
    if (count != 4)
        fail("arguments", "FIRMWARE.elf CLOCK_HZ PORT");
    avr_global_logger_set(quiet);
    if (elf_read_firmware(given[1], &firmware))
        fail(given[1], "no firmware");
    clock_hz = atof(given[2]);
    port = atoi(given[3]);
    avr = avr_make_mcu_by_name("atmega328p");
    if (!avr)
        fail("simavr", "has no atmega328p");
    avr_init(avr);
    firmware.frequency = 16000000;
    avr_load_firmware(avr, &firmware);
    for (io = avr->io_port; io; io = io->next) {
        if (!strcmp(io->kind, "uart"))
            uart = (avr_uart_t *)io;
        if (!strcmp(io->kind, "timer") && ((avr_timer_t *)io)->name == '1')
            ((avr_timer_t *)io)->wgm_op[14] = fast_pwm;
    }
    line_in = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    if (!uart || !line_in)
        fail("simavr", "has no serial line");
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags); /* no text on the console, no sleep */
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT),
                            on_sent, NULL);
    for (axis = 0; axis < 2; axis++)
        avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), 1 + axis), on_pin,
                                (void *)&axes[axis]);
    setvbuf(stdout, NULL, _IOLBF, 0);
    while (fgets(line, sizeof line, stdin)) {
        double number = 0;
        unsigned long bytes = 0;
        if (sscanf(line, "%15s %lf %lu", word, &number, &bytes) < 1)
            continue;
        if (!strcmp(word, "run"))
            run(number, bytes);
        else if (!strcmp(word, "reset"))
            reset((unsigned)number);
        else if (!strcmp(word, "hang"))
            hang();
        else if (!strcmp(word, "lose")) {
            lose = number;
            puts("0");
        } else if (!strcmp(word, "clock")) {
            clock_hz = number;
            puts("0");
        } else
            fail("no such command", word);
    }
    return 0;
}
