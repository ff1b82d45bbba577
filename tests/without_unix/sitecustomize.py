"""Makes a Python process on Linux look to Tutti's own packages like one on Windows or macOS.

Python imports this module when it starts, if this folder is on `PYTHONPATH`; so it holds for children too. The variable
TUTTI_TEST_SYSTEM says which system: `win32` or `darwin`. Only what the code of this project sees is changed; Python's own
library and others go on as they do on Linux, because their branches for another system cannot run here.

- Modules and names that the other system lacks are missing (`windows_lacks.txt`, `macos_lacks.txt`); `sys.platform` is the
  other system's.
- There is no /proc, /sys or /dev.

On Windows also, as its documentation has it:

- Event loops have no signal handlers and no readers of descriptors, and do not read standard input.
- A child gets no file descriptors, and is ended at once instead of by SIGTERM.
- A file that is open is not renamed, replaced or removed, and folders are not opened.
- A file is opened as text where `O_BINARY` does not say otherwise: that is refused here.
- `msvcrt` has locks of bytes, and gives the keys of a console: the bytes of standard input.
"""

import asyncio
import builtins
import errno
import fcntl
import importlib
import os
import signal
import struct
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from select import select
from types import FrameType, ModuleType
from typing import Any

SYSTEM = os.environ.get("TUTTI_TEST_SYSTEM", "")
OURS = ("orchestrator", "adapters", "sim", "tutti", "integrations")
LISTS = {"win32": "windows_lacks.txt", "darwin": "macos_lacks.txt"}
MISSING_FOLDERS = ("/proc/", "/sys/", "/dev/")
NEW_PROCESS_GROUP = 0x200
LK_LOCK, LK_NBLCK = 1, 2
O_BINARY = 0x8000
"""The value on Windows. On Linux it is O_LARGEFILE, which changes nothing with 64 bits."""


def is_ours(frame: FrameType | None) -> bool:
    """Whether code of this project runs in a frame."""
    name = "" if frame is None else str(frame.f_globals.get("__name__", ""))
    return name.partition(".")[0] in OURS


def read_list(name: str) -> dict[str, set[str]]:
    """What is missing: names by module, none for a module that is missing as a whole."""
    missing: dict[str, set[str]] = {}
    for line in Path(__file__).with_name(name).read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            module, *names = line.split()
            missing.setdefault(module, set()).update(names)
    return missing


class View(ModuleType):
    """A module as the other system has it."""

    def __init__(self, module: ModuleType, missing: set[str], own: dict[str, Any]) -> None:
        super().__init__(module.__name__, module.__doc__)
        self.__dict__["_parts"] = module, missing
        self.__dict__.update(own)

    def __getattr__(self, name: str) -> Any:
        module, missing = self.__dict__["_parts"]
        if name in missing:
            raise AttributeError(f"module {module.__name__!r} has no attribute {name!r}")
        return getattr(module, name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(self.__dict__["_parts"][0], name, value)


def show_views(missing: dict[str, set[str]], own: dict[str, dict[str, Any]], added: dict[str, ModuleType]) -> None:
    """Let imports of our modules find the views. own: names that modules have in another form, or only there; added: modules
    that are only there."""
    names = {name for name, lacked in missing.items() if lacked} | own.keys()
    views = {name: View(importlib.import_module(name), missing.get(name, set()), own.get(name, {})) for name in names}
    views |= added
    whole = {name for name, lacked in missing.items() if not lacked}
    import_name, import_module = builtins.__import__, importlib.import_module

    def find_view(name: str) -> ModuleType | None:
        if name.partition(".")[0] in whole:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return views.get(name)

    def import_here(name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0) -> Any:
        package = str((globals or {}).get("__name__", "")).partition(".")[0]
        is_main = package == "__main__" and str((globals or {}).get("__package__") or "").partition(".")[0] in OURS
        if level == 0 and (package in OURS or is_main):
            view = find_view(name)
            if view is not None:
                return view
        return import_name(name, globals, locals, fromlist, level)

    def import_module_here(name: str, package: str | None = None) -> ModuleType:
        view = find_view(name) if is_ours(sys._getframe(1)) else None
        return view or import_module(name, package)

    builtins.__import__ = import_here
    importlib.import_module = import_module_here


def hide_folders() -> None:
    """There is no /proc, /sys or /dev for our code, which may open them by Python's library."""

    def check_event(event: str, values: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(values[0], str) and values[0].startswith(MISSING_FOLDERS):
            frame = sys._getframe(1)
            while frame is not None and frame.f_globals.get("__name__") in ("pathlib", "pathlib._local", "io", "os"):
                frame = frame.f_back
            if is_ours(frame):
                raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), values[0])

    sys.addaudithook(check_event)


