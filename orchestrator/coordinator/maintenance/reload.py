"""Another fleet file while the fleet is up: taken by idle controllers that nobody holds, and by none if one refuses."""

from collections.abc import Callable

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.coordinator.fleet.leases import LeaseBook
from orchestrator.coordinator.fleet.requests import Members
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.motion.targets import Refuse, refuse
from orchestrator.model.fleet import Controller, Fleet
from orchestrator.model.messages import ConfigureRequest, Reply

ANSWER_S = 3.0
ANEW_NS = 10 * NS_PER_S  # for a controller to be reached and adopted with its new configuration
LOOK_NS = 50 * NS_PER_MS
MUST_STAY = ("adapter", "host", "link")


class Reloading:
    """Reloads the fleet of `view`. save: keeps a taken file."""

    def __init__(
        self,
        view: FleetView,
        members: Members,
        leases: LeaseBook,
        clock: Clock,
        save: Callable[[Fleet], None],
    ) -> None:
        self._view = view
        self._members = members
        self._leases = leases
        self._clock = clock
        self._save = save

    async def reload(self, fresh: Fleet, actor: str) -> list[str]:
        """Take `fresh`; gives the controllers whose configuration has changed. Raises `Refuse`."""
        fleet = self._comparable(fresh)
        old = self._view.fleet
        changed = {
            name: config for name, config in fleet.controllers.items() if config.digest != old.controllers[name].digest
        }
        held = self._leases.held
        if held:
            raise Refuse(
                "leased",
                f"{', '.join(held[0].axes)} is in use by {held[0].actor} ({held[0].what})",
                "wait for its end, then reload",
            )
        await self._configure(changed, actor, check=True)
        await self._configure(changed, actor, check=False)
        self._view.fleet = fleet
        self._save(fleet)
        await self._anew(changed)
        return list(changed)

    def _comparable(self, fresh: Fleet) -> Fleet:
        """`fresh` with the simulators in use, if all that can not change while the fleet is up is the same."""
        old = self._view.fleet
        if fresh.fleet != old.fleet:
            raise Refuse("other-fleet", f"the file is of fleet {fresh.fleet}, this is {old.fleet}", "choose its file")
        different = sorted(fresh.controllers.keys() ^ old.controllers.keys())
        if different:
            raise Refuse(
                "other-controllers",
                f"controller {different[0]} would come or go",
                "end `tutti up` and start it with the new file",
            )
        controllers: dict[str, Controller] = {}
        for name, config in fresh.controllers.items():
            running = old.controllers[name]
            for field in MUST_STAY:
                if getattr(config, field) != getattr(running, field):
                    raise Refuse(
                        "other-place",
                        f"controllers.{name}.{field} would change",
                        "end `tutti up` and start it with the new file",
                        name,
                    )
            controllers[name] = config.model_copy(update={"simulate": running.simulate})
        return fresh.model_copy(update={"controllers": controllers})

    async def _configure(self, changed: dict[str, Controller], actor: str, check: bool) -> None:
        for name, config in changed.items():
            request = ConfigureRequest(**self._members.fields(actor), configuration=config.to_plain(), check=check)
            reply = await self._members.ask(name, "configure", request, Reply, ANSWER_S)
            if reply.refused is not None:
                raise refuse(reply.refused)

    async def _anew(self, changed: dict[str, Controller]) -> None:
        """Wait until all changed controllers are there again. Raises `Refuse` with what keeps one away."""
        until_ns = self._clock.now_ns() + ANEW_NS
        for name, config in changed.items():
            while True:
                state = self._view.state(name)
                if state is not None and state.digest == config.digest and state.mode not in ("offline", "fault"):
                    break
                if self._clock.now_ns() > until_ns:
                    why = state.faults[0].text if state is not None and state.faults else "nothing is heard of it"
                    raise Refuse(
                        "not-anew", f"{name} has its new configuration, but: {why}", "see `tutti status`", name
                    )
                await sleep_ns(self._clock, LOOK_NS)
