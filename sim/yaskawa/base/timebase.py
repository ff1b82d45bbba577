"""The servo clock: samples of the controller's own time against true time (`TM`, `TIME`; L10613-L10760).

An external sample clock (`TM` negative; SMC-2000: L975, L12003) is another controller's, over a wire; without a
wire, or while that controller is off, there are no samples: time stands still.
"""

from collections.abc import Callable

from orchestrator.clock.base import Clock
from sim.core.oscillator import Oscillator

TIME_WRAP = 1 << 31
NEVER_NS = 1 << 62
NOMINAL_US = 1000
# After a longer delay, a process continues from its present position. A busy machine delays one of many by a tenth of a
# second.
MAX_DELAY_NS = 250_000_000


class ServoTimebase:
    """Counts servo samples since power-up in device time; one lasts TM/1024 ms, 976.5625 us at TM 1000.

    Ticks are samples that no reset restarts, so that controllers on a shared clock agree on them.
    """

    def __init__(self, clock: Clock, oscillator: Oscillator) -> None:
        self.clock = clock
        self.oscillator = oscillator
        self.period_us = NOMINAL_US
        """Value of `TM`; negative for an external clock."""
        self.running = True
        self._own = True
        self._event_ns: int | None = None
        """True instant of the event being processed; None for an event from outside."""
        self._latest_ns = 0
        self._cached_ns = -1
        """True time for which `_cached_sample` was computed: it is read many times within one instant."""
        self._cached_sample = 0
        self._base_ns = self.device_ns()
        self._base_tick = 0
        self._zero_tick = 0
        self._source: ServoTimebase | None = None
        self._shift = 0
        self.joined = False
        """Whether ticks are related to those of the wire; they stay so, as the source's ticks never jump."""
        self.followers: list[tuple[ServoTimebase, Callable[[], None]]] = []

    # Changes

    def reset_samples(self) -> None:
        """Power-up or reset: sample 0 is now, on the own clock."""
        tick = self.current_tick()
        self._cached_ns = -1
        self.running = self._own = True
        self.period_us = NOMINAL_US
        self._base_ns, self._base_tick = self.device_ns(), tick + 1
        self._zero_tick = tick + 1
        self._notify_followers()

    def halt_samples(self) -> None:
        """Power loss: no more samples, here and on the wire."""
        self._base_tick = self.current_tick()
        for follower, _ in self.followers:
            follower.freeze_samples()
        self.running = self._own = False
        self._cached_ns = -1
        self._notify_followers()

    def set_period(self, period_us: int) -> None:
        """`TM`: later samples last `period_us` nominal microseconds; counting continues from the present one.

        Negative: later samples are those of the wire.
        """
        tick = self.current_tick()
        if period_us > 0:
            self._base_ns = self._tick_device_ns(tick) if self.period_us > 0 else self.device_ns()
        self._base_tick = tick
        self._cached_ns = -1
        self.period_us = period_us
        self._own = self.running and period_us > 0
        self.joined = False
        self.join_source()
        self._notify_followers()

    def connect_source(self, source: "ServoTimebase", changed: Callable[[], None]) -> None:
        """Connect the sample clock of `source`; `changed` is called when its samples change their instants."""
        self._source = source
        source.followers.append((self, changed))
        self.join_source()

    def freeze_samples(self) -> None:
        """Freeze at the present sample when the wire becomes inactive."""
        if self.period_us < 0:
            self._base_tick = self.current_tick()

    def join_source(self) -> None:
        """Count from the present sample on with the wire, if it is active."""
        source = self._active_source
        if source is not None:
            self._shift, self.joined = self._base_tick - source.current_tick(), True

    def _notify_followers(self) -> None:
        for follower, on_change in self.followers:
            if follower.period_us < 0:
                if not follower.joined:
                    follower.join_source()
                on_change()

    @property
    def _active_source(self) -> "ServoTimebase | None":
        """Return the source of the present samples, None for the own clock or none."""
        source = self._source
        return source if self.period_us < 0 and source is not None and source.running else None

    @property
    def is_frozen(self) -> bool:
        """Return whether there are no samples."""
        if self._own:
            return False
        return not self.running or (
            self.period_us < 0 and (self._active_source is None or self._active_source.is_frozen)
        )

    # Reading

    def device_ns(self) -> int:
        return self.oscillator.device_ns(self.now_ns())

    def current_tick(self) -> int:
        """Present tick."""
        if self._own:
            return self._base_tick + (self.device_ns() - self._base_ns) * 16 // (15625 * self.period_us)
        source = self._active_source
        return self._base_tick if source is None else source.current_tick() + self._shift

    def current_sample(self) -> int:
        """Present sample."""
        if not self._own:
            return self.current_tick() - self._zero_tick
        now_ns = self.now_ns()
        if now_ns != self._cached_ns:
            self._cached_ns, self._cached_sample = now_ns, self.current_tick() - self._zero_tick
        return self._cached_sample

    def current_instant(self) -> float:
        """Present time in samples, with fraction."""
        return self.tick_instant() - self._zero_tick

    def next_sample(self) -> int:
        """Return the first sample instant that is not past: a command given now takes effect there."""
        sample = self.current_sample()
        return sample if not self.is_frozen and self.true_ns(sample) >= self.now_ns() else sample + 1

    def true_ns(self, sample: int) -> int:
        """Return the true instant of a sample; `NEVER_NS` for a future one while there are none."""
        return self.tick_true_ns(sample + self._zero_tick)

    def after_ns(self, device_ns: int) -> int:
        """Return the true instant `device_ns` of device time from now."""
        return self.oscillator.true_ns(self.device_ns() + device_ns)

    def begin_event(self, due_ns: int) -> None:
        """Begin the processing of events that were due at the true instant `due_ns`; until `end_event` that is the
        present.

        Live, timers are late, as on any host, by up to some milliseconds. Earlier events count as processed when
        they were due, because a processor does not accumulate such delays, and no observer could see the time
        between; time never runs backward.
        """
        self.end_event()
        now_ns = self.clock.now_ns()
        self._event_ns = max(due_ns, self._latest_ns) if 0 < now_ns - due_ns < MAX_DELAY_NS else now_ns

    def end_event(self) -> None:
        """End the processing of the due events."""
        if self._event_ns is not None:
            self._latest_ns, self._event_ns = self._event_ns, None

    def now_ns(self) -> int:
        """Return the true instant at which the present event happens in the controller."""
        if self._event_ns is not None:
            return self._event_ns
        self._latest_ns = now_ns = self.clock.now_ns()
        return now_ns

    def sample_rate(self) -> float:
        """Return the samples per true second, at the oscillator's present rate."""
        if self.is_frozen:
            return 0.0
        source = self._active_source
        if source is not None:
            return source.sample_rate()
        now_ns = self.now_ns()
        rate = (self.oscillator.device_ns(now_ns + 1_000_000_000) - self.oscillator.device_ns(now_ns)) * 1e-9
        return rate * 1_024_000 / self.period_us

    def tick_instant(self) -> float:
        """Return the present time in ticks, with fraction."""
        if self._own:
            return self._base_tick + (self.device_ns() - self._base_ns) * 16 / (15625 * self.period_us)
        source = self._active_source
        return float(self._base_tick) if source is None else source.tick_instant() + self._shift

    def tick_true_ns(self, tick: int) -> int:
        """Return the true instant of a tick."""
        if self._own:
            return self.oscillator.true_ns(self._tick_device_ns(tick))
        source = self._active_source
        if source is None:
            return NEVER_NS if tick > self._base_tick else self.now_ns()
        return source.tick_true_ns(tick - self._shift)

    def _tick_device_ns(self, tick: int) -> int:
        return self._base_ns - (self._base_tick - tick) * 15625 * self.period_us // 16
