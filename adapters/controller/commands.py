"""Commands to a controller from the bus: each verb with its request, executed once, answered with a value."""

from collections.abc import Awaitable, Callable, Generator
from contextlib import contextmanager
from typing import Any

from pydantic import ValidationError

from adapters.abilities import LearningDriver, set_output
from adapters.controller.components import Components
from adapters.controller.manual.offsets import AxisOffsets
from adapters.controller.monitoring.settings_checks import SettingsChecks
from adapters.controller.search_commands import SearchCommands
from adapters.controller.slots.step_commands import StepCommands
from adapters.controller.slots.triggers import LatchControl
from adapters.controller.state.armed_step import StepPhase
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.last_work import LastWork
from adapters.controller.stops import ControllerStops
from orchestrator.bus.answers import AnswerCache
from orchestrator.bus.base import BusSample, RequestRefused
from orchestrator.bus.decoding import read_request
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import (
    AcceptEpoch,
    AdoptedReply,
    AdoptRequest,
    ArmedReply,
    ArmRequest,
    BeginSampling,
    CheckSettingsRequest,
    ChunkReply,
    CommitRequest,
    CommittedReply,
    ConfigureRequest,
    DisarmedReply,
    DisarmRequest,
    EnableRequest,
    FencedRequest,
    ForgetRequest,
    GoRequest,
    HomeReply,
    HomeRequest,
    JogRequest,
    LatchReply,
    LatchRequest,
    LeasedRequest,
    LeaseReply,
    LeaseRequest,
    LoadChunkRequest,
    OutputRequest,
    ProbeReply,
    ProbeRequest,
    Proposal,
    ProposeRequest,
    RawReply,
    RawRequest,
    RefusalDetails,
    ReleaseChunkRequest,
    Reply,
    Request,
    ResetRequest,
    RetargetReply,
    RetargetRequest,
    SamplesTaken,
    SamplingBegun,
    SetPositionRequest,
    SettingsChecked,
    StartAtOnceRequest,
    StartedReply,
    StopRequest,
    TakeSamples,
    TakeTriggers,
    TriggersTaken,
)
from orchestrator.model.problems import describe_first_error
from orchestrator.model.version import PartVersion, require_version


