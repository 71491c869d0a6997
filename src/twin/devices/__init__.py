"""Real devices: drives on CAN, touch screen on a serial line, real-time clock."""
