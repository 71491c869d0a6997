"""Kollmorgen AKD servo drives on CANopen (CiA 402, profile velocity), two axes.

Bytes are in `frames`, scaling in `scaling`, states in `cia402`: pure. `bringup` configures the
drives over SDO, `servos` runs them, `guard` watches them; `conditions` is the table of what can go
wrong. Servos on another wire implement `seam.PoweredServos` in one file of their own.
"""
