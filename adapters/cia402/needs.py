"""What the adapter needs of a drive's object dictionary, for what the fleet file asks for, and what happens without it.

The table of the drives' page has these rows.
"""

from collections.abc import Callable
from dataclasses import dataclass

from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen.objects import DictionaryObject
from adapters.cia402.fleetaxes import homing_method, only_axis
from adapters.cia402.mapping.required import PdoNeeds, PdoTimes
from adapters.cia402.options import Cia402Options
from orchestrator.model.fleet import Controller

_OTHER_DRIVE = "another drive is needed"


@dataclass(frozen=True, slots=True)
class AskedDrive:
    """One drive of the fleet file. followed: the object of the positions that are streamed to it; None: none are."""

    config: Controller
    options: Cia402Options
    followed: DictionaryObject | None = None

    @property
    def stated_homing(self) -> set[str]:
        """Return the fields of `homing` that the fleet file states."""
        return only_axis(self.config)[1].homing.model_fields_set

    def find_value(self, obj: DictionaryObject) -> int | None:
        """Return the value that an object must have which need not be writable; None: any."""
        if obj == o.HOMING_METHOD:
            return homing_method(only_axis(self.config)[1])
        return {o.PERIOD: self.options.period_ms, o.PERIOD_INDEX: o.MILLISECONDS}.get(obj)


def make_pdo_needs(config: Controller, options: Cia402Options, followed: DictionaryObject | None = None) -> PdoNeeds:
    """Return what the fleet file asks of the PDOs. followed: as in `AskedDrive`."""
    times = PdoTimes(options.state_ms, options.inhibit_ms)
    return PdoNeeds(times, bool(config.outputs), bool(config.inputs), followed)


@dataclass(frozen=True, slots=True)
class ObjectNeed:
    """Objects, and what they are for. without: what happens without them. applies: whether a drive is refused without
    them; remedy: the way out then. is_written: it does not suffice that they can be read."""

    objects: tuple[DictionaryObject, ...]
    purpose: str
    without: str = "refused"
    applies: Callable[[AskedDrive], bool] = lambda _: True
    remedy: str = _OTHER_DRIVE
    is_written: bool = True


def _never(_: AskedDrive) -> bool:
    return False


NEEDS = (
    ObjectNeed((o.DEVICE_TYPE,), "every connection", is_written=False),
    ObjectNeed((o.HEARTBEAT,), "every connection, as a sign of life"),
    ObjectNeed((o.STATUSWORD, o.MODE_DISPLAY, o.ACTUAL), "every motion", is_written=False),
    ObjectNeed((o.CONTROLWORD, o.MODE, o.TARGET, o.PROFILE_VELOCITY, o.ACCELERATION), "every motion"),
    ObjectNeed(
        (o.DECELERATION,),
        "moves with two ramps",
        "both ramps of a move are equal, by 6083h, and stops brake by it",
        _never,
    ),
    ObjectNeed(
        (o.DEMAND,),
        "streams (`jerk`)",
        "the commanded position is concluded from 6064h, within `rest_window`; streams are refused",
        lambda drive: drive.followed is not None,
        "remove `jerk` from the axis's limits",
        is_written=False,
    ),
    ObjectNeed((o.VELOCITY,), "the speed that is shown", "it is calculated from 6064h", _never, is_written=False),
    ObjectNeed(
        (o.INPUTS,),
        "`inputs`",
        "limit switches are not shown, and one that ends a motion is named as the drive's own limit; the drive homes "
        "on its switches all the same; named `inputs` are refused",
        lambda drive: bool(drive.config.inputs),
        "remove `inputs` from the controller",
        is_written=False,
    ),
    ObjectNeed(
        (o.OUTPUTS,),
        "`outputs`",
        "named `outputs` are refused",
        lambda drive: bool(drive.config.outputs),
        "remove `outputs` from the controller",
    ),
    ObjectNeed(
        (o.HOMING_METHOD,),
        "`homing.method`",
        "the axis cannot be homed; one that cannot be written must be the method of the fleet file",
        lambda drive: "method" in drive.stated_homing,
        "remove `homing.method` from the axis, which then cannot be homed",
    ),
    ObjectNeed(
        (o.HOMING_SWITCH_SPEED, o.HOMING_ZERO_SPEED),
        "`homing.speed`, `homing.search_speed`",
        "the axis is homed with the drive's own speeds",
        lambda drive: bool({"speed", "search_speed"} & drive.stated_homing),
        "remove the speeds of `homing`, and set them with the drive's own tool",
    ),
    ObjectNeed((o.HOMING_ACCELERATION,), "the ramp of homing", "the drive's own is used", _never),
    ObjectNeed((o.HOME_OFFSET,), "zero at the home position", "it is there, by the standard", _never),
    ObjectNeed(
        (o.LIMIT_LOW, o.LIMIT_HIGH), "soft limits in the drive", "plans and jogs alone keep the soft limits", _never
    ),
    ObjectNeed(
        (o.QUICK_STOP_DECELERATION,),
        "`quick_stop_acceleration`",
        "an abort brakes by the drive's own ramp; the option is refused",
        lambda drive: drive.options.quick_stop_acceleration is not None,
        "remove `quick_stop_acceleration`",
    ),
    ObjectNeed(
        (o.QUICK_STOP_OPTION,),
        "staying in quick stop",
        "a quick stop switches the drive off, as by the standard; it is enabled again",
        _never,
    ),
    ObjectNeed(
        (o.HALT_OPTION, o.PROFILE_TYPE), "the ramp of a halt, and trapezoids", "both are so, by the standard", _never
    ),
    ObjectNeed(
        (o.ABORT_CONNECTION_OPTION, o.CONSUMER),
        "`watchdog_ms`",
        "the drive does not monitor this computer; the option is refused",
        lambda drive: drive.options.watchdog_ms is not None,
        "remove `watchdog_ms`",
    ),
    ObjectNeed(
        (o.PERIOD, o.PERIOD_INDEX),
        "streams (`jerk`)",
        "streams are refused; values that cannot be written must be those of `period_ms`",
        lambda drive: drive.followed is not None,
        "remove `jerk` from the axis's limits",
    ),
    ObjectNeed(
        (o.INTERPOLATION_POSITION,),
        "streams in interpolated position mode",
        "streams need cyclic synchronous position mode",
        lambda drive: drive.followed == o.INTERPOLATION_POSITION,
        "remove `jerk` from the axis's limits",
    ),
    *(
        ObjectNeed(
            pair,
            f"`{name}`",
            "it is not compared; the option is refused",
            lambda drive, name=name: getattr(drive.options, name) is not None,
            f"remove `{name}`",
            is_written=False,
        )
        for name, pair in (("encoder", o.ENCODER), ("gear", o.GEAR), ("feed", o.FEED))
    ),
)
