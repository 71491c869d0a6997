"""What is real: drives on CAN, touch screen on a serial line, time."""
