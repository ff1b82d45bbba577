"""What runs each kind of step that is no motion, one module each; see `kinds.py`."""
