"""The faults of the campaign: what each one affects, how it is injected, and how an operator repairs it."""

from collections.abc import Callable
from contextvars import Context
from dataclasses import dataclass
from random import Random
from typing import Literal

from orchestrator.bus.base import Priority
from orchestrator.campaign.fleets import makes_with
from orchestrator.campaign.injection import disk_faults, journal_faults
from orchestrator.campaign.injection.bus_faults import BusFaults
from orchestrator.campaign.injection.frame_faults import FrameFaults
from orchestrator.campaign.injection.repairs import Repair, do_nothing
from orchestrator.campaign.jobs import find_link_members
from orchestrator.campaign.link_faults import LinkFaults
from orchestrator.campaign.stages.fleet_parts import find_traits
from orchestrator.campaign.stages.hall import HALL_MAKE
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import EstopMessage, EstopReset
from orchestrator.model.names import split_name
from orchestrator.runtime.virtual.fleet import VirtualFleet

FaultReach = Literal["unit", "power", "line", "host", "fleet"]


@dataclass(frozen=True, slots=True)
class FaultKind:
    """One kind of fault.

    reach: the affected controllers besides the member; power: also those on its link.
    must_stop: a step that has begun must not continue, and stops within the detection time.
    latent: the fault cannot be detected before the member receives `go`, or moves.
    harmless: all jobs complete despite it.
    unstoppable: affected controllers cannot be stopped during the fault.
    outside_model: measurements of the affected controllers are outside the model of link and crystal, so their
    evidence may be wrong.
    jog_may_continue: a jogged axis may continue, as long as the jog is renewed.
    of_job: it affects the controllers of the member's job only.
    attended: the member's job belongs to a command that a person waits for.
    makes: makes that it can affect; none named: all.
    own_seeds: only in seeds that name it, so that those without are as they were.
    of_databases: only in fleets whose journal is in databases.
    """

    name: str
    reach: FaultReach
    must_stop: bool = True
    latent: bool = False
    harmless: bool = False
    unstoppable: bool = False
    outside_model: bool = False
    jog_may_continue: bool = False
    of_job: bool = False
    attended: bool = False
    makes: tuple[str, ...] = ()
    own_seeds: bool = False
    of_databases: bool = False


FAULTS: dict[str, FaultKind] = {
    kind.name: kind
    for kind in (
        FaultKind("none", "fleet", must_stop=False, harmless=True),
        FaultKind("host-killed", "host"),
        FaultKind("host-hung", "host"),
        FaultKind("host-other-file", "host"),
        FaultKind("link-cut", "line", latent=True, unstoppable=True, outside_model=True),
        FaultKind("link-closed", "line"),
        FaultKind("link-slow", "line", must_stop=False, outside_model=True),
        FaultKind("garbage", "line", latent=True, unstoppable=True, outside_model=True),
        FaultKind("refusals", "line", must_stop=False, outside_model=True),
        FaultKind("firmware-hung", "line", latent=True, unstoppable=True, outside_model=True),
        FaultKind("power-off", "power", latent=True),
        FaultKind("power-cycle", "power", latent=True),
        FaultKind("limit", "unit", latent=True),
        FaultKind("stall", "unit", must_stop=False),
        FaultKind("crystal", "unit", must_stop=False, outside_model=True),
        FaultKind("bus-cut", "host", jog_may_continue=True),
        FaultKind("bus-loss", "host", must_stop=False),
        FaultKind("stop", "fleet"),
        FaultKind("estop", "fleet"),
        FaultKind("permit-lost", "fleet"),
        FaultKind("coordinator-killed", "fleet", jog_may_continue=True),
        FaultKind("coordinator-hung", "fleet", jog_may_continue=True),
        FaultKind("coordinator-overtaken", "fleet", jog_may_continue=True),
        FaultKind("journal-full", "fleet", must_stop=False),
        FaultKind("wall-clock", "fleet", must_stop=False, harmless=True),
        FaultKind("adversary", "fleet", must_stop=False, harmless=True),
        # People and second masters.
        FaultKind("operator-interrupts", "fleet", of_job=True, attended=True, jog_may_continue=True),
        FaultKind("operator-lost", "fleet", of_job=True, attended=True, jog_may_continue=True),
        FaultKind("operator-resets-early", "fleet"),
        FaultKind("fleet-restarted", "fleet"),
        FaultKind("cable-pulled", "line", makes=makes_with(lambda traits: traits.keeps_half_open)),
        FaultKind(
            "second-master",
            "unit",
            must_stop=False,
            makes=makes_with(lambda traits: bool(traits.change_one_thing)),
        ),
        # Networks, lines and replies that are partly broken.
        FaultKind("one-way-partition", "host", jog_may_continue=True),
        FaultKind("one-way-gap", "host", must_stop=False),
        FaultKind("nothing-forwarded", "host"),
        FaultKind("flapping-link", "line"),
        FaultKind("arbitrary-replies", "line", must_stop=False, outside_model=True),
        FaultKind("disk-full", "fleet", must_stop=False),
        FaultKind("disk-slow", "fleet", must_stop=False),
        FaultKind("disk-bit-flip", "fleet"),
        FaultKind("coordinator-cut", "fleet", jog_may_continue=True, own_seeds=True),
        FaultKind("router-hung", "fleet", own_seeds=True),
        # Frames of states, and a member that is late while nothing has moved.
        FaultKind("frame-lost", "host", must_stop=False, harmless=True, own_seeds=True),
        FaultKind("frames-repeated", "host", must_stop=False, harmless=True, own_seeds=True),
        FaultKind("frames-reordered", "host", must_stop=False, harmless=True, own_seeds=True),
        FaultKind("key-frames-lost", "host", must_stop=False, harmless=True, own_seeds=True),
        FaultKind("states-lost", "fleet", own_seeds=True),
        # The journal in databases on three machines, with a standby coordinator.
        *(
            FaultKind(name, "fleet", must_stop=False, jog_may_continue=True, own_seeds=True, of_databases=True)
            for name in ("journal-slow", "journal-lost", "primary-died")
        ),
        FaultKind("leader-machine-died", "fleet", jog_may_continue=True, own_seeds=True, of_databases=True),
        FaultKind("load-late", "line", must_stop=False, harmless=True, makes=(HALL_MAKE,), own_seeds=True),
    )
}

