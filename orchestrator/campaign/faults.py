"""The faults of the campaign: what each one affects, how it is injected, and how an operator repairs it."""

from collections.abc import Callable
from contextvars import Context
from dataclasses import dataclass, replace
from random import Random
from typing import Literal

from orchestrator.bus.base import Priority
from orchestrator.campaign.fleets import PERMIT
from orchestrator.campaign.jobs import line_of
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock
from orchestrator.link.can import decode, encode
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import EstopMessage
from orchestrator.runtime.virtual import VirtualFleet
from sim.smc30.framing import compute_checksum

Reach = Literal["unit", "power", "line", "host", "fleet"]


@dataclass(frozen=True, slots=True)
class Fault:
    """One kind of fault.

    reach: the affected controllers besides the member; power: also those on its link.
    must_stop: a step that has begun must not continue, and stops within the detection time.
    latent: the fault cannot be detected before the member receives `go`, or moves.
    harmless: all jobs complete despite it.
    deaf: affected controllers cannot be stopped during the fault.
    beyond: measurements of the affected controllers are outside the model of link and crystal, so their evidence may
    be wrong.
    hands_on: a jogged axis may continue, as long as the jog is renewed.
    """

    name: str
    reach: Reach
    must_stop: bool = True
    latent: bool = False
    harmless: bool = False
    deaf: bool = False
    beyond: bool = False
    hands_on: bool = False


FAULTS: dict[str, Fault] = {
    each.name: each
    for each in (
        Fault("none", "fleet", must_stop=False, harmless=True),
        Fault("host-killed", "host"),
        Fault("host-hung", "host"),
        Fault("host-other-file", "host"),
        Fault("link-cut", "line", latent=True, deaf=True, beyond=True),
        Fault("link-closed", "line"),
        Fault("link-slow", "line", must_stop=False, beyond=True),
        Fault("garbage", "line", latent=True, deaf=True, beyond=True),
        Fault("refusals", "line", must_stop=False, beyond=True),
        Fault("firmware-hung", "line", latent=True, deaf=True, beyond=True),
        Fault("power-off", "power", latent=True),
        Fault("power-cycle", "power", latent=True),
        Fault("limit", "unit", latent=True),
        Fault("stall", "unit", must_stop=False),
        Fault("crystal", "unit", must_stop=False, beyond=True),
        Fault("bus-cut", "host", hands_on=True),
        Fault("bus-loss", "host", must_stop=False),
        Fault("stop", "fleet"),
        Fault("estop", "fleet"),
        Fault("permit-lost", "fleet"),
        Fault("coordinator-killed", "fleet", hands_on=True),
        Fault("coordinator-hung", "fleet", hands_on=True),
        Fault("coordinator-overtaken", "fleet", hands_on=True),
        Fault("journal-full", "fleet", must_stop=False),
        Fault("wall-clock", "fleet", must_stop=False, harmless=True),
    )
}

CRYSTAL_PPM = 400.0  # eight times the largest rate error of a crystal in the fleets
SLOW_NS = 150 * NS_PER_MS
POWER_CYCLE_NS = 400 * NS_PER_MS
REFUSALS_NS = 300 * NS_PER_MS
OVERLAP_NS = 1500 * NS_PER_MS  # a new coordinator leads for this time before a hung one resumes

Mend = Callable[[], object]


