"""Short conversations of a make's driver with its simulated controller, through a wire that changes replies."""

import asyncio
import re
from contextlib import suppress
from dataclasses import dataclass
from random import Random

from adapters.abilities import find_differences
from adapters.controller.state.readings import require_sound_reading
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.conformance.findings import require
from orchestrator.conformance.worlds import Case, World, run_case
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.link.can import CanFrame, decode_frames, encode_frames
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.plan.shape import PlanError

LONGEST_S = 240  # of virtual time for one conversation: more than all timeouts and repetitions of one
STOPPED_NS = 4 * NS_PER_S  # for a stop on a line that works again
EXPECTED = (ControllerFault, LinkClosed, LinkRefused, Refusal, PlanError)
NUMBERS = [
    b" inf", b"-inf", b"nan", b"1e999", b"1e999999999", b"-1e-999", b"9" * 30, b"9" * 5000, b"-" + b"9" * 19,
    b"0x7FFFFFFF", b"2147483648", b"-2147483649", b"1/0", b"1_0", b"", b"-", b"+", b".", b"1.2.3", b"\xb2", b"\xd9\xa3",
    b"NS", b"?", b":", b"4294967296", b"65536", b"-1", b"00000000000000000007", b"1e5", b"$80000000",
]  # fmt: skip
_NUMBER = re.compile(rb"[+-]?\d+(?:\.\d+)?")


@dataclass
class ReplyMutator:
    """Changes replies at random while `is_active`: `rate` of them; with `only_at` only the one with this number."""

    draw: Random
    rate: float
    can: bool
    only_at: int | None = None
    is_active: bool = True
    last: bytes = b""

    def change(self, data: bytes) -> bytes:
        last, self.last = self.last, data
        if self.only_at is not None:
            self.only_at -= 1
            if self.only_at != 0:
                return data
        elif not self.is_active or self.draw.random() >= self.rate:
            return data
        return self._change_frames(data, last) if self.can else self._change_bytes(data, last)

    def _change_bytes(self, data: bytes, last: bytes) -> bytes:
        draw = self.draw
        match draw.randrange(9):
            case 0 | 1 | 2 | 3:
                number_matches = list(_NUMBER.finditer(data))
                if not number_matches:
                    return data
                number_match = draw.choice(number_matches)
                return data[: number_match.start()] + draw.choice(NUMBERS) + data[number_match.end() :]
            case 4:
                at = draw.randrange(len(data))
                return data[:at] + bytes([draw.randrange(256)]) + data[at + 1 :]
            case 5:
                return data[: draw.randrange(len(data))]
            case 6:
                return last + data if draw.random() < 0.5 else data + data
            case 7:
                at = draw.randrange(len(data) + 1)
                return data[:at] + draw.randbytes(draw.choice((1, 3, 40))) + data[at:]
            case _:
                return b""

    def _change_frames(self, data: bytes, last: bytes) -> bytes:
        draw, frames = self.draw, decode_frames(data)
        at = draw.randrange(len(frames))
        frame = frames[at]
        match draw.randrange(7):
            case 0 | 1:
                filler = draw.choice((b"\xff", b"\x80", b"\x00", b"\x7f"))
                kept_size = draw.choice((0, 4, 6)) if len(frame.data) == 8 else draw.choice((0, 2))
                frames[at] = CanFrame(frame.id, frame.data[:kept_size] + filler * max(0, len(frame.data) - kept_size))
            case 2:
                frames[at] = CanFrame(frame.id, draw.randbytes(len(frame.data)))
            case 3:
                frames[at] = CanFrame(frame.id, draw.randbytes(draw.randrange(9)))
            case 4:
                frames[at] = CanFrame(frame.id, frame.data[: draw.randrange(len(frame.data) + 1)])
            case 5:
                return last + data
            case _:
                del frames[at]
        return encode_frames(*frames)


async def converse(world: World, mutator: ReplyMutator) -> str:
    """Connect, read, and perhaps move; return what ended it. Nothing moves that was not released, and nothing moves
    after a stop over a line that works."""
    driver, draw = world.driver, mutator.draw
    is_released, motion_count = False, len(world.motions)
    mutator.is_active = draw.random() < 0.5
    end = "done"
    try:
        await driver.connect()
        await driver.configure()
        await world.load_soft_limits({axis: draw.choice((None, (-100_000, 100_000))) for axis in world.axes})
        mutator.is_active = mutator.is_active or draw.random() < 0.7
        await driver.set_enabled(world.axes, on=True)
        for _ in range(draw.choice((2, 4, 25))):
            require_sound_reading(await driver.poll())
            await sleep_ns(world.clock, NS_PER_S // 20)
        await find_differences(driver, everything=True)
        mutator.is_active = True
        axis_factors = {axis: draw.choice((1.5, -3)) for axis in world.axes}
        profiles = await world.plan({axis: world.short_targets(factor)[axis] for axis, factor in axis_factors.items()})
        await world.arm(profiles)
        await driver.slots.present.verify()
        is_released = True
        await driver.slots.present.release()
        await driver.slots.present.wait_for_start()
        await driver.slots.present.wait_for_end()
        require_sound_reading(await driver.poll())
    except EXPECTED as error:
        end = f"{type(error).__name__}: {error}"
    mutator.is_active = False
    require(is_released or len(world.motions) == motion_count, f"an axis moved without a release, after {end}")
    with suppress(*EXPECTED):
        await driver.stop(abort=False)
    await world.leave()
    await world.rest(STOPPED_NS if is_released else 0)
    return end


def run_conversation(name: str, case: Case, seed: int) -> str:
    """Run one conversation of a case; return what ended it. name: of the case, for the draws."""
    ends: list[str] = []

    async def main(world: World) -> None:
        draw = Random(f"{name} {seed}")
        mutator = ReplyMutator(
            draw,
            draw.choice((0.02, 0.1, 0.4)),
            can=case.controller.link.kind == "can",
            only_at=draw.choice((None, draw.randrange(1, 60))),
        )
        for unit in world.units:
            unit.wire.to_near = mutator.change
        async with asyncio.timeout(LONGEST_S):
            ends.append(await converse(world, mutator))

    run_case(case, main, seed)
    return ends[0]
