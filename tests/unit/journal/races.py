"""Coordinators that race for one database: before each statement a seeded draw says which of them goes on.

Each runs in a thread of its own, and waits at a barrier in its client before it sends anything. It goes on alone until it
waits there again, has ended, or waits for a lock on the server.
"""

import threading
from collections.abc import Callable, Sequence
from random import Random
from typing import Any

from orchestrator.coordinator.journal.facts import StepDecision
from orchestrator.coordinator.journal.postgres.errors import ConnectionLost
from orchestrator.coordinator.journal.postgres.journal import PostgresJournal
from orchestrator.coordinator.journal.postgres.session import Session, Statement
from orchestrator.coordinator.journal.records import EpochOvertaken, UnknownResult

LONGEST_S = 30.0  # of one wait; only a defect takes as long
LOOK_S = 0.005  # between looks whether one waits for a lock


class Racer(threading.Thread):
    """A coordinator with its actions: it writes a decision, which states its epoch, or takes over."""

    def __init__(self, journal: PostgresJournal, actions: Sequence[str], changed: threading.Condition) -> None:
        super().__init__(daemon=True)
        self.session = journal.database.session
        self.is_waiting = False
        self.has_ended = False
        self.refused = self.ended = 0
        self.defect: BaseException | None = None
        self._journal = journal
        self._actions = actions
        self._may_go = False
        self._changed = changed

    def run(self) -> None:
        try:
            for action in self._actions:
                self._act(action)
        except BaseException as error:
            self.defect = error
        with self._changed:
            self.has_ended = True
            self._changed.notify_all()

    def _act(self, action: str) -> None:
        try:
            if action == "take over":
                self._journal.take_epoch(0)
            else:
                decision = StepDecision(0, self._journal.database.epoch, 1, "c")
                self._journal.record_decision("job", decision, "")
        except EpochOvertaken:
            self.refused += 1
        except (ConnectionLost, UnknownResult):
            self.ended += 1  # its session was ended, in the middle or in the commit

    def wait_for_turn(self) -> None:
        with self._changed:
            self.is_waiting = True
            self._changed.notify_all()
            assert self._changed.wait_for(lambda: self._may_go, LONGEST_S)
            self._may_go = False

    def go_on(self) -> None:
        """Let it send what it has. Called with the condition."""
        self.is_waiting, self._may_go = False, True
        self._changed.notify_all()


class Race:
    """Rounds of coordinators on one database. is_blocked: says whether a process of the server waits for a lock."""

    def __init__(self, journals: Sequence[PostgresJournal], is_blocked: Callable[[int], bool]) -> None:
        self._journals = journals
        self._is_blocked = is_blocked
        self._run = Session._run
        self.refused = self.ended = 0

    def send(self, session: Session, connection: Any, statements: Sequence[Statement]) -> Any:
        """What stands for `Session._run`."""
        racer = threading.current_thread()
        if isinstance(racer, Racer):
            racer.wait_for_turn()
        return self._run(session, connection, statements)

    def run_round(self, draw: Random) -> None:
        changed = threading.Condition()
        racers = [Racer(journal, _draw_actions(draw), changed) for journal in self._journals]
        with changed:
            for racer in racers:
                racer.start()
                self._wait_for_stop(racer, changed)
            while not all(racer.has_ended for racer in racers):
                waiting = [racer for racer in racers if racer.is_waiting]
                if waiting:
                    chosen = draw.choice(waiting)
                    chosen.go_on()
                    self._wait_for_stop(chosen, changed)
                else:
                    changed.wait(LOOK_S)  # all that go on wait for locks, which end with a deadline at the latest
        for racer in racers:
            racer.join(LONGEST_S)
            self.refused += racer.refused
            self.ended += racer.ended
            if racer.defect is not None:
                raise racer.defect

    def _wait_for_stop(self, racer: Racer, changed: threading.Condition) -> None:
        while not changed.wait_for(lambda: racer.is_waiting or racer.has_ended, LOOK_S):
            backend = racer.session._backend
            if backend is not None and self._is_blocked(backend[0]):
                return


def _draw_actions(draw: Random) -> list[str]:
    return [draw.choice(("write", "write", "take over")) for _ in range(draw.randint(1, 4))]
