"""The watchdog of a step in the controller: a sample by which the adapter must have extended it."""

from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.loaded import TICKS_MAX
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import WATCHDOG_STEP_TICKS
from orchestrator.clock.base import NS_PER_S

# controllers on one line of 19,200 baud whose watchdogs can be extended within half of the watchdog time
WATCHDOG_SHARED_MOST = 3


class StepWatchdog:
    """The deadline of one controller's steps, in samples."""

    def __init__(self, device: SmcDevice, options: YaskawaOptions) -> None:
        self._device = device
        self._options = options

    def extension_command(self, ticks: int) -> str:
        """Return the command that sets the watchdog deadline to some time after sample `ticks`."""
        patience = round(find_patience_s(self._device, self._options) * NS_PER_S / self._device.samples.tick_ns)
        return f"XDL={min(ticks + patience, TICKS_MAX)}"


def find_patience_s(device: SmcDevice, options: YaskawaOptions) -> float:
    """How long the watchdog waits for its next extension: on a shared line, each controller waits for the turns of all
    the others."""
    return options.watchdog_s * max(1.0, device.sharing_count / WATCHDOG_SHARED_MOST)


def find_alone_s(device: SmcDevice, options: YaskawaOptions) -> float:
    """How long axes go on in a step without a message of the adapter: the watchdog looks every `WATCHDOG_STEP_TICKS`,
    beside another thread that may take as many samples."""
    look_s = 2 * WATCHDOG_STEP_TICKS * options.tick_ns / NS_PER_S
    return find_patience_s(device, options) + look_s
