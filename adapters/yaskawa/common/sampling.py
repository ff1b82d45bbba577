"""Positions that the controller records by itself into arrays (RA, RD, RC; SMC-4000 L9211-9394, SMC-2000 L4581-4621).

One element of each array is written every 2^n samples, by hardware, in the background (L9236). The counter of samples
and the index of the next element, read together, tell at which sample the first element was written.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import ceil, floor, log2

from adapters.contract import SampledPositions, SamplingPlan
from adapters.yaskawa.common.arrays import ArrayTransfer, free_arrays, read_elements
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.wire.exchange import SmcCommandRefused
from adapters.yaskawa.wire.record import AXIS_LETTERS
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal

LEAST_EXPONENT, MOST_EXPONENT = 1, 8  # of RC: 0 stops it
MOST_ELEMENTS = 8000  # of an array, and of RC
READINGS = 3  # of counter and index: each one narrows the instant of the first element
SLACK = 1  # samples that may pass between the two operands of a reading
POSITION_DIGITS = 10  # of an uploaded position (PF)
ELEMENT_CHARACTERS = 12  # of one, with its sign and a comma


def sample_array(number: int) -> str:
    """The array of the axis with this number among the recorded ones."""
    return f"XR{number + 1}"


SAMPLE_ARRAYS = tuple(sample_array(number) for number in range(len(AXIS_LETTERS)))


@dataclass(slots=True)
class _Recording:
    """A recording in the controller. axes: in the order of its arrays. period: samples between two elements; count:
    elements of each array. first: the sample at which the first element was written, as an interval."""

    axes: Sequence[str]
    period: int
    count: int
    first: tuple[int, int]


@dataclass(frozen=True, slots=True)
class SamplingLimits:
    """channels: arrays that the controller can fill at once. upload_elements: elements fetched at once. element_ns:
    longest time to fetch one, with its share of an exchange."""

    channels: int
    upload_elements: int
    element_ns: int

    @classmethod
    def of_link(cls, channels: int, upload_elements: int, exchange_ns: int, char_ns: int) -> "SamplingLimits":
        """The limits with a link whose exchanges take `exchange_ns` and whose characters take `char_ns`."""
        return cls(channels, upload_elements, exchange_ns // upload_elements + ELEMENT_CHARACTERS * char_ns)


class DeviceSampling:
    """The record mode of one controller."""

    def __init__(self, device: SmcDevice, motors: Mapping[str, int], limits: SamplingLimits) -> None:
        self._device = device
        self._motors = motors
        self._limits = limits
        self._recording: _Recording | None = None

    async def begin(self, axes: Sequence[str], period_ns: int, seconds: float) -> SamplingPlan:
        """Begin to record. Raises `Refusal`."""
        tick_ns = self._device.samples.tick_ns
        if len(axes) > self._limits.channels:
            text = f"{len(axes)} axes are to be recorded; the controller records at most {self._limits.channels}"
            raise Refusal("sampling-space", text, "name fewer axes in `record`")
        exponent = min(floor(log2(max(1.0, period_ns / tick_ns))), MOST_EXPONENT)
        if exponent < LEAST_EXPONENT:
            least_ns = tick_ns * (1 << LEAST_EXPONENT)
            raise Refusal(
                "sampling-period",
                f"a period of {period_ns / 1e6:g} ms is too short: the shortest one is {least_ns / 1e6:.3f} ms",
                f"write a period of at least {ceil(least_ns / 1e4) / 100:g} ms",
            )
        period = 1 << exponent
        count = ceil(seconds * NS_PER_S / (period * tick_ns)) + 1
        await self._allocate(axes, count, period * tick_ns)
        self._recording = _Recording(axes, period, count, await self._start(axes, exponent, count))
        fetch_ns = len(axes) * count * self._limits.element_ns + NS_PER_S
        return SamplingPlan(round(period * tick_ns), fetch_ns)

    async def take(self) -> SampledPositions:
        """Fetch what was recorded, and free the arrays. Raises `Refusal`."""
        recording, self._recording = self._recording, None
        if recording is None:
            raise Refusal("no-samples", "nothing is being recorded", "begin it first")
        session = self._device.session
        (is_running, index), _ = await session.read_numbers("_RC", "_RD")
        await session.send_command("RC 0")
        filled_count = int(index) if is_running else recording.count
        counts = {
            axis: await self._upload(sample_array(number), filled_count) for number, axis in enumerate(recording.axes)
        }
        await self._free()
        mapping = self._device.samples.current_mapping()
        if mapping is None:
            raise Refusal("no-clock", "the clock of the controller is not known", "try again when it is online")
        earliest, latest = recording.first
        first_ns = (mapping.to_host_ns(earliest) + mapping.to_host_ns(latest)) // 2
        bound_ns = mapping.bound_at_ns(mapping.to_host_ns(earliest)) + ceil((latest - earliest) * mapping.tick_ns / 2)
        period_ns = recording.period * mapping.tick_ns
        return SampledPositions(
            [first_ns + round(number * period_ns) for number in range(filled_count)], bound_ns, counts
        )

    async def _allocate(self, axes: Sequence[str], count: int, period_ns: float) -> None:
        session = self._device.session
        with suppress(SmcCommandRefused):
            await session.send_command("RC 0")
        await self._free()
        (free,), _ = await session.read_numbers("_DM")
        room = min(int(free) // len(axes), MOST_ELEMENTS)
        if count > room:
            text = f"{count} samples of {len(axes)} axes are needed, and there is room for {room} of each"
            fits_ms = ceil(count * period_ns / max(1, room) / 1e4) / 100
            raise Refusal("sampling-space", text, f"write a period of at least {fits_ms:g} ms, or record fewer axes")
        names = ",".join(f"{sample_array(number)}[{count}]" for number in range(len(axes)))
        await session.send_command(f"DM {names}")

    async def _start(self, axes: Sequence[str], exponent: int, count: int) -> tuple[int, int]:
        """Start the recording; return the interval of the sample at which the first element was written."""
        session, numbers = self._device.session, range(len(axes))
        await session.send_command("RA " + ",".join(f"{sample_array(number)}[]" for number in numbers))
        await session.send_command("RD " + ",".join(f"_TP{AXIS_LETTERS[self._motors[axis]]}" for axis in axes))
        (tick_before,), _ = await session.read_numbers("TIME")
        await session.send_command(f"RC {exponent},{count}")
        earliest, latest, period = int(tick_before), int(tick_before) + (1 << 30), 1 << exponent
        for _ in range(READINGS):
            (ticks, index), _ = await session.read_numbers("TIME", "_RD")
            # Element `index` is the next one: it will be written after now, and the one before it was.
            earliest = max(earliest, int(ticks) - int(index) * period - SLACK)
            latest = min(latest, int(ticks) - (int(index) - 1) * period + SLACK)
        if earliest > latest:
            raise Refusal("sampling", "the controller's counter and its recording do not fit together", "try again")
        return earliest, latest

    async def _upload(self, name: str, count: int) -> list[int]:
        packets = ArrayTransfer(upload_elements=self._limits.upload_elements, digits=POSITION_DIGITS)
        (elements,) = await read_elements(self._device.session, [(name, 0, count)], packets)
        return elements

    async def _free(self) -> None:
        await free_arrays(self._device.session, SAMPLE_ARRAYS[: self._limits.channels])
