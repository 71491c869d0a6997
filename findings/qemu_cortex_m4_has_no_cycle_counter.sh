#!/usr/bin/env bash
# QEMU 7.2 (Debian 12), machine mps2-an386, a Cortex-M4F.
# Guess: with -icount, where time follows from instructions, DWT->CYCCNT counts them, as on the chip;
#   or else SysTick does, best with shift=0, 1 ns an instruction.
# Seen: CYCCNT can be switched on, reads 0 and stays 0. SysTick counts at 25 MHz of the machine's
#   time: with shift=0 its difference over 100 instructions is 2 or 3 ticks of 40 ns, and over 10 it
#   is 0 or 1. With shift=7 an instruction is 3.2 ticks, and the count gives it exactly.
# Do: measure with SysTick and -icount shift=7: instructions are ticks * 40 / 128, rounded. They are
#   no cycles.
set -euo pipefail
for program in arm-none-eabi-gcc qemu-system-arm; do
    command -v $program >/dev/null || { echo "needs $program"; exit 1; }
done
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat >count.c <<'C'
#define REGISTER(address) (*(volatile unsigned *)(address))
#define SYSTICK REGISTER(0xE000E018)
#define CYCCNT REGISTER(0xE0001004)
#define NOPS10 "nop\n nop\n nop\n nop\n nop\n nop\n nop\n nop\n nop\n nop\n"
#define NOPS100 NOPS10 NOPS10 NOPS10 NOPS10 NOPS10 NOPS10 NOPS10 NOPS10 NOPS10 NOPS10
#define LOOK_TWICE(between) \
    __asm__ volatile("ldr %0, [%2]\n" between "ldr %1, [%2]" \
                     : "=&r"(before), "=r"(after) : "r"(&SYSTICK))
void reset(void);
__attribute__((section(".vectors"), used)) static const void *const vectors[] = {
    (void *)0x20010000, (void *)reset};
static unsigned host(unsigned operation, const void *argument)
{
    register unsigned r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}
static void say(unsigned number)
{
    char text[12], *at = text + 11;
    *at = 0;
    do
        *--at = (char)('0' + number % 10);
    while (number /= 10);
    host(4, at);
    host(4, " ");
}
void reset(void)
{
    unsigned before, after, cycles;
    REGISTER(0xE000E014) = 0xFFFFFF; /* SysTick: 24 bits, the processor's clock */
    SYSTICK = 0;
    REGISTER(0xE000E010) = 5;
    REGISTER(0xE000EDFC) |= 1u << 24; /* trace on, then its counter of cycles */
    REGISTER(0xE0001000) |= 1;
    cycles = CYCCNT;
    LOOK_TWICE(NOPS10);
    say(before - after);
    LOOK_TWICE(NOPS100);
    say(before - after);
    say(CYCCNT - cycles);
    say(CYCCNT);
    host(0x18, (void *)0x20026);
}
C
arm-none-eabi-gcc -O2 -mcpu=cortex-m4 -mthumb -nostdlib -Wl,-Ttext=0 -Wl,--section-start=.vectors=0 \
    -Wl,-Ttext=0x100 -Wl,-ereset count.c -o count.elf
qemu-system-arm --version | head -1
arm-none-eabi-gcc --version | head -1
counted() {
    timeout 20 qemu-system-arm -machine mps2-an386 -icount shift="$1" -display none -monitor none \
        -serial none -semihosting-config enable=on,target=native -kernel count.elf 2>&1
}
for shift in 0 7; do
    read -r ten hundred cycles counter <<<"$(counted $shift)"
    echo "shift=$shift: 10 nops $ten ticks, 100 nops $hundred ticks, CYCCNT counted $cycles and is $counter"
    [ "$cycles" = 0 ] && [ "$counter" = 0 ]
    if [ $shift = 0 ]; then
        [ "$ten" -le 1 ] && [ "$hundred" -ge 2 ] && [ "$hundred" -le 3 ]
    else # the second look is an instruction, too
        [ $(((ten * 40 + 64) / 128)) = 11 ] && [ $(((hundred * 40 + 64) / 128)) = 101 ]
    fi
done
