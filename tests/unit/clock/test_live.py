"""The effects of the live clock's module on its process."""

import gc

from orchestrator.clock.live import prepare_live_process


def test_loaded_objects_are_not_scanned_again() -> None:
    try:
        prepare_live_process()
        assert gc.get_freeze_count() > 1000
        assert len(gc.get_objects()) < 1000
    finally:
        gc.unfreeze()
