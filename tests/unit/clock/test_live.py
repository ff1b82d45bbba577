"""What the live clock's module does to its process."""

import gc

from orchestrator.clock.live import begin_live


def test_what_was_loaded_is_not_looked_through_again() -> None:
    try:
        begin_live()
        assert gc.get_freeze_count() > 1000
        assert len(gc.get_objects()) < 1000
    finally:
        gc.unfreeze()
