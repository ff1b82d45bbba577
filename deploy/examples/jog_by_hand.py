"""Jog an axis for a second: jog_by_hand.py AXIS VELOCITY [ENDPOINT]. VELOCITY in the axis's unit/s, signed."""

import asyncio
import sys

from tutti import Refusal, Tutti

SECONDS, EVERY_S = 1.0, 0.05


async def main(axis: str, velocity: float, endpoint: str) -> None:
    async with Tutti(endpoint, actor="jog_by_hand") as tutti:
        async with tutti.manual_control([axis], what="a jog of one second") as hand:
            await hand.jog({axis: velocity})
            for _ in range(round(SECONDS / EVERY_S)):
                await asyncio.sleep(EVERY_S)
                # Valid for 200 ms: when this script dies, the axis stops by itself.
                await hand.renew_jog()
        # The jog is stopped and the axis released, also after an error above; it may still be on its deceleration ramp.
        print((await tutti.status())[axis.partition(".")[0]].axes[axis.partition(".")[2]].position)


try:
    asyncio.run(main(sys.argv[1], float(sys.argv[2]), sys.argv[3] if len(sys.argv) > 3 else "tcp/127.0.0.1:7447"))
except Refusal as error:
    sys.exit(f"{error.text}; {error.remedy}")
