"""Kollmorgen AKD servo drives on CANopen (CiA 402, profile velocity), two axes.

Bytes and states are in `protocol`: pure. `bringup` configures the drives over SDO,
`axis` judges every cycle and says what is sent next, `servos` is what a rig is given;
`conditions` is the table of what can go wrong. `traces` keeps what is said on a bus, `trace_files`
reads traces of other programs, `eds` data sheets, and `decoding` explains them. Servos on another
wire are of another kind (`twin.devices.kinds`).
"""

TRACE_FILE = "trace.log"
"""What was said on the CAN bus of a rig, in its run's folder; the only trace that has parts."""
