"""The power supply of the far end of a serial line: what it sends while it loses power is cut off, and it receives
only what arrives after it gets power."""

from dataclasses import dataclass

NEVER_NS = -(2**63)


@dataclass(slots=True)
class PowerSupply:
    """lost_ns, back_ns: when power was last lost, and restored."""

    lost_ns: int = NEVER_NS
    back_ns: int = NEVER_NS

    def set_power(self, at_ns: int, *, on: bool) -> None:
        """Power is on or off from now on."""
        if on:
            self.back_ns = at_ns
        else:
            self.lost_ns = at_ns

    def cut_sent(self, data: bytes, sent_ns: int, ends_ns: int, char_ns: int) -> bytes:
        """The part that has left a port, of characters of `char_ns` each, sent at `sent_ns`, ending at `ends_ns`."""
        if not sent_ns <= self.lost_ns < ends_ns:
            return data
        return data[: max(0, len(data) + (self.lost_ns - ends_ns) // char_ns)]

    def cut_received(self, data: bytes, ends_ns: int, char_ns: int) -> bytes:
        """The part that is received of characters of `char_ns` each that end at `ends_ns`: those that begin under
        power."""
        if self.back_ns <= ends_ns - len(data) * char_ns:
            return data
        count = max(0, ends_ns - self.back_ns) // char_ns if char_ns else len(data)
        return data[len(data) - count :]
