"""The power stage of an emulated drive: the state machine of CiA 402."""

from __future__ import annotations

from enum import IntEnum


class Power(IntEnum):
    """States; the values are the status word's bits 0 to 3, 5 and 6."""

    NOT_READY = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP = 0x07
    FAULT_REACTION = 0x0F
    FAULT = 0x08


STO_FAULT = 602
UNDERVOLTAGE_FAULT = 502
NO_VOLTAGE = 247
MASTER_SILENT = 129
"""Numbers of the faults that the inputs and a silent master bring; those of an AKD."""

_POWERED_STATES = {
    Power.SWITCHED_ON,
    Power.OPERATION_ENABLED,
    Power.QUICK_STOP,
    Power.FAULT_REACTION,
}
_RESET_CONTROL = 0x80


class PowerStage:
    """States of the power stage under control words, inputs and faults.

    A fault with a cause that is still present cannot be reset: open STO, missing DC link, and
    whatever is in ``causes``.
    """

    def __init__(self) -> None:
        self.state = Power.SWITCH_ON_DISABLED
        self.sto_closed = True
        self.dc_link = True
        self.faults: list[int] = []
        """Numbers of the present faults, oldest first."""
        self.causes: set[int] = set()
        """Faults with a cause that is still present, apart from STO and DC link."""
        self.refuse_reset = False
        self.option = 2
        """Quick stop option (605Ah): 2 ends in switch on disabled, 6 stays."""
        self._control = 0

    @property
    def live(self) -> bool:
        """Whether the motor has torque or would have it in a moment."""
        return self.state in _POWERED_STATES

    def control(self, word: int) -> list[int]:
        """Obey a control word, one transition at most; numbers of faults that come of it."""
        rising = word & _RESET_CONTROL and not self._control & _RESET_CONTROL
        self._control = word
        if self.state is Power.FAULT:
            if rising and not self.refuse_reset and not self.standing:
                self.faults.clear()
                self.state = Power.SWITCH_ON_DISABLED
            return []
        if self.state is Power.FAULT_REACTION:
            return []
        voltage, running = word & 0x02, word & 0x04
        if not voltage:
            self.state = Power.SWITCH_ON_DISABLED
        elif not running:
            if self.state is Power.OPERATION_ENABLED:
                self.state = Power.QUICK_STOP
            elif self.state is not Power.QUICK_STOP:
                self.state = Power.SWITCH_ON_DISABLED
        elif self.state is Power.QUICK_STOP:
            if word & 0x0F == 0x0F and self.option >= 5:
                self.state = Power.OPERATION_ENABLED
        else:
            return self._step(word & 0x0F)
        return []

    def _step(self, word: int) -> list[int]:
        if word & 0x07 == 0x06:
            self.state = Power.READY
        elif self.state is Power.READY:
            return self._switch_on()
        elif self.state in {Power.SWITCHED_ON, Power.OPERATION_ENABLED}:
            self.state = Power.OPERATION_ENABLED if word == 0x0F else Power.SWITCHED_ON
        return []

    def _switch_on(self) -> list[int]:
        if not self.sto_closed:
            return self.fail(STO_FAULT)
        if not self.dc_link:
            return self.fail(NO_VOLTAGE)
        self.state = Power.SWITCHED_ON
        return []

    def fault(self, place: int) -> int:
        """Number of the present fault at a place, 0 being the oldest's; 0 if there is none."""
        return self.faults[place] if place < len(self.faults) else 0

    @property
    def standing(self) -> set[int]:
        """Present faults with a cause that persists."""
        persisting = set(self.causes)
        if not self.sto_closed:
            persisting.add(STO_FAULT)
        if not self.dc_link:
            persisting |= {UNDERVOLTAGE_FAULT, NO_VOLTAGE}
        return persisting & set(self.faults)

    def fail(self, number: int, *, braked: bool = False) -> list[int]:
        """Go into fault; braked: with torque until standstill. The number, if it is new."""
        if number in self.faults:
            return []
        self.faults.append(number)
        if self.state is not Power.FAULT:
            self.state = Power.FAULT_REACTION if braked and self.live else Power.FAULT
        return [number]

    def inputs(self) -> list[int]:
        """Look at STO and DC link; numbers of faults that come of it."""
        if self.live and not self.sto_closed:
            return self.fail(STO_FAULT)
        if self.live and not self.dc_link:
            return self.fail(UNDERVOLTAGE_FAULT)
        return []

    def still(self) -> None:
        """The motor stands: a stop that was under way is done."""
        if self.state is Power.FAULT_REACTION:
            self.state = Power.FAULT
        elif self.state is Power.QUICK_STOP and self.option == 2:
            self.state = Power.SWITCH_ON_DISABLED
