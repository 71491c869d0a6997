/* Everything that an importer may do with a drive on a simulated bus, for the compiler's sanitizers:
   frames and bytes of every kind, in any order. It prints how many operations the drive sent. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "drive.h"
#include "fmi3.h"
#include "variables.h"

enum { RX_DATA = VARIABLES, TX_DATA, RX_CLOCK, TX_CLOCK, ROUNDS = 20000 };

fmi3Instance fmi3InstantiateCoSimulation(fmi3String, fmi3String, fmi3String, fmi3Boolean,
                                         fmi3Boolean, fmi3Boolean, fmi3Boolean,
                                         const fmi3ValueReference[], size_t,
                                         fmi3InstanceEnvironment, fmi3LogMessageCallback,
                                         fmi3IntermediateUpdateCallback);
fmi3Status fmi3EnterInitializationMode(fmi3Instance, fmi3Boolean, fmi3Float64, fmi3Float64,
                                       fmi3Boolean, fmi3Float64);
fmi3Status fmi3ExitInitializationMode(fmi3Instance), fmi3EnterEventMode(fmi3Instance);
fmi3Status fmi3EnterStepMode(fmi3Instance), fmi3Reset(fmi3Instance), fmi3Terminate(fmi3Instance);
fmi3Status fmi3SetBoolean(fmi3Instance, const fmi3ValueReference[], size_t, const fmi3Boolean[],
                          size_t);
fmi3Status fmi3SetFloat64(fmi3Instance, const fmi3ValueReference[], size_t, const fmi3Float64[],
                          size_t);
fmi3Status fmi3SetInt32(fmi3Instance, const fmi3ValueReference[], size_t, const fmi3Int32[],
                        size_t);
fmi3Status fmi3SetClock(fmi3Instance, const fmi3ValueReference[], size_t, const fmi3Clock[]);
fmi3Status fmi3GetBinary(fmi3Instance, const fmi3ValueReference[], size_t, size_t[], fmi3Binary[],
                         size_t);
fmi3Status fmi3SetBinary(fmi3Instance, const fmi3ValueReference[], size_t, const size_t[],
                         const fmi3Binary[], size_t);
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance, fmi3Boolean *, fmi3Boolean *, fmi3Boolean *,
                                    fmi3Boolean *, fmi3Boolean *, fmi3Float64 *);
fmi3Status fmi3DoStep(fmi3Instance, fmi3Float64, fmi3Float64, fmi3Boolean, fmi3Boolean *,
                      fmi3Boolean *, fmi3Boolean *, fmi3Float64 *);
fmi3Status fmi3GetFMUState(fmi3Instance, fmi3FMUState *), fmi3SetFMUState(fmi3Instance, fmi3FMUState);
fmi3Status fmi3FreeFMUState(fmi3Instance, fmi3FMUState *);
void fmi3FreeInstance(fmi3Instance);

static uint64_t seed = 88172645463325252u;

/* A number below another one, of a shift register. */
static uint32_t draw(uint32_t below) {
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (uint32_t)(seed >> 32) % below;
}

static void check(int right, const char *what) {
    if (!right) {
        fprintf(stderr, "%s\n", what);
        exit(1);
    }
}

/* A frame that the drive takes for its own, with contents that lead somewhere. */
static void draw_frame(CanFrame *frame) {
    static const uint32_t IDS[] = {0x000, 0x080, 0x205, 0x305, 0x405, 0x505, 0x605, 0x605,
                                   0x605, 0x605, 0x701};
    frame->id = draw(20) ? IDS[draw(sizeof IDS / sizeof *IDS)] : draw(0x800);
    frame->extended = !draw(50);
    frame->remote = !draw(50);
    frame->length = draw(10) ? 8 : draw(9);
    for (size_t i = 0; i < 8; i++)
        frame->data[i] = (uint8_t)(draw(2) ? draw(256) : draw(16));
    if (frame->id == 0x605) {
        static const uint8_t COMMANDS[] = {0x40, 0x22, 0x23, 0x2B, 0x2F, 0x27};
        const ObjectKind *object = &OBJECT_KINDS[draw(OBJECTS)];
        frame->data[0] = COMMANDS[draw(sizeof COMMANDS)];
        write_number(frame->data + 1, object->index, 2);
        frame->data[3] = draw(10) ? object->sub : (uint8_t)draw(256);
        if (object->in_pdo && draw(2))
            frame->data[4] = (uint8_t)(8 * object->size);
    } else if (frame->id == 0) {
        frame->length = 2;
        frame->data[0] = (uint8_t[]){1, 1, 1, 2, 128, 129}[draw(6)];
        frame->data[1] = (uint8_t)(draw(2) ? 0 : 5);
    }
}

