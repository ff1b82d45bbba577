"""Writes received messages to recordings: one file a job, one that rotates for the rest. In a thread of its own."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.model.base import Model
from orchestrator.model.messages import LeaderHeartbeat
from orchestrator.model.operation.recording import JobBegun, MessagesDropped, WallClockStepped
from orchestrator.model.report import JobReport
from orchestrator.model.state import ClockMapping, ControllerEvent, ControllerState
from orchestrator.monitor.recording.channels import Channel, find_channel, own_key, parse_message
from orchestrator.monitor.recording.folder import FLEET, OpenRecording, RecordingFolder
from orchestrator.monitor.recording.instants import FleetScale
from orchestrator.monitor.recording.jobs import JobTracker

LINGER_NS = 2 * NS_PER_S  # for what still comes after a job's end
MAX_KEYS_COUNTED = 500  # in one account of dropped messages
REFUSED = "the disk takes no data"
FULL = "the quota is used up by running jobs"


class ReceivedMessage(NamedTuple):
    """A message as it came from the bus, and when: an instant of this host, ns."""

    key: str
    payload: bytes
    received_ns: int


class _Entry(NamedTuple):
    """A message to be written. fleet_ns: its publisher's own instant; None: none."""

    channel: Channel
    received: ReceivedMessage
    fleet_ns: int | None = None
    valid: bool = True


