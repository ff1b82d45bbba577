"""Reload of the fleet file while the fleet runs: by idle controllers without a lease; by none if one refuses."""

from collections.abc import Callable

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.leases import LeaseRegistry
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller, Fleet
from orchestrator.model.messages import ConfigureRequest, Reply

ANSWER_S = 3.0
RECONNECT_S = 10  # for all controllers to be connected and adopted with their new configuration
POLL_NS = 50 * NS_PER_MS
FIXED_FIELDS = ("adapter", "host", "link")


class FleetReload:
    """Reloads the fleet of `view`. save: stores a loaded file."""

    def __init__(self, fleet: FleetAccess, leases: LeaseRegistry, save: Callable[[Fleet], None]) -> None:
        self._fleet = fleet
        self._leases = leases
        self._save = save

    async def load_fleet(self, fresh: Fleet, actor: str) -> list[str]:
        """Load `fresh`; return the controllers whose configuration has changed. Raises `Refusal`."""
        fleet = self._require_comparable(fresh)
        old = self._fleet.view.fleet
        changed_controllers = {
            name: config for name, config in fleet.controllers.items() if config.digest != old.controllers[name].digest
        }
        held_leases = self._leases.all_leases
        if held_leases:
            raise Refusal(
                "leased",
                f"{', '.join(held_leases[0].axes)} is in use by {held_leases[0].actor} ({held_leases[0].what})",
                "wait for the end of that use, then reload",
            )
        await self._configure_controllers(changed_controllers, actor, check=True)
        await self._configure_controllers(changed_controllers, actor, check=False)
        self._fleet.view.fleet = fleet
        self._save(fleet)
        await self._wait_for_reconnect(changed_controllers)
        return list(changed_controllers)

    def _require_comparable(self, fresh: Fleet) -> Fleet:
        """`fresh` with the simulators in use, if everything that cannot change while the fleet runs is the same."""
        old = self._fleet.view.fleet
        if fresh.fleet != old.fleet:
            raise Refusal(
                "other-fleet",
                f"the file is of fleet {fresh.fleet}, but the running fleet is {old.fleet}",
                "choose the file of this fleet",
            )
        different = sorted(fresh.controllers.keys() ^ old.controllers.keys())
        if different:
            raise Refusal(
                "other-controllers",
                f"controller {different[0]} would be added or removed",
                "end `tutti up` and start it with the new file",
            )
        if fresh.notify != old.notify:
            # Any program on the bus can reload the file; it must not be able to run commands by that.
            raise Refusal(
                "other-command",
                "notify would change: the command that is run for alarms",
                "end `tutti up` and start it with the new file",
            )
        if fresh.journal != old.journal:
            raise Refusal(
                "other-journal",
                "journal would change: a leader and its standbys must count by the same lease",
                "end `tutti up` and start it with the new file",
            )
        controllers: dict[str, Controller] = {}
        for name, config in fresh.controllers.items():
            running_controller = old.controllers[name]
            for field in FIXED_FIELDS:
                if getattr(config, field) != getattr(running_controller, field):
                    raise Refusal(
                        "other-place",
                        f"controllers.{name}.{field} would change",
                        "end `tutti up` and start it with the new file",
                        name,
                    )
            controllers[name] = config.model_copy(update={"simulate": running_controller.simulate})
        return fresh.model_copy(update={"controllers": controllers})

    async def _configure_controllers(self, changed: dict[str, Controller], actor: str, *, check: bool) -> None:
        for name, config in changed.items():
            request = ConfigureRequest(
                **self._fleet.requests.request_fields(actor), configuration=config.to_plain(), check=check
            )
            reply = await self._fleet.requests.request(name, "configure", request, Reply, ANSWER_S)
            if reply.refused is not None:
                raise reply.refused.as_step_error()

    async def _wait_for_reconnect(self, changed: dict[str, Controller]) -> None:
        """Wait until all changed controllers are back. Raises `Refusal` with the reason for one that is not."""
        until_ns = self._fleet.clock.now_ns() + RECONNECT_S * NS_PER_S
        for name, config in changed.items():
            while True:
                state = self._fleet.view.last_state(name)
                if state is not None and state.digest == config.digest and state.mode not in ("offline", "fault"):
                    break
                if self._fleet.clock.now_ns() > until_ns:
                    reason = "its adapter does not answer"
                    if state is not None and not self._fleet.view.is_silent(name):
                        reason = state.faults[0].text if state.faults else f"its adapter is {state.mode}"
                    text = f"{name} has its new configuration, but is not back within {RECONNECT_S} s: {reason}"
                    raise Refusal("not-anew", text, "see `tutti status`", name)
                await sleep_ns(self._fleet.clock, POLL_NS)
