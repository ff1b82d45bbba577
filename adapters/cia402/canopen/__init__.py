"""A drive as a node of its CAN bus: frames, SDOs, objects, states, and the words for its errors."""
