"""The capabilities of a model of the family: registers, records, arrays. Another model is another `ModelTraits`."""

from dataclasses import dataclass

SPEED_UNIT = 1024.0  # register units per count/sample (L10032, L10619)
RAMP_UNIT = 1024.0 * 1024.0  # register units per count/sample² (L2293)
# Interval and increment 0 leave contour mode (L4274).
LEAVE_CONTOUR = ("DT 0", "CD 0")


@dataclass(frozen=True, slots=True)
class ModelTraits:
    """Steps and bounds of a model's registers and memories, from its manual.

    speed, ramp: counts/s and counts/s² of the registers SP, and AC and DC.
    record_max: largest increment of a contour record (CD), counts.
    intervals: smallest and largest exponent of DT; a record lasts 2^n samples.
    contours: whether the adapter loads contours.
    least_tail: exponent of the shortest record at the end of a contour.
    interleaved_commands: commands of other threads between WC and CD, where threads alternate command by command.
    """

    speed_step: int
    speed_max: int
    ramp_step: int
    ramp_max: int
    record_max: int
    intervals: tuple[int, int]
    contours: bool = True
    least_tail: int = 1
    interleaved_commands: int = 0


SMC4000 = ModelTraits(
    speed_step=2,  # L10032
    speed_max=12_000_000,  # L10063
    ramp_step=1024,  # L2294
    ramp_max=67_107_840,  # L2293
    record_max=32_000,  # L13985; L3463 says 32767: the smaller value satisfies both
    intervals=(1, 8),  # L4278
)

# The line numbers are those of the SMC-2000's manual.
SMC2000 = ModelTraits(
    speed_step=2,  # L13960
    speed_max=8_000_000,  # L11552
    ramp_step=1024,  # L6846
    ramp_max=67_107_840,  # L6851
    record_max=32_762,  # L7736; L2595 says 32767
    intervals=(1, 8),  # L8328
    # Between WC and the next CD there are a DT and commands of the other threads, one of which prints polls.
    least_tail=2,
    interleaved_commands=1,
)