class RecordingWriter:
    """Writes the messages of one fleet to the recordings of `folder`. All instants are of this host.

    fleet_file: attached to every recording; None: not known here. written, dropped, invalid: numbers of messages;
    together, the first two are all that have come.
    """

    def __init__(self, folder: RecordingFolder, fleet: str, clock: Clock, fleet_file: Path | None = None) -> None:
        self.written = 0
        self.dropped = 0
        self.invalid = 0
        self.on_message: Callable[[Channel, Model], None] = lambda channel, message: None
        """Receives every valid message, in the writer's thread, before it is written."""
        self._folder, self._fleet, self._clock = folder, fleet, clock
        self._folder.on_lost = self._count_lost
        self._fleet_file, self._fleet_text = fleet_file, b""
        self._jobs = JobTracker()
        self._scale = FleetScale(clock.kernel_id)
        self._mappings: dict[str, ClockMapping] = {}
        self._last_leader: LeaderHeartbeat | None = None
        self._drops: dict[str, Counter[str]] = {}
        self._unsafe_drops: dict[str, Counter[str]] = {}
        """Accounts that are recorded, and not on the disk yet."""

    def write_messages(self, messages: Iterable[ReceivedMessage]) -> None:
        """Write messages in the order in which they were received. Raises nothing."""
        for message in messages:
            channel = find_channel(message.key)
            if channel.is_recorded:
                self._write_message(channel, message)

    def count_drops(self, reason: str, drops: "Counter[str]") -> None:
        """Messages were left out. Their account is recorded as soon as that is possible."""
        self.dropped += drops.total()
        self._add_to_account(reason, drops)

    def keep_house(self) -> None:
        """Close the chunks of all files, end those of finished jobs, rotate, keep the quota: about once a second.
        Raises nothing."""
        self._record_drops()
        self._note_wall_clock()
        self._attach_changed_fleet()
        self._folder.close_chunks()
        if FLEET in self._folder.open:
            self._unsafe_drops.clear()
        self._end_finished_jobs()
        if self._folder.must_rotate():
            self._end_recording(FLEET)
        self._folder.keep_quota()

    def close(self) -> None:
        """End all recordings. Raises nothing."""
        self._record_drops()
        for name in list(self._folder.open):
            self._end_recording(name)

    # Messages

    def _write_message(self, channel: Channel, received: ReceivedMessage) -> None:
        try:
            message = parse_message(channel, received.payload)
        except ValueError:
            self.invalid += 1
            self._write_or_count(self._jobs.find_jobs(channel, None), _Entry(channel, received, valid=False))
            return
        if message is not None:
            self.on_message(channel, message)
        if isinstance(message, LeaderHeartbeat) and not self._is_news(message):
            return
        instant_ns = _find_own_instant(message)
        if instant_ns is not None:
            self._scale.take_message(instant_ns, received.received_ns)
        starts = self._jobs.take_message(message, received.payload)
        self._write_or_count(self._jobs.find_jobs(channel, message), _Entry(channel, received, instant_ns))
        self._attach_message(message, received)
        for start in starts:
            at_ns = None if start.start is None else start.start.earliest_ns
            self._write_or_count([start.job_id], self._make_entry("step-start", start, received.received_ns, at_ns))

    def _make_entry(self, leaf: str, message: Model, at_ns: int, fleet_ns: int | None = None) -> _Entry:
        """A message that the recorder itself adds."""
        key = own_key(self._fleet, leaf)
        return _Entry(find_channel(key), ReceivedMessage(key, message.to_json(), at_ns), fleet_ns)

    def _is_news(self, heartbeat: LeaderHeartbeat) -> bool:
        """Whether a heartbeat differs from the last one in more than its number and time."""
        last, self._last_leader = self._last_leader, heartbeat
        self._scale.take_heartbeat(heartbeat)
        exclusions = {"seq", "utc"}
        return last is None or last.model_dump(exclude=exclusions) != heartbeat.model_dump(exclude=exclusions)

    def _write_or_count(self, jobs: Sequence[str], entry: _Entry) -> None:
        """Write a message to the recordings of jobs, or to that of the fleet; count it if it is left out."""
        reason = self._write_to(jobs or [FLEET], entry)
        if reason:
            self.count_drops(reason, Counter({entry.channel.key: 1}))

    def _write_to(self, recordings: Sequence[str], entry: _Entry) -> str:
        """Write a message to recordings; return why it is in none of them, or an empty text."""
        if self._folder.is_full and entry.channel.is_replaced:
            return FULL
        received_message = entry.received
        host_ns = None if entry.fleet_ns is None else self._scale.host_ns(entry.fleet_ns)
        own_ns = received_message.received_ns if host_ns is None else host_ns
        has_mapping = False
        for name in recordings:
            recording = self._find_recording(name)
            if recording is None:
                continue
            scale, has_mapping = recording.scale, True
            times = max(0, scale.utc_ns(received_message.received_ns)), max(0, scale.utc_ns(own_ns))

            # What an error loses is counted with the rest of the file.
            self._folder.write_message(name, entry.channel, received_message.payload, times, valid=entry.valid)
        self.written += has_mapping
        return "" if has_mapping else REFUSED

    # Recordings

    def _find_recording(self, name: str) -> OpenRecording | None:
        """The open recording of a job, or of the fleet; it is begun with what explains it. None: the disk refuses."""
        recording = self._folder.open.get(name)
        if recording is None:
            recording = self._folder.begin_recording(name, self._jobs.running.get(name))
            if recording is not None:
                self._fleet_text = self._read_fleet_file() or self._fleet_text
                if self._fleet_text:
                    self._attach("fleet.json", name, self._fleet_text)
                self._attach_clocks(name)
        return recording

    def _attach_message(self, message: Model | None, received: ReceivedMessage) -> None:
        """What explains a recording is attached to it as well."""
        if isinstance(message, ClockMapping):
            self._mappings[message.controller] = message
        elif isinstance(message, JobBegun):
            self._attach("job.json", message.job_id, message.job.to_json())
        elif isinstance(message, JobReport):
            self._attach("report.json", message.job_id, received.payload)

    def _attach(self, name: str, recording: str, contents: bytes) -> None:
        found_recording = self._folder.open.get(recording)
        if found_recording is not None:
            at_ns = found_recording.scale.utc_ns(self._clock.now_ns())
            self._folder.write_safely(recording, lambda file: file.attach(name, contents, at_ns))

    def _attach_clocks(self, recording: str) -> None:
        texts = [f'"{name}":'.encode() + mapping.to_json() for name, mapping in self._mappings.items()]
        self._attach("clocks.json", recording, b"{" + b",".join(texts) + b"}")

    def _read_fleet_file(self) -> bytes:
        try:
            return b"" if self._fleet_file is None else self._fleet_file.read_bytes()
        except OSError:
            return b""

    def _end_recording(self, name: str) -> None:
        self._attach_clocks(name)
        if name in self._folder.open:
            self._folder.end_recording(name)

    # Once a second

    def _attach_changed_fleet(self) -> None:
        """The fleet file was replaced: every open recording gets the new one."""
        text = self._read_fleet_file()
        if text and text != self._fleet_text:
            self._fleet_text = text
            for name in list(self._folder.open):
                self._attach("fleet.json", name, text)

    def _end_finished_jobs(self) -> None:
        """End the recordings of jobs a while after their ends: what still comes belongs to them."""
        now_ns = self._clock.now_ns()
        for job in list(self._jobs.running.values()):
            recording = self._folder.open.get(job.job_id)
            if not job.is_over:
                if recording is not None:
                    recording.ended_ns = None
                continue
            if recording is not None and recording.ended_ns is None:
                recording.ended_ns = now_ns
            elif recording is None or now_ns - (recording.ended_ns or 0) >= LINGER_NS:
                if recording is not None:
                    self._end_recording(job.job_id)
                del self._jobs.running[job.job_id]

    def _note_wall_clock(self) -> None:
        """After the wall clock was set the fleet goes on in another file; recordings of jobs keep their scale."""
        fleet_recording = self._folder.open.get(FLEET)
        step_ns = 0 if fleet_recording is None else fleet_recording.scale.find_step_ns()
        if step_ns:
            note = WallClockStepped(by_ns=step_ns)
            self._write_to(list(self._folder.open), self._make_entry("clock-stepped", note, self._clock.now_ns()))
            if FLEET in self._folder.open:
                self._end_recording(FLEET)

    # What is left out

    def _add_to_account(self, reason: str, drops: "Counter[str]") -> None:
        account = self._drops.setdefault(reason, Counter())
        for key, count in drops.items():
            account[key if key in account or len(account) < MAX_KEYS_COUNTED else "others"] += count

    def _count_lost(self, lost: "Counter[str]") -> None:
        """A recording was given up: count what is not on the disk, and record accounts in it again."""
        self.written -= lost.total()
        lost.pop(own_key(self._fleet, "dropped"), None)
        self.count_drops(REFUSED, lost)
        for reason, account in self._unsafe_drops.items():
            self._add_to_account(reason, account)
        self._unsafe_drops.clear()

    def _record_drops(self) -> None:
        """Record what was left out, as soon as the disk takes data again."""
        while self._drops and not self._folder.refuses_now():
            reason, account = self._drops.popitem()
            note = MessagesDropped(reason=reason, total=account.total(), by_key=dict(account))
            if self._write_to([FLEET], self._make_entry("dropped", note, self._clock.now_ns())):
                self._drops[reason] = account
                return
            self._unsafe_drops.setdefault(reason, Counter()).update(account)


def _find_own_instant(message: Model | None) -> int | None:
    """The instant of fleet time that a message is about, by its publisher."""
    if isinstance(message, ControllerState):
        return message.fleet_ns if message.read_fleet_ns is None else message.read_fleet_ns
    return message.fleet_ns if isinstance(message, ControllerEvent) else None
