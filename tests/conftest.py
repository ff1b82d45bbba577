"""What holds for all tests."""

from processes import give_children_default_signals

give_children_default_signals()
