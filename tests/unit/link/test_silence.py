"""How a guardian counts the silence of its child."""

from adapters.host.guardian import LONGEST_CHECK_NS, SilenceTimer
from orchestrator.clock.base import NS_PER_MS


def test_silence_is_counted_from_the_last_beat() -> None:
    silence = SilenceTimer(0)
    for at_ms in (20, 40, 60):
        silence.record_check(at_ms * NS_PER_MS, heartbeat_seen=False)
    assert silence.lasted_ns == 60 * NS_PER_MS
    silence.record_check(80 * NS_PER_MS, heartbeat_seen=True)
    assert silence.lasted_ns == 0


def test_a_machine_that_stood_still_is_no_silence_of_the_child() -> None:
    silence = SilenceTimer(0)
    silence.record_check(10_000 * NS_PER_MS, heartbeat_seen=False)
    assert silence.lasted_ns == LONGEST_CHECK_NS
