"""Standard output that cannot be written: a full disk behind it, or a quota."""

import errno
import os
import sys
from typing import NoReturn

from orchestrator.cli.base.codes import FAILED

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def is_output_error(error: OSError) -> bool:
    """Whether an error is of standard output: that takes nothing now, not even a line end."""
    if error.errno not in _FULL or error.filename is not None:
        return False
    try:
        os.write(sys.stdout.fileno(), b"\n")
    except OSError as write_error:
        return write_error.errno in _FULL
    return False


def exit_output_failed(error: OSError) -> NoReturn:
    """Say so, and exit. Not as JSON: that would go the same way."""
    sys.stderr.write(f"tutti: standard output cannot be written: {error.strerror}\n")
    sys.stderr.write("       free space on its disk, or write it elsewhere; what was printed is not whole\n")
    sys.stderr.flush()
    os._exit(FAILED)  # the interpreter would try to write the rest
