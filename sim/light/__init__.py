"""The light controller: up to four axes that exist in no hardware, simulated in closed form, for fleets of hundreds.

It costs so little that what is measured is Tutti. Its link is a call in the same process; frames are little-endian, a
reply is there as soon as its request is written. Time is in ticks of 1 µs of its crystal since it was built.

| request | fields | what it does |
|---|---|---|
| `I` | | says its version: text |
| `P` | | states itself: see `wire.STATE`, and `wire.AXIS` for each axis |
| `L` | move (u32), start (u64, tick), count of axes (u8), the axes | loads a move, which does nothing yet |
| `G` | move (u32), advance (u32, ticks) | releases it: it starts at its tick, or so much before |
| `U` | | unloads it, unless it moves |
| `S` | 1 (u8): stop dead; 0: by the ramps | stops, and unloads what has not started |
| `E` | mask of axes (u8), 1 or 0 (u8) | enables axes, or disables them |
| `H` | mask of axes (u8), speed (f64), ramp (f64) | moves them to where they were built, which is position 0 then |

Of each axis of a move: axis (u8), from, to (i64), ramp of a stop (f64, counts/s²), count of legs (u8); of each leg:
duration (f64, s) and acceleration (f64, counts/s²).

A reply is the letter of the request, a status (u8, see `wire.Status`), and the fields. One move at a time.
"""

from sim.light.simulator import LIGHT

__all__ = ["LIGHT"]
