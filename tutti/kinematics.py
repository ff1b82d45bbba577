"""Virtual axes by code of your own: a class with `of`, `axes`, `to_virtual` and `to_real`, as an entry point.

```toml
[project.entry-points."tutti.kinematics"]
tripod = "my_stage:Tripod"
```

The fleet file names it: `kind: code`, `kinematics: tripod`, `parameters: {radius: 120}`; the class is called with the
parameters. A test of your package calls `check_kinematics`.
"""

import time
from collections.abc import Sequence

from orchestrator.model.curved_map import Kinematics, WithDerivatives
from orchestrator.model.linear_map import MapError
from orchestrator.model.virtual_maps import check_curved, check_speed, make_plain_map

__all__ = ["Kinematics", "MapError", "WithDerivatives", "check_kinematics"]


def check_kinematics(kinematics: Kinematics, ranges: Sequence[tuple[float, float]]) -> None:
    """Check that kinematics can be used for virtual axes: they have as many virtual as real axes, in known units, are
    their own inverse, smooth, and quick. ranges: of the real axes, in their units. Raises `MapError`."""
    virtual_map = make_plain_map(kinematics)
    if len(ranges) != len(virtual_map.real):
        raise MapError(f"{len(ranges)} ranges of {len(virtual_map.real)} real axes; give one for each")
    check_speed(virtual_map, ranges, time.perf_counter)
    check_curved(virtual_map, ranges)
