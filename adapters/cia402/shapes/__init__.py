"""The motions that a drive can execute: trapezoids of its own, streams of positions, and outputs switched in them."""
