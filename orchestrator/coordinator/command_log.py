"""The commands of users in the journal: by which user, when, what, and whether it was refused."""

from contextlib import suppress
from dataclasses import dataclass

from orchestrator.bus.service_verbs import SERVICE_VERBS
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.model.base import Model, UnknownName
from orchestrator.model.jobs.service import AcquireAxes, FleetReloaded, JobSubmitted, ReleaseAxes, RetryJob
from orchestrator.model.messages import Request
from orchestrator.model.operation.commands import CommandRecord, CommandsListed, ListCommands

MAX_SUBJECT = 200  # characters


@dataclass(frozen=True, slots=True)
class _Command:
    """A command that is being executed."""

    actor: str
    verb: str
    subject: str


class CommandLog:
    """Records commands in the journal, and lists them."""

    def __init__(self, services: JobServices) -> None:
        self._services = services

    def describe_command(self, verb: str, request: Request) -> _Command | None:
        """What is to be recorded of a request, before it is executed; None for one that changes nothing."""
        if isinstance(request, RetryJob) and request.dry_run:
            return None
        if isinstance(request, AcquireAxes) and self._is_renewal(request):
            return None
        if not SERVICE_VERBS[verb].logged:
            return None
        subject = SERVICE_VERBS[verb].subject(request)
        if isinstance(request, ReleaseAxes):
            subject = " ".join(self._find_leased(request.holder)) or request.holder
        return _Command(request.actor, verb, subject)

    async def record_command(self, command: _Command, reply: Model, refused: str) -> None:
        """Record a command that was executed, or refused with a code. A journal that cannot be written is logged: what
        was done is done."""
        services, subject = self._services, command.subject
        if isinstance(reply, JobSubmitted) and reply.job_id:
            subject = f"{reply.job_id} {subject}"
        if isinstance(reply, FleetReloaded):
            subject = " ".join(reply.changed)
        if len(subject) > MAX_SUBJECT:
            subject = f"{subject[: MAX_SUBJECT - 1]}…"
        record = CommandRecord(
            utc=services.clock.utc(), actor=command.actor, verb=command.verb, subject=subject, refused=refused
        )

        def log_error(error: JournalError) -> None:
            services.log.warning(f"{command.verb} by {command.actor} is not in the journal: {error}")

        store = services.journal.commands.store_command
        if isinstance(reply, JobSubmitted) and reply.job_id:
            # The job is in the journal, with the user and the time.
            services.record_later(log_error, store, record)
            return
        try:
            await services.execute(store, record)
        except JournalError as error:
            log_error(error)

    async def list_commands(self, request: ListCommands) -> CommandsListed:
        """The newest commands. Raises `JournalError`."""
        load = self._services.journal.commands.list_commands
        return CommandsListed(commands=await self._services.execute(load, request.limit, request.before, request.by))

    def _is_renewal(self, request: AcquireAxes) -> bool:
        """Whether the holder has these axes already."""
        leased_axes = self._find_leased(request.holder)
        with suppress(UnknownName):
            return bool(leased_axes) and set(self._services.view.fleet.expand_names(request.axes)) <= set(leased_axes)
        return False

    def _find_leased(self, holder: str) -> tuple[str, ...]:
        return next(
            (held_lease.axes for held_lease in self._services.leases.all_leases if held_lease.holder == holder), ()
        )
