#!/usr/bin/env bash
# simavr 1.6 (Debian 12), ATmega328P, timer 1 in mode 14: fast PWM up to ICR1, as servos are driven.
# Guess: a pulse at pin OC1A is as wide as OCR1A says, from the next period on when that is changed.
# Seen: every pulse is as wide as OCR1A was when the timer was started. The table of the chip has
#   mode 14 as phase-correct PWM, in which a change of OCR1A is not led to the pins.
# Do: before the chip runs, set wgm_op[14] of its timer 1 to AVR_TIMER_WGM_ICFASTPWM(), as below.
set -euo pipefail
for program in avr-gcc cc; do
    command -v $program >/dev/null || { echo "needs $program"; exit 1; }
done
[ -d /usr/include/simavr ] || { echo "needs libsimavr-dev"; exit 1; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat >servo.c <<'C'
#include <avr/interrupt.h>
#include <avr/io.h>
static volatile uint16_t compare = 2999;
ISR(TIMER1_OVF_vect)
{
    compare += 200;
    OCR1A = compare;
}
int main(void)
{
    DDRB = 1 << DDB1;
    ICR1 = 39999; /* 20 ms at 16 MHz / 8 */
    OCR1A = compare;
    TCCR1A = 1 << COM1A1 | 1 << WGM11;
    TCCR1B = 1 << WGM13 | 1 << WGM12 | 1 << CS11;
    TIMSK1 = 1 << TOIE1;
    sei();
    for (;;)
        ;
}
C
cat >pulses.c <<'C'
#include <avr_ioport.h>
#include <avr_timer.h>
#include <sim_avr.h>
#include <sim_elf.h>
#include <stdio.h>
#include <string.h>
static avr_t *avr;
static void on_pin(struct avr_irq_t *irq, uint32_t value, void *rise)
{
    (void)irq;
    if (value)
        *(avr_cycle_count_t *)rise = avr->cycle;
    else if (*(avr_cycle_count_t *)rise)
        printf("%.0f ", (double)(avr->cycle - *(avr_cycle_count_t *)rise) / 16);
}
int main(int count, char *given[])
{
    static const avr_timer_wgm_t fast_pwm = AVR_TIMER_WGM_ICFASTPWM();
    static avr_cycle_count_t rise;
    elf_firmware_t firmware = {0};
    avr_io_t *io;
    (void)count;
    elf_read_firmware("servo.elf", &firmware);
    avr = avr_make_mcu_by_name("atmega328p");
    avr_init(avr);
    firmware.frequency = 16000000;
    avr_load_firmware(avr, &firmware);
    for (io = avr->io_port; io; io = io->next)
        if (!strcmp(given[1], "corrected") && !strcmp(io->kind, "timer")
            && ((avr_timer_t *)io)->name == '1')
            ((avr_timer_t *)io)->wgm_op[14] = fast_pwm;
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), 1), on_pin, &rise);
    while (avr->cycle < 5 * 320000)
        avr_run(avr);
    return 0;
}
C
avr-gcc -mmcu=atmega328p -Os servo.c -o servo.elf
cc -I/usr/include/simavr pulses.c -o pulses -lsimavr
dpkg-query -W libsimavr-dev
as_it_is=$(./pulses as-it-is | tail -1)
corrected=$(./pulses corrected | tail -1)
echo "widths in us, OCR1A 100 us more each time: $as_it_is"
echo "with the table corrected:                  $corrected"
[ "$as_it_is" = "1500 1500 1500 1500 1500 " ]
[ "$corrected" = "1500 1600 1700 1800 1900 " ]