class Breaker:
    """Injects and repairs the faults of one fleet.

    leader_name: the coordinator that should lead now.
    former_leaders: those that led before and were overtaken."""

    def __init__(self, fleet: VirtualFleet, clock: VirtualClock, draw: Random) -> None:
        self.reigning = "first"
        self.overtaken: list[str] = []
        self._fleet = fleet
        self._clock = clock
        self._draw = draw
        self._whole = fleet.fleet
        self._reigns = 1
        self._mend: Mend = _nothing

    def touched(self, fault: Fault, member: str) -> list[str]:
        """Return the controllers that `fault` of `member` affects: all of them if one is the controller with the
        permit's input."""
        controllers = list(self._whole.controllers)
        touched = controllers if fault.reach == "fleet" else self._reached(fault, member)
        return controllers if self._whole.permits and self._door()[0] in touched else touched

    def _reached(self, fault: Fault, member: str) -> list[str]:
        controllers = self._whole.controllers
        if fault.reach == "host":
            return [name for name, config in controllers.items() if config.host == controllers[member].host]
        # Other controllers on a link wait while a controller that is off is polled.
        return [member] if fault.reach == "unit" else line_of(self._whole, member)

    async def strike(self, fault: Fault, member: str) -> None:
        """Inject the fault now."""
        blow = {"fleet": self._fleet_blow, "host": self._host_blow, "line": self._line_blow}
        self._mend = blow.get(fault.reach, self._unit_blow)(fault.name, member)
        if fault.name == "stop":
            client = self._fleet.client("stopper")
            await client.stop()
            await client.close()

    async def mend(self) -> None:
        """Repair the fault as an operator does."""
        self._mend()
        hung = [name for name in self.overtaken if self._fleet.process(f"coordinator/{name}").frozen]
        if hung:
            await sleep_ns(self._clock, OVERLAP_NS)
            for name in hung:
                self._fleet.resume(f"coordinator/{name}")

    def _fleet_blow(self, fault: str, _: str) -> Mend:
        fleet = self._fleet
        reigning = f"coordinator/{self.reigning}"
        match fault:
            case "estop":
                event = f"e{self._clock.now_ns()}"  # a seed may contain two
                bus = fleet.net.join(f"campaign-{event}")
                bus.put(fleet.keys.estop, EstopMessage(event=event, actor="campaign").to_json(), Priority.ESTOP)
            case "permit-lost":
                door, number = self._door()
                fleet.within(door, lambda each: each.set_input(number, False))  # it is active when low
                return lambda: fleet.within(door, lambda each: each.set_input(number, True))
            case "coordinator-killed":
                fleet.kill(reigning)
                return self._crown
            case "coordinator-hung":
                fleet.freeze(reigning)
                self.overtaken.append(self.reigning)
                return self._crown
            case "coordinator-overtaken":
                self.overtaken.append(self.reigning)
                self._crown(take_over=True)
            case "journal-full":
                fleet.disk_full = True
                return lambda: setattr(fleet, "disk_full", False)
            case "wall-clock":
                self._clock.wall_step_ns += self._draw.choice((-3600, -1, 1, 3600)) * NS_PER_S
            case _:  # "none", and "stop", which a client requests
                pass
        return _nothing

    def _host_blow(self, fault: str, member: str) -> Mend:
        fleet = self._fleet
        host = f"host/{self._whole.controllers[member].host}"
        bus = fleet.process(host).name
        match fault:
            case "host-killed":
                fleet.kill(host)
                return _nothing
            case "host-hung":
                fleet.freeze(host)
                return _nothing
            case "host-other-file":
                fleet.fleet = _slower(self._whole, member)
                fleet.kill(host)

                def give_back() -> None:
                    fleet.fleet = self._whole
                    fleet.kill(host)

                return give_back
            case "bus-cut":
                fleet.net.partition({bus}, {fleet.process(f"coordinator/{self.reigning}").name})
                return fleet.net.heal
            case _:  # bus-loss
                fleet.net.lose(bus, self._draw.choice((0.3, 0.7, 1.0)))
                return lambda: fleet.net.lose(bus, 0.0)

    def _line_blow(self, fault: str, member: str) -> Mend:
        fleet, wire = self._fleet, self._fleet.wires[member]
        usual = wire.model

        def mend() -> None:
            wire.cut, wire.to_near, wire.to_far, wire.model = False, None, None, usual

        match fault:
            case "link-cut":
                wire.cut = True
            case "link-closed":
                for link in list(wire.links):
                    link.hang_up()
            case "link-slow":
                wire.model = replace(usual, latency_ns=usual.latency_ns + self._draw.randrange(SLOW_NS))
            case "garbage":
                # Corrupted frames on a CAN bus are not delivered at all.
                can = self._whole.controllers[member].link.kind == "can"
                wire.to_near = self._drop if can else self._garble
            case "refusals":
                make = self._whole.controllers[member].adapter
                if make == "ppsmc":  # a refused command gets no reply: the same as a lost command
                    wire.to_far = lambda _: b""
                else:
                    wire.to_near = _REFUSALS[make]
                self._later(REFUSALS_NS, mend)
            case _:  # firmware-hung
                fleet.freeze(f"sim/{member}")
                return lambda: fleet.resume(f"sim/{member}")
        return mend

    def _unit_blow(self, fault: str, member: str) -> Mend:
        fleet, axis = self._fleet, self._fleet.controllers[member].axis_names[0]

        def power(on: bool) -> None:
            fleet.within(member, lambda each: each.set_power(on))

        match fault:
            case "power-off":
                power(False)
                return lambda: power(True)
            case "power-cycle":
                power(False)
                self._later(POWER_CYCLE_NS, lambda: power(True))
            case "limit":
                fleet.within(member, lambda each: each.set_limit(axis, "both"))
                return lambda: fleet.within(member, lambda each: each.set_limit(axis, "none"))
            case "stall":
                fleet.within(member, lambda each: each.set_stalled(axis, True))
                return lambda: fleet.within(member, lambda each: each.set_stalled(axis, False))
            case _:  # crystal
                fleet.crystals[member].change_rate(self._draw.choice((-1, 1)) * CRYSTAL_PPM)
        return _nothing

    def _crown(self, take_over: bool = False) -> None:
        """Start another coordinator."""
        self._reigns += 1
        self.reigning = f"reign{self._reigns}"
        self._fleet.start_coordinator(self.reigning, take_over)

    def _door(self) -> tuple[str, int]:
        """Return the input of the fleet's permit."""
        controller, _, name = self._whole.permits[PERMIT].input.partition(".")
        return controller, self._whole.controllers[controller].inputs[name].number

    def _garble(self, data: bytes) -> bytes:
        return bytes(self._draw.randrange(256) for _ in data)

    def _drop(self, data: bytes) -> bytes:
        return b"" if self._draw.random() < 0.7 else data

    def _later(self, after_ns: int, call: Callable[[], None]) -> None:
        """Schedule a call outside of every process."""
        self._clock.call_at_ns(self._clock.now_ns() + after_ns, call, context=Context())


