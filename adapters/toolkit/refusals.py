"""The log lines of refused and failed requests."""

from collections.abc import Generator
from contextlib import contextmanager

from adapters.contract import DriverLog
from orchestrator.model.errors import ControllerFault, Refusal


@contextmanager
def log_refusals(log: DriverLog, action: str) -> Generator[None, None, None]:
    """Log a `Refusal` or a `ControllerFault` of the block, and raise it again. action: what was requested."""
    try:
        yield
    except Refusal as error:
        log.info(f"{action} was refused: {error.text}", code=error.code)
        raise
    except ControllerFault as error:
        log.warning(f"{action} failed: {error.text}", code=error.code)
        raise