class ControllerCommands:
    """Answer `ctl/{id}/cmd/*` for one controller."""

    def __init__(self, context: ControllerContext, components: Components, stops: ControllerStops) -> None:
        self._context, self._config, self._driver = context, context.config, context.driver
        self._components = components
        self._fence, self._status, self._publisher = components.fence, components.status, components.publisher
        self._stops = stops
        self._answers = AnswerCache()
        self._last_work = LastWork()
        searches = SearchCommands(components, stops, context.clock, self._require_idle)
        latches = LatchControl(context, self._require_idle)
        checks = SettingsChecks(components.surveillance, components.polling, components.publisher, self._require_idle)
        steps = StepCommands(context, components.fence, components.participant, components.steps, components.timer)
        offsets = AxisOffsets(components.status, components.remembered, components.publisher, self._require_idle)
        # verb: (request, reply, handler)
        self._verbs: dict[str, tuple[type[Request], type[Reply], Callable[[Any], Awaitable[Reply]]]] = {
            "adopt": (AdoptRequest, AdoptedReply, self._handle_adopt),
            "lease": (LeaseRequest, LeaseReply, self._handle_lease),
            "propose": (ProposeRequest, Proposal, components.participant.propose_step),
            "arm": (ArmRequest, ArmedReply, components.participant.arm_step),
            "commit": (CommitRequest, CommittedReply, steps.commit_step),
            "go": (GoRequest, Reply, steps.start_step),
            "start-at-once": (StartAtOnceRequest, StartedReply, steps.start_at_once),
            "load-chunk": (LoadChunkRequest, ChunkReply, components.chunks.load),
            "release-chunk": (ReleaseChunkRequest, Reply, components.chunks.release),
            "retarget": (RetargetRequest, RetargetReply, components.retargets.retarget),
            "disarm": (DisarmRequest, DisarmedReply, components.withdrawal.disarm_step),
            "stop": (StopRequest, Reply, self._handle_stop),
            "enable": (EnableRequest, Reply, self._handle_enable),
            "check-settings": (CheckSettingsRequest, SettingsChecked, checks.check_settings),
            "home": (HomeRequest, HomeReply, searches.home),
            "jog": (JogRequest, Reply, self._handle_jog),
            "set-position": (SetPositionRequest, Reply, offsets.set_position),
            "output": (OutputRequest, Reply, self._handle_output),
            "begin-sampling": (BeginSampling, SamplingBegun, components.samples.begin),
            "take-samples": (TakeSamples, SamplesTaken, components.samples.take),
            "take-triggers": (TakeTriggers, TriggersTaken, components.triggers.take),
            "probe": (ProbeRequest, ProbeReply, searches.probe),
            "latch": (LatchRequest, LatchReply, latches.latch),
            "reset": (ResetRequest, Reply, self._handle_reset),
            "configure": (ConfigureRequest, Reply, self._handle_configure),
            "raw": (RawRequest, RawReply, self._handle_raw),
            "accept-epoch": (AcceptEpoch, Reply, self._handle_accept_epoch),
            "forget": (ForgetRequest, Reply, self._handle_forget),
        }

    async def answer_command(self, sample: BusSample) -> bytes:
        """Answer one command. A repeated request id gets the same reply without a second execution."""
        verb = self._context.keys.verb_of(sample.key)
        if verb not in self._verbs:
            raise RequestRefused(f"unknown verb {verb!r}; known: {', '.join(sorted(self._verbs))}")
        model, reply, handler = self._verbs[verb]
        request = read_request(model, sample, f"{verb}: ")
        return await self._answers.answer_once(
            verb, request, sample.payload, lambda: self._execute_request(verb, reply, handler, request)
        )

    async def _execute_request(
        self, verb: str, reply: type[Reply], handler: Callable[[Any], Awaitable[Reply]], request: Request
    ) -> bytes:
        try:
            if isinstance(request, FencedRequest) and not isinstance(request, AdoptRequest):
                await self._fence.require_current_leader(request)
                self._last_work.note_request(verb, request)
            return (await handler(request)).to_json()
        except Refusal as error:
            refusal = RefusalDetails.of(error)
        except ControllerFault as error:
            refusal = RefusalDetails(code=error.code, text=error.text, remedy=error.remedy)
        except (LinkClosed, LinkRefused) as error:
            refusal = RefusalDetails(code="offline", text=str(error), remedy="check power and cable of the controller")
        except OSError as error:
            text = f"the memory of {self._context.controller} cannot be saved: {error}"
            refusal = RefusalDetails(code="disk", text=text, remedy="check the disk of its adapter host, and try again")
        except Exception as error:
            fault = self._components.tasks.handle_defect(error)
            refusal = RefusalDetails(code=fault.code, text=fault.text, remedy=fault.remedy)
        self._publisher.emit_event("refusal", f"{verb} by {request.actor}: {refusal.text}")
        return reply(refused=refusal.model_copy(update={"member": self._context.controller})).to_json()

    async def _handle_adopt(self, request: AdoptRequest) -> AdoptedReply:
        leader = request.leader
        if (leader.epoch, leader.coordinator) != (request.epoch, request.coordinator):
            raise Refusal("bad-request", "the heartbeat in an adoption must be that of the adopting coordinator", "")
        version = PartVersion(leader.tutti, leader.protocol)
        require_version(version, f"coordinator {leader.coordinator[:8]}", "this adapter host")
        fresh = await self._fence.adopt_leader(request)
        self._context.follow_leader(self._context.controller, leader)
        if fresh:
            self._components.leases.end_all(f"new leader, epoch {request.epoch}")
            await self._components.withdrawal.abandon_step(f"new leader, epoch {request.epoch}")
        self._publisher.publish_state()
        work, mode = self._last_work, self._publisher.current_mode()
        return AdoptedReply(epoch=self._fence.epoch, mode=mode, last_job=work.job, last_step=work.step)

    async def _handle_accept_epoch(self, request: AcceptEpoch) -> Reply:
        """Only at rest: until the leader adopts the controller, nothing can be started, and jogs have ended."""
        status = self._status
        self._require_no_step()
        moving_axes = [
            name for name, axis in status.require_online().axes.items() if axis.moving or name in status.searching
        ]
        if moving_axes or status.jogging:
            name = min([*moving_axes, *status.jogging])
            raise Refusal("moving", f"axis {name} is moving", "wait for the end of the motion, then repeat")
        await self._fence.accept_epoch(request)
        self._components.leases.end_all(f"the epoch was repaired by {request.actor}")
        self._publisher.emit_event("reset", f"epoch {request.epoch} accepted by order of {request.actor}")
        self._publisher.publish_state()
        return Reply()

    async def _handle_stop(self, request: StopRequest) -> Reply:
        reason = request.reason or f"stopped by {request.actor}"
        await self._stops.stop(abort=request.mode == "abort", reason=reason, follow=request.mode == "feed-hold")
        return Reply()

    async def _handle_lease(self, request: LeaseRequest) -> LeaseReply:
        self._status.require_known(request.axes)
        old_holders = self._components.leases.holders
        kept_axes = self._components.leases.apply_request(request)
        # The requester gets the state at once, others with the next poll or heartbeat; not at each renewal.
        is_changed = self._components.leases.holders != old_holders
        return LeaseReply(state=self._publisher.answer_state() if is_changed else None, kept=kept_axes)

    async def _handle_enable(self, request: EnableRequest) -> Reply:
        self._require_idle(request)
        if request.on:
            self._fence.require_no_estop()
        with self._ordering():
            await self._components.motors.switch_motors(request.axes, on=request.on)
        return Reply()

    async def _handle_jog(self, request: JogRequest) -> Reply:
        self._status.require_known(request.velocities)
        self._components.leases.require_lease(request.holder, request.velocities)
        self._components.leases.require_groups(request.velocities, request.groups)
        self._components.jogging.check_sequence(request)
        if any(request.velocities.values()):
            self._fence.require_no_estop()
            self._status.require_no_fault()
            self._require_no_step()
        with self._ordering():
            await self._components.jogging.apply_request(request)
        return Reply()

    async def _handle_output(self, request: OutputRequest) -> Reply:
        point = self._config.outputs.get(request.output)
        if point is None:
            output_names = ", ".join(self._config.outputs) or "none"
            raise Refusal("unknown-output", f"no output {request.output}; outputs: {output_names}")
        self._status.require_online()
        await set_output(self._driver, point.number, on=request.value == (point.active == "high"))
        await self._components.polling.poll_and_publish()
        return Reply()

    async def _handle_reset(self, request: ResetRequest) -> Reply:
        """Reset the e-stop latch. With `check`, only report whether that is possible; all adapters are checked before
        the first latch is reset."""
        self._fence.require_event(request.event)
        await self._require_safe()
        if not request.check:
            if await self._fence.reset_latch():
                self._publisher.emit_event("reset", f"e-stop reset by {request.actor}")
            self._publisher.publish_state()
        return Reply()

    async def _require_safe(self) -> None:
        """Clear what can be cleared, and verify that nothing prevents motion. Raises `Refusal`."""
        status = self._status
        status.require_online()
        armed_step = self._components.steps.present
        if armed_step is not None and armed_step.phase is not StepPhase.MOVING:
            # The commands that clear faults would run before the start command, and delay it.
            raise Refusal(
                "busy",
                f"the controller is about to move for job {armed_step.job}",
                "wait for the end of the step, then reset",
            )
        status.ordered_ns = self._context.clock.now_ns()
        await self._driver.clear_faults()
        await self._components.surveillance.recheck_settings()
        await self._components.polling.poll_and_publish()
        status.require_no_fault()
        moving_axes = [name for name, axis in status.require_online().axes.items() if axis.moving]
        if moving_axes:
            raise Refusal("moving", f"axis {moving_axes[0]} is moving", "wait for the end of the motion, then reset")

    async def _handle_configure(self, request: ConfigureRequest) -> Reply:
        self._require_no_step()
        if self._components.leases.holders:
            holder = next(iter(self._components.leases.holders.values()))
            raise Refusal("leased", f"axes of the controller are leased to {holder}", "wait for the end of the lease")
        try:
            config = Controller.model_validate(request.configuration)
            self._context.make.options_model.model_validate(config.options)
            self._context.make.check_config(config)
        except ValidationError as error:
            raise Refusal(
                "bad-configuration", describe_first_error(error, "payload"), "correct the fleet file"
            ) from None
        except ValueError as error:
            raise Refusal("bad-configuration", str(error), "correct the fleet file") from None
        if not request.check:
            self._context.replace_supervisor(self._context.controller, config)
        return Reply()

    async def _handle_raw(self, request: RawRequest) -> RawReply:
        if not request.i_know:
            text = "a raw command is not checked against any limit"
            raise Refusal("raw-needs-flag", text, "add --i-know to send it anyway")
        self._components.leases.require_lease(request.holder, self._config.axes)
        self._status.require_online()
        self._publisher.emit_event("raw", f"raw by {request.actor}: {request.command!r}")
        return RawReply(reply=await self._driver.send_raw(request.command))

    async def _handle_forget(self, request: ForgetRequest) -> Reply:
        """Forget learned bounds: not while a step is loaded, whose budget they are a part of."""
        self._require_no_step()
        if isinstance(self._driver, LearningDriver):
            self._driver.forget_starts()
        self._publisher.emit_event("setting", f"learned bounds of its starts are forgotten, by {request.actor}")
        return Reply()

    @contextmanager
    def _ordering(self) -> Generator[None]:
        """Note at the end of the block, however it ends, that it may have changed positions by an order."""
        try:
            yield
        finally:
            self._status.ordered_ns = self._context.clock.now_ns()

    def _require_idle(self, request: LeasedRequest) -> None:
        self._status.require_online()
        self._status.require_known(request.axes)
        self._components.leases.require_lease(request.holder, request.axes)
        self._require_no_step()
        if self._status.jogging:
            raise Refusal("busy", f"axis {min(self._status.jogging)} is jogging", "end the jog first")

    def _require_no_step(self) -> None:
        if self._components.steps.present is not None or self._status.searching:
            raise Refusal(
                "busy",
                f"the controller is {self._publisher.current_mode()}",
                "wait for the end, or stop the controller",
            )
