"""The class `GalilDMC` of ESRF's `bliss`, unmodified, without bliss around it.

The module imports a session's configuration, Tango, Redis and gevent, of which it uses a socket, a lock and a few names.
Therefore it is loaded from its installed files alone, and gets these from here.
"""

import socket
import sys
import threading
from importlib.metadata import distribution
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

DISTRIBUTION = "bliss"
FOLDER = "bliss/controllers/motors/galil"
PACKAGE = "galil_of_bliss"


class ControllerBase:
    """The base class of bliss's controllers, as far as the module uses it."""

    def __init__(self, name: str, config: dict[str, Any]) -> None:
        self.name = name
        self.config = ControllerConfig(config)


class ControllerConfig(dict[str, Any]):
    """A configuration; `get` names a type in addition."""

    @property
    def config_dict(self) -> dict[str, Any]:
        return self

    def get(self, key: str, kind: type = str, default: Any = None) -> Any:
        return kind(self[key]) if key in self else default


class PlainSocket:
    """bliss's connection: what is there by the time of reading is the answer."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), timeout=10)

    def write(self, data: bytes) -> None:
        self._socket.sendall(data)

    def raw_read(self) -> bytes:
        return self._socket.recv(4096)

    def close(self) -> None:
        self._socket.close()


def _module(name: str, **content: object) -> None:
    """Provide a module for the driver to import."""
    parts = name.split(".")
    for length in range(1, len(parts)):
        sys.modules.setdefault(".".join(parts[:length]), ModuleType(parts[length - 1]))
    found = sys.modules.setdefault(name, ModuleType(parts[-1]))
    vars(found).update(content)


def _provide_surroundings() -> None:
    _module("gevent", lock=ModuleType("lock"))
    _module("gevent.lock", Semaphore=threading.Lock)
    vars(sys.modules["gevent"])["lock"] = sys.modules["gevent.lock"]
    _module("bliss", global_map=type("GlobalMap", (), {"register": staticmethod(lambda *args, **more: None)}))
    _module("bliss.controllers.motor", Controller=ControllerBase)
    _module("bliss.common.logtools", **{f"log_{level}": lambda *args: None for level in ("debug", "warning", "error")})
    _module("bliss.common.axis.state", AxisState=lambda *states: set(states))
    _module("bliss.common.greenlet_utils", protect_from_kill=lambda function: function)
    _module("bliss.common.utils", object_method=lambda **more: lambda function: function)
    _module("bliss.comm.util", TCP="tcp", get_comm=lambda config, **more: PlainSocket(config["host"], config["port"]))


def driver_class() -> Any:
    """The class, from the installed files."""
    _provide_surroundings()
    folder = Path(str(distribution(DISTRIBUTION).locate_file(FOLDER)))
    package = ModuleType(PACKAGE)
    package.__path__ = [str(folder)]
    sys.modules[PACKAGE] = package
    spec = spec_from_file_location(f"{PACKAGE}.galildmc", folder / "galildmc.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return vars(module)["GalilDMC"]
