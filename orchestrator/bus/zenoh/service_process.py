"""The end of a service's process: what kept it from its work, on stderr in words, and as an exit code."""

import asyncio
import sys
from collections.abc import Coroutine, Mapping
from pathlib import Path
from typing import Any

from orchestrator.bus.identity import BadIdentity
from orchestrator.bus.zenoh.sessions import RouterUnreachable
from orchestrator.model.files.private_files import UnsafePath

BAD_INPUT, NO_BUS = 2, 3


def run_service(service: Coroutine[Any, Any, int], place: Path, codes: Mapping[type[Exception], int]) -> int:
    """Run a service until it ends; return its exit code.

    place: what the service writes, for errors of the operating system that name no file. codes: of the errors that only
    this service has; those are written to stderr without a traceback.
    """
    exit_codes: dict[type[Exception], int] = {
        UnsafePath: BAD_INPUT,
        BadIdentity: BAD_INPUT,
        RouterUnreachable: NO_BUS,
        **codes,
    }
    kinds = tuple(exit_codes)
    try:
        return asyncio.run(service)
    except kinds as error:
        sys.stderr.write(f"{error}\n")
        return next(code for kind, code in exit_codes.items() if isinstance(error, kind))
    except OSError as error:
        path = error.filename or place
        sys.stderr.write(f"{path}: {error.strerror}; free space there, or choose another place\n")
        return BAD_INPUT
