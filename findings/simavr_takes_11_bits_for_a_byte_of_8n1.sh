#!/usr/bin/env bash
# simavr 1.6 (Debian 12), ATmega328P, its USART at 115,200 baud: double speed, UBRR0 = 16, 8N1.
# Guess: a byte takes 10 bits of 136 cycles, 1360 cycles; the order of the registers does not matter.
# Seen: it takes 11 bits, 1496 cycles. If U2X0 is set after UBRR0, the rate is half of that: it is
#   calculated when UBRR0 is written. Bytes sent to the chip at the true rate pile up in simavr's
#   buffer of 64 bytes; the chip has 2, so firmware that is too slow to read loses nothing here.
# Do: set U2X0 first; correct cycles_per_byte of the avr_uart_t, and limit what waits in its input.
set -euo pipefail
for program in avr-gcc cc; do
    command -v $program >/dev/null || { echo "needs $program"; exit 1; }
done
[ -d /usr/include/simavr ] || { echo "needs libsimavr-dev"; exit 1; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat >send.c <<'C'
#include <avr/io.h>
int main(void)
{
#ifdef SPEED_LAST
    UBRR0 = 16;
    UCSR0A = 1 << U2X0;
#else
    UCSR0A = 1 << U2X0;
    UBRR0 = 16;
#endif
    UCSR0C = 1 << UCSZ01 | 1 << UCSZ00;
    UCSR0B = 1 << TXEN0;
    for (;;) {
        while (!(UCSR0A & 1 << UDRE0))
            ;
        UDR0 = 'x';
    }
}
C
cat >bytes.c <<'C'
#include <avr_uart.h>
#include <sim_avr.h>
#include <sim_elf.h>
#include <stdio.h>
static void on_byte(struct avr_irq_t *irq, uint32_t value, void *count)
{
    (void)irq;
    (void)value;
    ++*(unsigned *)count;
}
int main(int count, char *given[])
{
    elf_firmware_t firmware = {0};
    unsigned bytes = 0;
    uint32_t flags = 0;
    avr_t *avr = avr_make_mcu_by_name("atmega328p");
    (void)count;
    elf_read_firmware(given[1], &firmware);
    avr_init(avr);
    firmware.frequency = 16000000;
    avr_load_firmware(avr, &firmware);
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT),
                            on_byte, &bytes);
    while (avr->cycle < 16000000)
        avr_run(avr);
    printf("%.0f\n", 16e6 / bytes);
    return 0;
}
C
avr-gcc -mmcu=atmega328p -Os send.c -o first.elf
avr-gcc -mmcu=atmega328p -Os -DSPEED_LAST send.c -o last.elf
cc -I/usr/include/simavr bytes.c -o bytes -lsimavr
dpkg-query -W libsimavr-dev
first=$(./bytes first.elf | tail -1)
last=$(./bytes last.elf | tail -1)
echo "cycles for a byte, U2X0 set first: $first; set last: $last; on the chip 1360"
[ "$first" -gt 1450 ] && [ "$first" -lt 1560 ]
[ "$last" -gt 2900 ] && [ "$last" -lt 3100 ]
