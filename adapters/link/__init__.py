"""Links to real hardware: TCP sockets and serial ports."""
