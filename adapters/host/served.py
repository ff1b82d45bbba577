"""What an adapter host answers, by two declarations for all its controllers: values and commands of each, requests to
several, and all states."""

from collections.abc import Callable, Iterable, Mapping

from adapters.controller.supervisor import ControllerSupervisor
from orchestrator.bus.base import BusSample, RequestHandler
from orchestrator.bus.keys import FleetKeys


def answer_behind(publish: Callable[[], None], handler: RequestHandler) -> RequestHandler:
    """A handler of commands that calls `publish` before it answers: what the command has changed is sent first."""

    async def answer(sample: BusSample) -> bytes:
        reply = await handler(sample)
        publish()
        return reply

    return answer


class ServedControllers:
    """The keys `ctl/{id}/…` of a host's controllers: a `ServedGroup`. It has no answer for those of other hosts.
    publish: called before a command is answered."""

    def __init__(
        self, keys: FleetKeys, supervisors: Mapping[str, ControllerSupervisor], publish: Callable[[], None]
    ) -> None:
        self._prefix = f"{keys.prefix}/ctl/"
        self._supervisors = supervisors
        self._publish = publish

    def find_handler(self, key: str) -> RequestHandler | None:
        """The handler of a command, or of a value."""
        controller, _, leaf = key.removeprefix(self._prefix).partition("/")
        supervisor = self._supervisors.get(controller)
        if supervisor is None:
            return None
        family, _, verb = leaf.partition("/")
        handler = supervisor.find_handler(family)
        if handler is None or bool(verb) != (family == "cmd"):
            return None
        return answer_behind(self._publish, handler) if verb else handler

    def list_values(self) -> Iterable[str]:
        """The values of all controllers."""
        return [
            f"{self._prefix}{controller}/{leaf}"
            for controller, supervisor in self._supervisors.items()
            for leaf in supervisor.values
        ]


class ServedHost:
    """The keys `host/{name}/…`: a `ServedGroup`. batch: answers requests to several controllers. states: answers with
    all states."""

    def __init__(self, keys: FleetKeys, name: str, batch: RequestHandler, states: RequestHandler) -> None:
        self._states_key = keys.host_states(name)
        self._batch_prefix = keys.batch_command(name).removesuffix("*")
        self._batch, self._states = batch, states

    def find_handler(self, key: str) -> RequestHandler | None:
        """The handler of a key."""
        if key == self._states_key:
            return self._states
        return self._batch if key.startswith(self._batch_prefix) else None

    def list_values(self) -> Iterable[str]:
        """All states."""
        return [self._states_key]
