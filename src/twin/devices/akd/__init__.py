"""Kollmorgen AKD servo drives on CANopen (CiA 402, profile velocity), two axes.

`protocol` has the bytes and states, as pure functions. `bringup` configures the drives over SDO,
`axis` checks every cycle and chooses the next control word, `servos` is the device of a rig, and
`conditions` is the table of its faults. `traces` keeps the frames of a bus, `trace_files` reads
traces of other programs, `eds` reads data sheets, and `decoding` explains frames in words. Other
servos are other kinds of device (`twin.devices.kinds`).
"""

TRACE_FILE = "trace.log"
"""Frames on the CAN bus of a rig, in the folder of its run; the only trace that has parts."""