def _nothing() -> None:
    return None


def _slower(fleet: Fleet, member: str) -> Fleet:
    """Return the fleet file with another velocity limit."""
    plain = fleet.to_plain()
    for axis in plain["controllers"][member]["axes"].values():
        axis["limits"]["velocity"] *= 0.9
    return Fleet.model_validate(plain)


# Replies of a controller that refuses everything, made from its normal replies.


def _yaskawa(data: bytes) -> bytes:
    return b"?" if data.endswith(b":") else data


def _shrc203(data: bytes) -> bytes:
    return b"NG\r\n" if data.endswith(b"\r\n") else data


def _smc30(data: bytes) -> bytes:
    return b"E4" + bytes((compute_checksum(b"E4"),)) + b"\r" if data.endswith(b"\r") else data


def _cia402(data: bytes) -> bytes:
    """Replace replies to SDOs by aborts: "data cannot be transferred because of the present device state"."""
    abort = (0x0800_0022).to_bytes(4, "little")
    return encode(
        *(
            replace(frame, data=b"\x80" + frame.data[1:4] + abort) if frame.id & ~0x7F == 0x580 else frame
            for frame in decode(data)
        )
    )


_REFUSALS: dict[str, Callable[[bytes], bytes]] = {
    "smc4000": _yaskawa,
    "smc2000": _yaskawa,
    "shrc203": _shrc203,
    "smc30": _smc30,
    "cia402": _cia402,
}
