"""`SHRC203VISADriver` of `pymodaq-plugins-optosigma`, unmodified, without PyMoDAQ around it.

The driver's module imports two functions for its log from PyMoDAQ, a desktop application that opens its Qt windows'
machinery and writes configuration files into the user's home when it is imported; so does the plugin's own package.
Therefore the module is loaded from its installed file alone, and those two functions are given to it from here.
"""

import logging
import sys
from importlib.metadata import distribution
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

DISTRIBUTION = "pymodaq-plugins-optosigma"
MODULE = "pymodaq_plugins_optosigma/hardware/shrc203_VISADriver.py"


def driver_class() -> Any:
    """The class, from the installed file."""
    logger = ModuleType("pymodaq.utils.logger")
    vars(logger).update(set_logger=logging.getLogger, get_module_name=lambda file: Path(file).stem)
    for name in ("pymodaq", "pymodaq.utils"):
        sys.modules.setdefault(name, ModuleType(name))
    sys.modules["pymodaq.utils.logger"] = logger
    spec = spec_from_file_location("shrc203_VISADriver", str(distribution(DISTRIBUTION).locate_file(MODULE)))
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return vars(module)["SHRC203VISADriver"]
