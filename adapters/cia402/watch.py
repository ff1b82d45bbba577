"""Settings of a drive that motion relies on, compared with what the drive holds now: another master may change them.

Expected are the values that configuring has loaded or accepted. The objects that determine where a motion goes are read
before each step; all objects are read in turn at rest, by SDO.
"""

from collections import deque
from collections.abc import Iterable, Sequence

from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.objects import DictionaryObject
from adapters.cia402.canopen.pdos import PdoMapping
from adapters.cia402.canopen.sdo import SdoAborted
from adapters.cia402.canopen.words import NOT_THERE, WRONG_STATE
from adapters.cia402.mapping.transfer import parameter_values, pdo_value
from adapters.contract import SettingDifference
from orchestrator.model.errors import Refusal

_REFERENCE = (o.POLARITY, o.HOME_OFFSET, *o.GEAR, *o.ENCODER, *o.FEED)
"""A count stands for another position after a change of these."""
AT_ARM = (o.POLARITY, o.HOME_OFFSET, *o.GEAR)
"""Read before each step; the mode is written and verified by arming itself."""
_PLACES = (*_REFERENCE, o.MODE, o.LIMIT_LOW, o.LIMIT_HIGH)
_BEHAVIOUR = (
    o.QUICK_STOP_OPTION,
    o.SHUTDOWN_OPTION,
    o.DISABLE_OPTION,
    o.HALT_OPTION,
    o.FAULT_OPTION,
    o.ABORT_CONNECTION_OPTION,
    o.FOLLOWING_WINDOW,
    o.FOLLOWING_TIMEOUT,
    o.POSITION_WINDOW,
    o.POSITION_WINDOW_TIME,
    o.VELOCITY_MAX,
    o.MOTOR_SPEED_MAX,
    o.ACCELERATION_MAX,
    o.DECELERATION_MAX,
    o.QUICK_STOP_DECELERATION,
    o.PROFILE_TYPE,
    *o.VELOCITY_FACTOR,
    *o.ACCELERATION_FACTOR,
    o.PERIOD,
    o.PERIOD_INDEX,
    o.OUTPUT_MASK,
    o.SYNC_ID,
    o.SYNC_PERIOD,
    o.CONSUMER,
    o.HEARTBEAT,
)


class SettingsWatch:
    """The watched settings of one connection. axis: its name in the fleet file."""

    def __init__(self, node: BusDrive, axis: str) -> None:
        self._node = node
        self._axis = axis
        self._pdo: dict[DictionaryObject, int] = {}
        self._rings: tuple[deque[DictionaryObject], ...] = ()
        self._boots = 0
        self.has_differences = False
        """Whether a difference has been found since the settings were last in order."""

    async def record_settings(self, pdos: Sequence[PdoMapping]) -> None:
        """Read what the drive holds now, after configuring: these values are expected from now on.

        Raises like `SdoClient.read_value`.
        """
        node = self._node
        self._boots = node.boots
        self._pdo = {obj: value for pdo in pdos for obj, value in parameter_values(pdo, node.number)}
        # The soft limits are loaded later.
        node.held.clear()
        for obj in (*_REFERENCE, *_BEHAVIOUR):
            value = await self._read(obj)
            if value is not None:
                node.held[obj] = value
        self._rings = deque(_PLACES), deque((*_BEHAVIOUR, *self._pdo))
        self.has_differences = False

    @property
    def arm_reads(self) -> int:
        """Return the number of objects that are read before each step: all of them, until the drive is known."""
        return sum(obj in self._node.held for obj in AT_ARM) if self._rings else len(AT_ARM)

    async def check_motion(self) -> Sequence[SettingDifference]:
        """Compare what determines where a motion goes."""
        return await self._compare(AT_ARM)

    async def check_next(self) -> Sequence[SettingDifference]:
        """Compare the next two objects in turn: one that concerns positions, and one of all others."""
        objects: list[DictionaryObject] = []
        for ring in self._rings:
            for _ in range(len(ring)):
                ring.rotate(-1)
                if self._is_watched(ring[-1]):
                    objects.append(ring[-1])
                    break
        return await self._compare(objects)

    async def restore_settings(self) -> bool:
        """Write the expected values again; return whether a PDO must be mapped again. Raises `Refusal`."""
        node, is_unmapped = self._node, False
        for obj in (*_PLACES, *_BEHAVIOUR, *self._pdo):
            wanted_value = self._expected(obj)
            if wanted_value is None or await self._read(obj) in (None, wanted_value):
                continue
            if obj in self._pdo:
                is_unmapped = True
                continue
            try:
                await node.sdo.write_value(obj, wanted_value)
            except SdoAborted as error:
                raise self._unrestored_refusal(obj, wanted_value, error) from None
            node.log.info("a setting that was changed is written again", setting=str(obj), value=wanted_value)
        self.has_differences = False
        return is_unmapped

    # Internals

    def _is_watched(self, obj: DictionaryObject) -> bool:
        return obj is o.MODE or obj in self._node.held or obj in self._pdo

    def _expected(self, obj: DictionaryObject) -> int | None:
        if obj is o.MODE:
            return self._node.wanted_mode
        return self._pdo.get(obj, self._node.held.get(obj))

    async def _read(self, obj: DictionaryObject) -> int | None:
        """Return the drive's value; None: the drive has no such object, or does not let it be read now."""
        try:
            value = await self._node.sdo.read_value(obj)
            return pdo_value(obj, value) if obj in self._pdo else value
        except SdoAborted as error:
            if error.abort in NOT_THERE:
                self._pdo.pop(obj, None)
            return None

    async def _compare(self, chosen: Iterable[DictionaryObject]) -> list[SettingDifference]:
        node, differences = self._node, list[SettingDifference]()
        for obj in chosen:
            if not node.mapped or node.boots != self._boots or self._expected(obj) is None:
                continue
            value = await self._read(obj)
            if value is not None and value != self._expected(obj):
                # A command of this adapter may have been under way: the next answer comes after it.
                value = await self._read(obj)
            expected_value = self._expected(obj)
            # A drive that has restarted has lost its settings: that is reported in another way.
            if value is not None and value != expected_value and node.boots == self._boots and node.mapped:
                differences.append(
                    SettingDifference(
                        item=f"{obj} of {node.name}",
                        found=str(value),
                        expected=str(expected_value),
                        axis=self._axis,
                        moves_reference=obj in _REFERENCE,
                    )
                )
                self.has_differences = True
        return differences

    def _unrestored_refusal(self, obj: DictionaryObject, wanted: int, error: SdoAborted) -> Refusal:
        remedy = f"correct {obj} with the drive's own tool"
        if error.abort == WRONG_STATE:
            remedy = f"disable {self._axis}, then reset again"
        return Refusal("setting-changed", f"{obj} cannot be set to {wanted} again: {error}", remedy)
