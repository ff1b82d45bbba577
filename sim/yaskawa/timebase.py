"""The servo clock: samples of the controller's own time against true time (`TM`, `TIME`; L10613-L10760)."""

from orchestrator.clock.base import Clock
from sim.core.oscillator import Oscillator

TIME_WRAP = 1 << 31


class Timebase:
    """Counts servo samples since power-up in device time; one lasts TM/1024 ms, 976.5625 us at TM 1000."""

    def __init__(self, clock: Clock, oscillator: Oscillator) -> None:
        self.clock = clock
        self.oscillator = oscillator
        self.period_us = 1000
        self._base_ns = 0
        self._base_sample = 0
        self.reset()

    def reset(self) -> None:
        """Power-up or reset: sample 0 is now."""
        self._base_ns = self.device_ns()
        self._base_sample = 0
        self.period_us = 1000

    def device_ns(self) -> int:
        return self.oscillator.device_ns(self.clock.now_ns())

    def set_period(self, period_us: int) -> None:
        """`TM`: the samples to come last `period_us` nominal microseconds; counting goes on from the present one."""
        sample = self.sample()
        self._base_ns = self._sample_device_ns(sample)
        self._base_sample = sample
        self.period_us = period_us

    def sample(self) -> int:
        """The sample that runs now."""
        return self._base_sample + (self.device_ns() - self._base_ns) * 16 // (15625 * self.period_us)

    def instant(self) -> float:
        """Now in samples, with the fraction of the one that runs."""
        return self._base_sample + (self.device_ns() - self._base_ns) * 16 / (15625 * self.period_us)

    def next_sample(self) -> int:
        """The first sample instant that is not past: a command given now takes effect there."""
        sample = self.sample()
        return sample if self.true_ns(sample) >= self.clock.now_ns() else sample + 1

    def true_ns(self, sample: int) -> int:
        """The true instant of a sample."""
        return self.oscillator.true_ns(self._sample_device_ns(sample))

    def after_ns(self, device_ns: int) -> int:
        """The true instant at which `device_ns` of device time will have passed from now."""
        return self.oscillator.true_ns(self.device_ns() + device_ns)

    def sample_rate(self) -> float:
        """Samples in a true second, by the oscillator's present rate."""
        now_ns = self.clock.now_ns()
        rate = (self.oscillator.device_ns(now_ns + 1_000_000_000) - self.oscillator.device_ns(now_ns)) * 1e-9
        return rate * 1_024_000 / self.period_us

    def _sample_device_ns(self, sample: int) -> int:
        return self._base_ns - (self._base_sample - sample) * 15625 * self.period_us // 16
