"""A controller's own crystal: its time relative to true time."""

import random
from dataclasses import dataclass, field

_NS_PER_S = 1_000_000_000


@dataclass(slots=True)
class Oscillator:
    """Device time as a function of true time, strictly increasing: offset, constant drift, slow wander.

    The wander is a random walk of the rate, stepped once per second of true time, so device time is piecewise linear
    and both directions are exact to 1 ns. An oscillator without drift and wander is the identity plus offset.

    offset_ns: device time at true time 0.
    drift_ppm: constant error of the rate, parts per million.
    wander_ppm: standard deviation of the rate's step in one second (ppm/sqrt(s)).
    seed: of the wander.
    """

    offset_ns: int = 0
    drift_ppm: float = 0.0
    wander_ppm: float = 0.0
    seed: int = 0
    _random: random.Random = field(init=False, repr=False)
    _rates: list[float] = field(init=False, repr=False)  # device ns per true ns, in each second
    _starts: list[int] = field(init=False, repr=False)  # device ns at the start of each second
    _cached_ns: int = field(default=-1, init=False, repr=False)
    _cached_device_ns: int = field(default=0, init=False, repr=False)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)
        self._rates = [1.0 + self.drift_ppm * 1e-6]
        self._starts = [self.offset_ns]

    def device_ns(self, true_ns: int) -> int:
        """Return the device time at `true_ns` (>= 0)."""
        if not self.wander_ppm:
            return self.offset_ns + true_ns + round(true_ns * self.drift_ppm * 1e-6)
        if true_ns != self._cached_ns:  # cached: queried repeatedly at one instant
            second, rest_ns = divmod(true_ns, _NS_PER_S)
            if second >= len(self._rates):
                self._extend_to_second(second)
            self._cached_ns, self._cached_device_ns = (
                true_ns,
                self._starts[second] + round(rest_ns * self._rates[second]),
            )
        return self._cached_device_ns

    def true_ns(self, device_ns: int) -> int:
        """Return the first true instant at which device time has reached `device_ns`; 0 if it always had."""
        elapsed_ns = device_ns - self.offset_ns
        if elapsed_ns <= 0:
            return 0
        if not self.wander_ppm:
            guess_ns = round(elapsed_ns / self._rates[0])
        else:
            second = elapsed_ns // _NS_PER_S
            self._extend_to_second(second + 1)
            while self._starts[second] > device_ns:
                second -= 1
            while self._starts[second + 1] <= device_ns:
                second += 1
                self._extend_to_second(second + 1)
            start_ns, rate = self._starts[second], self._rates[second]
            rest_ns = round((device_ns - start_ns) / rate)
            # Usually exact at once; near the edges of a second it is searched for.
            if rest_ns and start_ns + round((rest_ns - 1) * rate) < device_ns <= start_ns + round(rest_ns * rate):
                return second * _NS_PER_S + rest_ns
            guess_ns = second * _NS_PER_S + rest_ns
        while self.device_ns(guess_ns) < device_ns:
            guess_ns += 1
        while guess_ns > 0 and self.device_ns(guess_ns - 1) >= device_ns:
            guess_ns -= 1
        return guess_ns

    def change_rate(self, ppm: float) -> None:
        """Run faster by `ppm` from the next second of true time that is not computed yet, as after a mechanical shock.
        Only for an oscillator that wanders."""
        self._extend_to_second(len(self._rates))
        self._rates[-1] += ppm * 1e-6

    def _extend_to_second(self, second: int) -> None:
        while len(self._rates) <= second:
            self._starts.append(self._starts[-1] + round(_NS_PER_S * self._rates[-1]))
            self._rates.append(self._rates[-1] + self._random.gauss(0.0, self.wander_ppm) * 1e-6)
