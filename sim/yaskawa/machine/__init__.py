"""The machine itself: state, time, interpreter, events, non-volatile memory, data recorder."""
