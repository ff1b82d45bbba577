"""The sections `alarms` and `notify` of a fleet file: what raises an alarm, and which command is run for it."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from orchestrator.model.base import Model
from orchestrator.model.numbers import Duration, Part

AlarmPriority = Literal["high", "medium", "low"]
NS_PER_S = 1_000_000_000
MINUTE_NS = 60 * NS_PER_S
MAX_WORDS, MAX_WORD = 64, 1_000  # of a command
_Count = Annotated[int, Field(ge=1, le=100_000)]


class AlarmRule(Model):
    """When one kind of alarm is raised, and when it returns."""

    enabled: bool = True
    priority: AlarmPriority = "high"
    for_: Duration = Field(default=0, alias="for", description="How long its condition must hold before it is raised.")
    return_after: Duration = Field(
        default=5 * NS_PER_S, description="How long its condition must be gone before it returns."
    )


class DisconnectionRule(AlarmRule):
    """A controller is offline, or its adapter is silent."""

    for_: Duration = Field(
        default=10 * NS_PER_S, alias="for", description="How long it must be offline before it is raised."
    )


class EstopRule(AlarmRule):
    """An e-stop is latched."""

    return_after: Duration = Field(default=0, description="How long it must be reset before the alarm returns.")


class LimitRule(AlarmRule):
    """A referenced axis reaches a limit switch, and is not homing."""

    priority: AlarmPriority = "medium"


class ClockRule(AlarmRule):
    """The bound of a controller's clock has grown."""

    priority: AlarmPriority = "low"
    for_: Duration = Field(
        default=MINUTE_NS, alias="for", description="How long it must be above the limit before it is raised."
    )
    limit: Duration = Field(default=5_000_000, gt=0, description="The bound above which it is raised.")


class BudgetRule(AlarmRule):
    """Steps of the same controllers use much of their allowed start skew, one after the other."""

    priority: AlarmPriority = "medium"
    limit: Part = Field(default=0.8, description="The fraction of the allowed start skew above which a step counts.")
    steps: _Count = Field(default=10, description="How many steps in succession raise it.")


class LinkRule(AlarmRule):
    """The link of a controller breaks often."""

    priority: AlarmPriority = "low"
    limit: _Count = Field(default=5, description="How many breaks raise it.")
    within: Duration = Field(default=10 * MINUTE_NS, gt=0, description="The time in which they are counted.")


class DiskRule(AlarmRule):
    """The journal cannot be written, or its disk has little space."""

    limit_mb: int = Field(default=200, ge=1, le=10_000_000, description="The free space below which it is raised, MB.")


class FollowingRule(AlarmRule):
    """The following error of an axis grows from move to move."""

    priority: AlarmPriority = "medium"
    growth: float = Field(
        default=2.0, gt=1, le=1000, description="How many times its earlier mean raises it, at the same speed."
    )
    moves: int = Field(default=10, ge=2, le=1000, description="The number of last moves that are compared.")
    limit: Part = Field(
        default=0.5, description="The fraction of the axis's `following_error` above which it is raised."
    )


class LeaderRule(AlarmRule):
    """Another process claims the leadership, or answers where only one may."""

    return_after: Duration = Field(
        default=MINUTE_NS, description="How long nothing of it must have been received before it returns."
    )


class UnknownRule(AlarmRule):
    """Controllers that the fleet file does not have publish states: one alarm, with their number and the last."""

    priority: AlarmPriority = "medium"
    for_: Duration = Field(default=NS_PER_S, alias="for", description="Those that come within it are counted.")


class NoticeRule(AlarmRule):
    """The command of `notify` fails again and again."""

    priority: AlarmPriority = "medium"
    limit: _Count = Field(default=3, description="How many failures in succession raise it.")


class AlarmRules(Model):
    """The rules for all kinds of alarms."""

    disconnected: DisconnectionRule = Field(default_factory=DisconnectionRule)
    fault: AlarmRule = Field(
        default_factory=AlarmRule, description="A controller reports a fault; one alarm for each code."
    )
    estop: EstopRule = Field(default_factory=EstopRule)
    limit_switch: LimitRule = Field(default_factory=LimitRule)
    racked: AlarmRule = Field(
        default_factory=AlarmRule, description="The axes of a pair are farther apart than `max_deviation`."
    )
    zone: AlarmRule = Field(
        default_factory=AlarmRule, description="Bodies are nearer to each other than a rule of `zones` allows."
    )
    clock_bound: ClockRule = Field(default_factory=ClockRule)
    budget: BudgetRule = Field(default_factory=BudgetRule)
    link_errors: LinkRule = Field(default_factory=LinkRule)
    disk: DiskRule = Field(default_factory=DiskRule)
    following_error: FollowingRule = Field(default_factory=FollowingRule)
    second_leader: LeaderRule = Field(default_factory=LeaderRule)
    double_answer: LeaderRule = Field(default_factory=LeaderRule)
    unknown_controller: UnknownRule = Field(default_factory=UnknownRule)
    notify: NoticeRule = Field(default_factory=NoticeRule)
    other: AlarmRule = Field(
        default_factory=AlarmRule, description="Alarms of other processes; each of them states its priority."
    )


class NotifyCommand(Model):
    """A command that is run for each alarm, with the alarm as JSON on its standard input, and in variables of its
    environment (`TUTTI_ALARM_…`)."""

    command: list[Annotated[str, Field(max_length=MAX_WORD)]] = Field(
        min_length=1, max_length=MAX_WORDS, description="The program and its arguments; no shell is involved."
    )
    priorities: list[AlarmPriority] = Field(
        default=["high", "medium", "low"], min_length=1, description="The priorities of the alarms that it is run for."
    )
    timeout: Duration = Field(
        default=30 * NS_PER_S, gt=0, description="A command that takes longer is killed, and run again later."
    )
    tries: int = Field(default=20, ge=1, le=1000, description="How often it is tried for one alarm.")
    pause: Duration = Field(
        default=10 * NS_PER_S, gt=0, description="Before the second try; doubled from try to try, up to 15 min."
    )

    @field_validator("command")
    @classmethod
    def _check_program(cls, command: list[str]) -> list[str]:
        if not command[0].strip():
            raise ValueError('the program is empty; write e.g. ["/usr/local/bin/page", "--to", "lab"]')
        if any("\0" in word for word in command):
            raise ValueError("a word of the command has a NUL character; remove it")
        return command
