"""The servo clock: samples of the controller's own time against true time (`TM`, `TIME`; L10613-L10760).

An external sample clock (`TM` negative; SMC-2000: L975, L12003) is another unit's, over a wire; without a wire, or
while that unit is off, there are no samples: time stands still.
"""

from collections.abc import Callable

from orchestrator.clock.base import Clock
from sim.core.oscillator import Oscillator

TIME_WRAP = 1 << 31
NEVER_NS = 1 << 62
NOMINAL_US = 1000
# Held up for longer, a process goes on from where it is. A busy machine holds one of many up for a tenth of a second.
LATEST_NS = 250_000_000


class Timebase:
    """Counts servo samples since power-up in device time; one lasts TM/1024 ms, 976.5625 us at TM 1000.

    Ticks are samples that no reset counts anew, so that units on a shared clock agree on them.
    """

    def __init__(self, clock: Clock, oscillator: Oscillator) -> None:
        self.clock = clock
        self.oscillator = oscillator
        self.period_us = NOMINAL_US
        """Of `TM`; negative for an external clock."""
        self.running = True
        self._own = True
        self._event_ns: int | None = None
        """True instant at which what is worked out now happens; None for what comes from outside."""
        self._latest_ns = 0
        self._seen_ns = -1
        """True time for which `_seen_sample` was worked out: within one instant many ask."""
        self._seen_sample = 0
        self._base_ns = self.device_ns()
        self._base_tick = 0
        self._zero_tick = 0
        self._source: Timebase | None = None
        self._shift = 0
        self.joined = False
        """Whether ticks are related to those of the wire; they stay so, as the source's ticks never jump."""
        self.followers: list[tuple[Timebase, Callable[[], None]]] = []

    # Changes

    def reset(self) -> None:
        """Power-up or reset: sample 0 is now, on the own clock."""
        tick = self.tick()
        self._seen_ns = -1
        self.running = self._own = True
        self.period_us = NOMINAL_US
        self._base_ns, self._base_tick = self.device_ns(), tick + 1
        self._zero_tick = tick + 1
        self._tellfollowers()

    def halt(self) -> None:
        """Power is gone: no more samples, here and on the wire."""
        self._base_tick = self.tick()
        for follower, _ in self.followers:
            follower.hold()
        self.running = self._own = False
        self._seen_ns = -1
        self._tellfollowers()

    def set_period(self, period_us: int) -> None:
        """`TM`: the samples to come last `period_us` nominal microseconds; counting goes on from the present one.

        Negative: the samples to come are those of the wire.
        """
        tick = self.tick()
        if period_us > 0:
            self._base_ns = self._tick_device_ns(tick) if self.period_us > 0 else self.device_ns()
        self._base_tick = tick
        self._seen_ns = -1
        self.period_us = period_us
        self._own = self.running and period_us > 0
        self.joined = False
        self.join()
        self._tellfollowers()

    def wire(self, source: "Timebase", changed: Callable[[], None]) -> None:
        """A wire brings the sample clock of `source`; `changed` is called when its samples change their instants."""
        self._source = source
        source.followers.append((self, changed))
        self.join()

    def hold(self) -> None:
        """The wire goes dead: stay at the present sample."""
        if self.period_us < 0:
            self._base_tick = self.tick()

    def join(self) -> None:
        """Count from the present sample on with the wire, if it is alive."""
        source = self._live
        if source is not None:
            self._shift, self.joined = self._base_tick - source.tick(), True

    def _tellfollowers(self) -> None:
        for follower, changed in self.followers:
            if follower.period_us < 0:
                if not follower.joined:
                    follower.join()
                changed()

    @property
    def _live(self) -> "Timebase | None":
        """The unit whose samples count now, None for the own clock or none."""
        source = self._source
        return source if self.period_us < 0 and source is not None and source.running else None

    @property
    def frozen(self) -> bool:
        """Whether there are no samples."""
        if self._own:
            return False
        return not self.running or (self.period_us < 0 and (self._live is None or self._live.frozen))

    # Reading

    def device_ns(self) -> int:
        return self.oscillator.device_ns(self.now_ns())

    def tick(self) -> int:
        """The tick that runs now."""
        if self._own:
            return self._base_tick + (self.device_ns() - self._base_ns) * 16 // (15625 * self.period_us)
        source = self._live
        return self._base_tick if source is None else source.tick() + self._shift

    def sample(self) -> int:
        """The sample that runs now."""
        if not self._own:
            return self.tick() - self._zero_tick
        now_ns = self.now_ns()
        if now_ns != self._seen_ns:
            self._seen_ns, self._seen_sample = now_ns, self.tick() - self._zero_tick
        return self._seen_sample

    def instant(self) -> float:
        """Now in samples, with the fraction of the one that runs."""
        return self.tick_instant() - self._zero_tick

    def next_sample(self) -> int:
        """The first sample instant that is not past: a command given now takes effect there."""
        sample = self.sample()
        return sample if not self.frozen and self.true_ns(sample) >= self.now_ns() else sample + 1

    def true_ns(self, sample: int) -> int:
        """The true instant of a sample; `NEVER_NS` for one to come while there are none."""
        return self.tick_true_ns(sample + self._zero_tick)

    def after_ns(self, device_ns: int) -> int:
        """The true instant at which `device_ns` of device time will have passed from now."""
        return self.oscillator.true_ns(self.device_ns() + device_ns)

    def begin(self, due_ns: int) -> None:
        """What is worked out from now to `end` was due at the true instant `due_ns`, and happens then.

        Live, timers are late like everybody's, by up to some milliseconds. What was due before has happened when it
        was due, because a processor adds no such delays up, and nobody could look in between; time never goes back.
        """
        self.end()
        now_ns = self.clock.now_ns()
        self._event_ns = max(due_ns, self._latest_ns) if 0 < now_ns - due_ns < LATEST_NS else now_ns

    def end(self) -> None:
        """What was due has been worked out."""
        if self._event_ns is not None:
            self._latest_ns, self._event_ns = self._event_ns, None

    def now_ns(self) -> int:
        """The true instant at which what happens now happens in the controller."""
        if self._event_ns is not None:
            return self._event_ns
        self._latest_ns = now_ns = self.clock.now_ns()
        return now_ns

    def sample_rate(self) -> float:
        """Samples in a true second, by the oscillator's present rate."""
        if self.frozen:
            return 0.0
        source = self._live
        if source is not None:
            return source.sample_rate()
        now_ns = self.now_ns()
        rate = (self.oscillator.device_ns(now_ns + 1_000_000_000) - self.oscillator.device_ns(now_ns)) * 1e-9
        return rate * 1_024_000 / self.period_us

    def tick_instant(self) -> float:
        """Now in ticks, with the fraction of the one that runs."""
        if self._own:
            return self._base_tick + (self.device_ns() - self._base_ns) * 16 / (15625 * self.period_us)
        source = self._live
        return float(self._base_tick) if source is None else source.tick_instant() + self._shift

    def tick_true_ns(self, tick: int) -> int:
        """The true instant of a tick."""
        if self._own:
            return self.oscillator.true_ns(self._tick_device_ns(tick))
        source = self._live
        if source is None:
            return NEVER_NS if tick > self._base_tick else self.now_ns()
        return source.tick_true_ns(tick - self._shift)

    def _tick_device_ns(self, tick: int) -> int:
        return self._base_ns - (self._base_tick - tick) * 15625 * self.period_us // 16