def refuse_by_loops() -> None:
    """Event loops of Windows: no signals, no readers of descriptors."""

    def refuse(*_: Any) -> Any:
        raise NotImplementedError

    loops = [
        asyncio.AbstractEventLoop,
        asyncio.BaseEventLoop,
        asyncio.SelectorEventLoop,
        *asyncio.SelectorEventLoop.__mro__[1:],
    ]
    for kind in loops:
        for name in (
            "add_signal_handler",
            "remove_signal_handler",
            "add_reader",
            "remove_reader",
            "add_writer",
            "remove_writer",
        ):
            if name in vars(kind):
                setattr(kind, name, refuse)
    connect = asyncio.SelectorEventLoop.connect_read_pipe

    async def connect_read_pipe(loop: Any, protocol: Any, pipe: Any) -> Any:
        if pipe in (sys.stdin, sys.__stdin__):
            raise OSError(errno.EINVAL, "standard input is not opened for overlapped input")
        return await connect(loop, protocol, pipe)

    asyncio.BaseEventLoop.connect_read_pipe = connect_read_pipe  # type: ignore[method-assign]


def end_children_at_once() -> None:
    """Children of Windows: SIGTERM is TerminateProcess, no other signal is sent."""
    start, send = subprocess.Popen.__init__, subprocess.Popen.send_signal

    def start_here(process: Any, *values: Any, **options: Any) -> None:
        if options.get("pass_fds") or options.get("preexec_fn"):
            raise ValueError("pass_fds and preexec_fn are not supported on Windows platforms")
        # A new group gets no Ctrl-C; a session of its own is no matter there.
        options["start_new_session"] = options.pop("creationflags", 0) == NEW_PROCESS_GROUP
        start(process, *values, **options)

    def send_signal(process: Any, number: int) -> None:
        if number not in (signal.SIGTERM, signal.SIGKILL):
            raise ValueError(f"Unsupported signal: {number}")
        send(process, signal.SIGKILL)

    subprocess.Popen.__init__ = start_here  # type: ignore[method-assign]
    subprocess.Popen.send_signal = send_signal  # type: ignore[method-assign]


def require_closed(path: Any) -> None:
    """Raises `PermissionError` for a file that this process has open."""
    try:
        wanted = os.lstat(path)
    except OSError:
        return
    is_open = False
    for name in os.listdir("/proc/self/fd"):  # noqa: PTH208
        with suppress(OSError):
            if os.path.samestat(os.fstat(int(name)), wanted):
                is_open = True
    if is_open:
        raise PermissionError(errno.EACCES, "The process cannot access the file: it is open", str(path))


def keep_open_files() -> None:
    """Files of Windows: one that this process has open keeps its name."""
    replace, rename, unlink = os.replace, os.rename, os.unlink

    def replace_closed(source: Any, target: Any, **more: Any) -> None:
        require_closed(source)
        require_closed(target)
        replace(source, target, **more)

    def rename_closed(source: Any, target: Any, **more: Any) -> None:
        require_closed(source)
        if os.path.lexists(target):
            raise FileExistsError(errno.EEXIST, "Cannot create a file when that file already exists", str(target))
        rename(source, target, **more)

    def unlink_closed(path: Any, **more: Any) -> None:
        require_closed(path)
        unlink(path, **more)

    os.replace, os.rename, os.unlink, os.remove = replace_closed, rename_closed, unlink_closed, unlink_closed


def open_as_text() -> None:
    """Files of Windows: without `O_BINARY` bytes are changed, and a folder is not opened at all."""
    open_file = os.open

    def open_here(path: Any, flags: int, *values: Any, **more: Any) -> int:
        if is_ours(sys._getframe(1)):
            if not flags & O_BINARY:
                raise ValueError(f"{path}: opened as text; add O_BINARY")
            if os.path.isdir(path):  # noqa: PTH112
                raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return open_file(path, flags, *values, **more)

    os.open = open_here


def make_msvcrt() -> ModuleType:
    """`msvcrt`: locks of bytes from the present position of a descriptor, and the console, which is standard input."""
    module = ModuleType("msvcrt")

    def locking(fd: int, mode: int, count: int) -> None:
        if mode != LK_NBLCK and mode != LK_LOCK:
            raise NotImplementedError
        # Open-file locks of Linux: as on Windows, two descriptors of one process exclude each other.
        lock = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_CUR, 0, count, 0)
        for _ in range(10 if mode == LK_LOCK else 1):
            with suppress(OSError):
                fcntl.fcntl(fd, fcntl.F_OFD_SETLK, lock)
                return
            time.sleep(0.1)  # a second on Windows
        number = errno.EDEADLK if mode == LK_LOCK else errno.EACCES
        raise OSError(number, os.strerror(number))

    module.__dict__.update(LK_NBLCK=LK_NBLCK, LK_LOCK=LK_LOCK, locking=locking)
    module.__dict__.update(kbhit=lambda: bool(select([0], [], [], 0)[0]), getwch=lambda: os.read(0, 1).decode())
    return module


def change_system() -> None:
    """Let our packages see the other system."""
    missing = read_list(LISTS[SYSTEM])
    hide_folders()
    if SYSTEM == "darwin":
        show_views(missing, {"sys": {"platform": SYSTEM}}, {})
        return
    refuse_by_loops()
    end_children_at_once()
    keep_open_files()
    open_as_text()
    own: dict[str, dict[str, Any]] = {"subprocess": {"CREATE_NEW_PROCESS_GROUP": NEW_PROCESS_GROUP}}
    own |= {"os": {"O_BINARY": O_BINARY}, "sys": {"platform": SYSTEM}, "signal": {"SIGBREAK": signal.SIGUSR2}}
    show_views(missing, own, {"msvcrt": make_msvcrt()})


if SYSTEM:
    change_system()