static void draw_operations(Operations *rx) {
    rx->size = 0;
    rx->lost = 0;
    for (uint32_t i = draw(12); i; i--) {
        CanFrame frame;
        draw_frame(&frame);
        write_frame(rx, &frame);
    }
    if (!draw(4))
        for (uint32_t i = draw(40); i; i--)
            rx->bytes[rx->size++] = (uint8_t)(draw(3) ? draw(0x43) : 0);
    if (rx->size && !draw(8))
        rx->bytes[draw((uint32_t)rx->size)] = (uint8_t)draw(256);
}

int main(void) {
    fmi3Instance drive = fmi3InstantiateCoSimulation("drive", TOKEN, NULL, false, false, true, false,
                                                     NULL, 0, NULL, NULL, NULL);
    const fmi3ValueReference node[] = {NODE}, torque[] = {LOAD_TORQUE};
    const fmi3ValueReference sto[] = {STO_CLOSED}, link[] = {DC_LINK}, rx_clock[] = {RX_CLOCK};
    const fmi3ValueReference rx_data[] = {RX_DATA}, tx_data[] = {TX_DATA};
    fmi3FMUState saved = NULL;
    long sent = 0;
    double time = 0.0;
    check(drive != NULL, "no instance");
    for (int round = 0; round < 2; round++) {
        check(fmi3SetInt32(drive, node, 1, (fmi3Int32[]){5}, 1) == fmi3OK, "node");
        check(!fmi3EnterInitializationMode(drive, false, 0.0, 0.0, false, 0.0), "initialization");
        check(fmi3ExitInitializationMode(drive) == fmi3OK, "end of initialization");
        time = 0.0;
        for (int i = 0; i < ROUNDS; i++) {
            static Operations rx;
            fmi3Boolean flags[5];
            fmi3Float64 last;
            fmi3Binary data[1];
            size_t size[1], length;
            CanFrame frame;
            check(fmi3GetBinary(drive, tx_data, 1, size, data, 1) == fmi3OK, "Tx_Data");
            for (size_t at = 0; at < size[0]; at += length, sent++)
                check(read_operation(data[0] + at, size[0] - at, &length, &frame) != MALFORMED,
                      "a malformed operation was sent");
            draw_operations(&rx);
            check(fmi3SetClock(drive, rx_clock, 1, (fmi3Clock[]){rx.size > 0}) == fmi3OK, "clock");
            const fmi3Binary bytes[] = {rx.bytes};
            check(fmi3SetBinary(drive, rx_data, 1, &rx.size, bytes, 1) == fmi3OK, "Rx_Data");
            fmi3SetBoolean(drive, sto, 1, (fmi3Boolean[]){draw(100) > 1}, 1);
            fmi3SetBoolean(drive, link, 1, (fmi3Boolean[]){draw(100) > 1}, 1);
            fmi3SetFloat64(drive, torque, 1, (fmi3Float64[]){draw(3) - 1.0}, 1);
            check(!fmi3UpdateDiscreteStates(drive, flags, flags + 1, flags + 2, flags + 3, flags + 4,
                                            &last),
                  "update");
            check(fmi3EnterStepMode(drive) == fmi3OK, "step mode");
            double step = (1 + draw(30)) * 1e-4;
            check(fmi3DoStep(drive, time, step, false, flags, flags + 1, flags + 2, &last) <=
                      fmi3Warning,
                  "step");
            time += step;
            if (!draw(500))
                check(fmi3GetFMUState(drive, &saved) == fmi3OK, "a saved state");
            else if (saved && !draw(500))
                check(fmi3SetFMUState(drive, saved) == fmi3OK, "a restored state");
            check(fmi3EnterEventMode(drive) == fmi3OK, "event mode");
        }
        check(fmi3Terminate(drive) == fmi3OK && fmi3Reset(drive) == fmi3OK, "reset");
    }
    fmi3FreeFMUState(drive, &saved);
    fmi3FreeInstance(drive);
    printf("%ld\n", sent);
    return 0;
}