CRYSTAL_PPM = 400.0  # eight times the largest rate error of a crystal in the fleets
POWER_CYCLE_NS = 400 * NS_PER_MS
SECOND_MASTER_NS = 200 * NS_PER_MS  # until a second master leaves
OVERLAP_NS = 1500 * NS_PER_MS  # a new coordinator leads for this time before a hung one resumes


class FaultInjector:
    """Injects and repairs the faults of one fleet.

    leader_name: the coordinator that should lead now.
    former_leaders: those that led before and were overtaken."""

    def __init__(self, fleet: VirtualFleet, clock: VirtualClock, draw: Random) -> None:
        self.leader_name = "first"
        self.former_leaders: list[str] = []
        self._fleet = fleet
        self._clock = clock
        self._draw = draw
        self._whole_fleet = fleet.fleet
        self._coordinators = 1
        self._links = LinkFaults(fleet, clock, draw)
        self._buses = BusFaults(fleet, clock, draw)
        self._frames = FrameFaults(fleet, clock, draw)

    def find_leader(self) -> str:
        """The coordinator that leads, or should lead now: with databases one of those that stand by."""
        return self.leader_name if self._fleet.site is None else journal_faults.find_leader(self._fleet, "first")

    def find_affected(self, fault: FaultKind, member: str) -> list[str]:
        """Return the controllers that `fault` of `member` affects: all of them if one is the controller with the
        permit's input."""
        controllers = list(self._whole_fleet.controllers)
        touched_controllers = controllers if fault.reach == "fleet" else self._find_in_reach(fault, member)
        return (
            controllers
            if self._whole_fleet.permits and self._find_permit_input()[0] in touched_controllers
            else touched_controllers
        )

    def _find_in_reach(self, fault: FaultKind, member: str) -> list[str]:
        controllers = self._whole_fleet.controllers
        if fault.reach == "host":
            return [name for name, config in controllers.items() if config.host == controllers[member].host]
        # Other controllers on a link wait while a controller that is off is polled.
        return [member] if fault.reach == "unit" else find_link_members(self._whole_fleet, member)

    async def inject_fault(self, fault: FaultKind, member: str) -> Repair:
        """Inject the fault now; return its repair, for `repair_fault`."""
        if fault.of_databases:
            return journal_faults.inject_fault(self._fleet, fault.name, self.find_leader(), self._draw)
        blow = {"fleet": self._inject_fleet_fault, "host": self._inject_host_fault, "line": self._links.inject_fault}
        repair = blow.get(fault.reach, self._inject_controller_fault)(fault.name, member)
        if fault.name == "states-lost":
            return self._frames.inject_fault(fault.name, self._whole_fleet.controllers[member].host)
        if fault.name == "second-master":
            await self._change_one_thing(member)
        if fault.name == "operator-resets-early":
            client = self._fleet.make_client("hasty")
            await client.reset()
            await client.close()
        if fault.name == "stop":
            client = self._fleet.make_client("stopper")
            await client.stop()
            await client.close()
        return repair

    async def _change_one_thing(self, member: str) -> None:
        """Change one thing of a controller as a second master does: over a connection of its own."""
        config = self._whole_fleet.controllers[member]
        link = await self._fleet.wires[member].open_link()
        motor = next(iter(config.axes.values())).motors[0]
        change_one_thing = find_traits(config.adapter).change_one_thing
        if change_one_thing is not None:
            at_rest = not self._fleet.controllers[member].is_moving(motor)
            link.write(change_one_thing(config, self._draw, at_rest=at_rest))
        await sleep_ns(self._clock, SECOND_MASTER_NS)
        await link.close()

    async def repair_fault(self, repair: Repair) -> None:
        """Repair a fault as an operator does."""
        repair()
        hung = [name for name in self.former_leaders if self._fleet.find_process(f"coordinator/{name}").frozen]
        if hung:
            await sleep_ns(self._clock, OVERLAP_NS)
            for name in hung:
                self._fleet.resume(f"coordinator/{name}")

    def _inject_fleet_fault(self, fault: str, _: str) -> Repair:
        fleet = self._fleet
        leader = f"coordinator/{self.leader_name}"
        match fault:
            case "estop" | "operator-resets-early" | "states-lost":
                self._send_estop()
            case "permit-lost":
                door, number, lost_level = self._find_permit_input()
                fleet.act_on_controller(door, lambda controller: controller.set_input(number, level=lost_level))
                return lambda: fleet.act_on_controller(
                    door, lambda controller: controller.set_input(number, level=not lost_level)
                )
            case "fleet-restarted":
                return self._kill_all_processes()
            case "coordinator-cut" | "router-hung":
                hosts = [fleet.find_process(f"host/{host}").name for host in self._whole_fleet.hosts]
                return self._buses.inject_fleet_fault(fault, fleet.find_process(leader).name, hosts)
            case "coordinator-killed":
                fleet.kill(leader)
                return self._start_coordinator
            case "coordinator-hung":
                fleet.freeze(leader)
                self.former_leaders.append(self.leader_name)
                return self._start_coordinator
            case "coordinator-overtaken":
                self.former_leaders.append(self.leader_name)
                self._start_coordinator(take_over=True)
            case "journal-full" | "disk-full" | "disk-slow":
                return disk_faults.inject_fault(fleet, fault, self._draw)
            case "disk-bit-flip":
                disk_faults.inject_fault(fleet, fault, self._draw)
                return self._kill_all_processes()
            case "adversary":
                self._send_forged_messages()
            case "wall-clock":
                self._clock.wall_step_ns += self._draw.choice((-3600, -1, 1, 3600)) * NS_PER_S
            case _:  # "none", and those that a client causes: "stop", "operator-interrupts", "operator-lost"
                pass
        return do_nothing

    def _send_estop(self) -> None:
        fleet, event = self._fleet, f"e{self._clock.now_ns()}"  # a seed may contain two
        bus = fleet.net.join_process(f"campaign-{event}")
        bus.put(fleet.keys.estop, EstopMessage(event=event, actor="campaign").to_json(), Priority.ESTOP)

    def _send_forged_messages(self) -> None:
        """Put on the bus what any session can: heartbeats of a leader that does not exist or is far ahead, resets of
        another e-stop, and garbage on every key that something subscribes to."""
        fleet, keys = self._fleet, self._fleet.keys
        bus = fleet.net.join_process(f"adversary-{self._clock.now_ns()}")
        real = fleet.coordinators[self.leader_name][1].leadership
        beat = real.make_heartbeat()
        forged_heartbeats = [
            beat.model_copy(update={"epoch": 2**53 - 1, "coordinator": "forged"}),
            beat.model_copy(update={"epoch": beat.epoch + 1, "coordinator": "forged", "scale_id": "forged"}),
            beat.model_copy(update={"seq": 2**53 - 1}),
            beat.model_copy(update={"scale_id": "forged", "origin_host_ns": 0}),
        ]
        for heartbeat in self._draw.sample(forged_heartbeats, 3):
            bus.put(keys.leader, heartbeat.to_json(), Priority.EVENT)
        bus.put(keys.estop_reset, EstopReset(event="another", actor="forged").to_json(), Priority.EVENT)
        garbage = [b"", b"\xff\x00", b"{}", b"null", b'{"epoch": 1e999}', bytes(self._draw.randbytes(200)), b"[" * 5000]
        for controller in self._whole_fleet.controllers:
            for key in (keys.leader, keys.estop_reset, keys.session("forged"), keys.state(controller)):
                bus.put(key, self._draw.choice(garbage), Priority.EVENT)
            bus.put(keys.event(controller), self._draw.choice(garbage), Priority.EVENT)

    def _inject_host_fault(self, fault: str, member: str) -> Repair:
        fleet, name = self._fleet, self._whole_fleet.controllers[member].host
        host = f"host/{name}"
        bus = fleet.find_process(host).name
        match fault:
            case "host-killed":
                fleet.kill(host)
                return do_nothing
            case "host-hung":
                fleet.freeze(host)
                return do_nothing
            case "host-other-file":
                fleet.fleet = _with_lower_velocity(self._whole_fleet, member)
                fleet.kill(host)

                def restore_fleet() -> None:
                    fleet.fleet = self._whole_fleet
                    fleet.kill(host)

                return restore_fleet
            case "frame-lost" | "frames-repeated" | "frames-reordered" | "key-frames-lost":
                return self._frames.inject_fault(fault, name)
            case _:
                return self._buses.inject_fault(fault, bus, fleet.find_process(f"coordinator/{self.leader_name}").name)

    def _inject_controller_fault(self, fault: str, member: str) -> Repair:
        fleet, axis = self._fleet, self._fleet.controllers[member].axis_names[0]

        def switch_power(*, on: bool) -> None:
            fleet.act_on_controller(member, lambda controller: controller.set_power(on=on))

        match fault:
            case "power-off":
                switch_power(on=False)
                return lambda: switch_power(on=True)
            case "power-cycle":
                switch_power(on=False)
                self._schedule_call(POWER_CYCLE_NS, lambda: switch_power(on=True))
            case "limit":
                fleet.act_on_controller(member, lambda controller: controller.set_limit(axis, "both"))
                return lambda: fleet.act_on_controller(member, lambda controller: controller.set_limit(axis, "none"))
            case "stall":
                fleet.act_on_controller(member, lambda controller: controller.set_stalled(axis, stalled=True))
                return lambda: fleet.act_on_controller(
                    member, lambda controller: controller.set_stalled(axis, stalled=False)
                )
            case "second-master":  # over a connection of its own
                pass
            case _:  # crystal
                fleet.crystals[member].change_rate(self._draw.choice((-1, 1)) * CRYSTAL_PPM)
        return do_nothing

    def _kill_all_processes(self) -> Repair:
        """Kill the coordinator and all hosts, which their guardians start again."""
        for host in self._whole_fleet.hosts:
            self._fleet.kill(f"host/{host}")
        self._fleet.kill(f"coordinator/{self.leader_name}")
        return self._start_coordinator

    def _start_coordinator(self, *, take_over: bool = False) -> None:
        """Start another coordinator."""
        self._coordinators += 1
        self.leader_name = f"leader{self._coordinators}"
        self._fleet.start_coordinator(self.leader_name, take_over=take_over)

    def _find_permit_input(self) -> tuple[str, int, bool]:
        """Return the input of the fleet's first permit: controller, number, and its level without the permit."""
        permit = next(iter(self._whole_fleet.permits.values()))
        controller, name = split_name(permit.input)
        wired_input = self._whole_fleet.controllers[controller].inputs[name]
        return controller, wired_input.number, (not permit.value) == (wired_input.active == "high")

    def _schedule_call(self, after_ns: int, call: Callable[[], None]) -> None:
        """Schedule a call outside of every process."""
        self._clock.call_at_ns(self._clock.now_ns() + after_ns, call, context=Context())


def _with_lower_velocity(fleet: Fleet, member: str) -> Fleet:
    """Return the fleet file with another velocity limit."""
    plain = fleet.to_plain()
    for axis in plain["controllers"][member]["axes"].values():
        axis["limits"]["velocity"] *= 0.9
    return Fleet.model_validate(plain)
