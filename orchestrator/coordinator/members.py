"""Requests to members. Whatever goes wrong on the way becomes a refusal: a value that names the member."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypedDict, TypeVar

from pydantic import ValidationError

from orchestrator.bus.base import Bus, NoReply, RequestRefused, RequestTimeout
from orchestrator.bus.keys import Keys
from orchestrator.coordinator.reign import Throne
from orchestrator.model.messages import Refusal, Reply, Request

R = TypeVar("R", bound=Reply)


class FencedFields(TypedDict):
    """What every fenced request carries."""

    request_id: str
    actor: str
    epoch: int
    coordinator: str


@dataclass(frozen=True, slots=True)
class Members:
    """Asks controllers on the bus, in the name of this reign."""

    bus: Bus
    keys: Keys
    throne: Throne
    new_id: Callable[[], str]

    def fields(self, actor: str) -> FencedFields:
        """What every fenced request carries."""
        return {
            "request_id": self.new_id(),
            "actor": actor,
            "epoch": self.throne.epoch,
            "coordinator": self.throne.coordinator,
        }

    async def ask(self, member: str, verb: str, request: Request, reply: type[R], timeout_s: float) -> R:
        """Send `request` to `member` and give its reply; one with `refused` set if there is none of use."""
        try:
            payload = await self.bus.request(self.keys.cmd(member, verb), request.to_json(), timeout_s)
            return reply.model_validate_json(payload)
        except NoReply:
            refusal = Refusal(
                code="absent", text=f"no adapter answers for {member}", remedy="is its adapter host running?"
            )
        except RequestTimeout:
            refusal = Refusal(
                code="no-answer",
                text=f"{member} has not answered {verb} within {timeout_s:g} s",
                remedy="look at its adapter host and its link (`tutti trace`)",
            )
        except RequestRefused as error:
            refusal = Refusal(code="bad-request", text=f"{member} does not understand {verb}: {error}")
        except ValidationError as error:
            refusal = Refusal(code="bad-reply", text=f"{member}'s answer to {verb} can not be read: {error}")
        return reply(refused=refusal.model_copy(update={"member": member}))
