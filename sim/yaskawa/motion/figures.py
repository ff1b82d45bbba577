"""Motion figures that differ between the models of the family."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MotionFigures:
    """Motion figures that differ between models: speeds in counts/s, accelerations in counts/s^2, sizes in entries.

    fastest: of `<n` and `>m` after a segment.
    vector: VS, VA and VD after a master reset.
    home_speed: of the second and third stage of HM.
    cam_points: entries of the table of ET.
    contour_step: largest increment of CD.
    """

    fastest: tuple[int, int]
    vector: tuple[int, int, int]
    home_speed: int
    cam_points: int
    encoder_resolution: int = 100_000
    """Largest argument of AE, counts a revolution."""
    contour_step: int = 32767
    contour_stops_at_record: bool = False
    """ST lets the executing record end and leaves the contour mode there; otherwise it decelerates at once."""
    lag: int = 1
    """Samples from a command to its effect on the encoder reading, with an ideal motor."""
    cycles_by_turns: bool = False
    """A cam's axes are reported by the master's turns since EP's start, not each modulo its own cycle."""
    stepper_home_stages: int = 3
    """Stages of HM for a stepper motor."""
    stepper_fastest: int = 0
    """0: as a servo."""
    default_plane: bool = False
    """The coordinate system is in vector mode in X and Y by default (L11451; SMC-2000: L12450)."""
    virtual_axis: bool = False
    systems: str = "S"
