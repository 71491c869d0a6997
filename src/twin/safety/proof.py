"""What the document says of the lines of defence, and of what is and is not proven."""

from __future__ import annotations

DEFENCES = """\
## Lines of defence

1. **Host's levelling**: the plate is brought level and held; the drives keep their torque.
2. **Host's quick stop**: zero rate and quick stop in one frame, then no torque.
3. **Drive's heartbeat watch**: a drive that misses the host's heartbeat brakes and goes into fault
   F129. The host withholds its heartbeat where a quick stop is not obeyed within 300 ms.
4. **Safe torque off**: the input of the emergency stop; the motors run out without torque.

The matrix says for each row who stopped each axis: whoever took its drive out of operation, or the
levelling if the plate was level while the drive still had torque. Its last rows leave one line
alone, with those before it taken away on the bus, or run with other settings than the defaults.
The project's tests then take one line after the other away from the program, or put it wrong (an
area limit exchanged, a bound on one axis only, a limit not written), and repeat every row that
relies on it: each must turn bad.
"""
PROVEN = """\
## What is proven without a real drive

The host's program is the one that drives a real rig, byte by byte on the bus and on the touch port,
in virtual time; drives, screen, plate and ball are emulated. Proven is, for these faults:

- that the host detects each within the stated time, names it, and answers with the stated stop;
- that this stop brings a drive that behaves as the emulated one to rest, and without torque, within
  the stated times, tilt and way of the ball;
- that the drives are left with the heartbeat watch in force, so that each line of defence works
  alone as far as the drives do what CiA 402 and the vendor's documents say;
- that the record is whole and that nothing starts again by itself;
- that the rows would show it if a line of defence were missing (`tests/safety`).
"""
NOT_PROVEN = """\
## What is not proven without a real drive

- **That the drive brakes and trips F129** when the heartbeat ends. The documents name F129 for node
  guarding; for the heartbeat it is assumed. `ballplate doctor --move` lets the heartbeat end at
  standstill and measures; braking from motion it does not show.
- **What the drive does in quick stop**: with option 2 of 605Ah it ought to end without torque; one
  passage of the manual says that the power stage stays on.
- **How fast it brakes**: the emulated quick stop ramp of 1000 rad/s^2 is an assumption, as are the
  units of ramps and velocity limits; standstill and tilt scale with them.
- **How a plate without torque moves**: the emulated motor runs out with 0.2 s to 1/e and the plate
  then stays. A real plate that is out of balance, or with a ball at its edge, may fall to a side;
  after a quick stop or STO nothing holds it.
- **Where the ball goes after a stop**: the plate is left tilted and the ball rolls on (*then*).
- **STO's own circuit**, its wiring, and the drive's hardware: STO is a function of the drive and
  its certificate, not of this program. That it works without the host is shown for the emulator.
- **Bus load, electrical faults, other masters' timing**: the emulated bus has no arbitration and no
  transmission times. Real time is another matter: see `benchmarks/realtime.py`.
- **Faults of two kinds at once**, except those of the last rows, and faults nobody thought of.

The plate of the matrix is turned by its motors directly (ratio 1); with the rig's cams of ratio 5 a
motor that runs away turns the plate a fifth as fast.
"""
