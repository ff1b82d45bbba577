"""Requests about axes under manual control: leases, reservations, commands in a make's own language."""

from collections.abc import Sequence

from orchestrator.client.connection import ANSWER_S
from orchestrator.client.fleet import FleetRequests
from orchestrator.client.manual import ManualControl
from orchestrator.model.jobs.service import AcquireAxes, AxesAcquired, ReleaseAxes
from orchestrator.model.messages import RawReply, RawRequest, Reply
from orchestrator.model.report import LeaseState


class AxisRequests(FleetRequests):
    """Acquire axes for manual control, and release them."""

    def manual_control(self, axes: Sequence[str], what: str = "manual control", ttl_s: float = 3.0) -> ManualControl:
        """Manual control of axes (groups, controllers) while the context lasts: nothing else moves them, and they can
        be jogged.

        async with tutti.manual_control(["gantry.x"], what="alignment") as manual:
            await manual.jog({"gantry.x": 5.0})

        what: shown to clients that are refused meanwhile. ttl_s: how long the axes stay acquired if this process dies.
        Entering raises `Refusal`: code `leased` while another holder has one of them, `permit` while one is missing.
        """
        return ManualControl(self, axes, what, ttl_s)

    async def reserve_axes(
        self, axes: Sequence[str], seconds: float, what: str = "manual work"
    ) -> tuple[list[str], str]:
        """Reserve axes (groups, controllers) for work at the machine, for `seconds` or until `release_axes`.

        Jobs that need them wait, other holders are refused. Returns all reserved axes, and the holder. Raises
        `Refusal`: code `leased`.
        """
        holder = f"manual-{self.new_id()}"
        request = AcquireAxes(
            **self.request_fields(), axes=list(axes), holder=holder, what=what, ttl_s=seconds, reserve=True
        )
        return (await self.request_service("acquire-axes", request, AxesAcquired)).axes, holder

    async def release_axes(self, holder: str) -> None:
        """Release all axes of a manual `holder`. Raises `Refusal`."""
        await self.request_service("release-axes", ReleaseAxes(**self.request_fields(), holder=holder), Reply)

    async def list_leases(self) -> list[LeaseState]:
        """The lease of each controller; where several holders have its axes, one of them."""
        replies = await self.bus.request_all(self.keys.leases, b"", ANSWER_S)
        states = [LeaseState.read_message(payload) for payload in replies.values()]
        return sorted(states, key=lambda state: state.controller)

    async def send_raw(self, controller: str, command: str, *, i_know: bool) -> str:
        """Send a command in the controller's own language, with all its axes acquired meanwhile. Raises `Refusal`.

        i_know: must be True, because no limit is checked.
        """
        async with self.manual_control([controller], what="raw command") as manual:
            request = RawRequest(**self.request_fields(), holder=manual.holder, command=command, i_know=i_know)
            return (await self.request_controller(controller, "raw", request, RawReply)).reply
