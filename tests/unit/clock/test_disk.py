"""An action that runs while its record is written to disk."""

import asyncio

import pytest

from orchestrator.clock.executor import run_while_recording


def test_a_record_is_on_disk_before_the_result_of_its_action_is_used() -> None:
    said: list[str] = []

    async def tell(error: Exception | None = None) -> None:
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        said.append("told")
        if error is not None:
            raise error

    async def do(error: Exception | None = None) -> str:
        said.append("began")
        await asyncio.sleep(0)
        if error is not None:
            raise error
        return "done"

    async def main() -> None:
        assert await run_while_recording(tell(), do()) == "done"
        assert said == ["began", "told"]
        with pytest.raises(KeyError):
            await run_while_recording(tell(), do(KeyError("done")))
        assert said == ["began", "told"] * 2
        with pytest.raises(OSError, match="disk is full"):
            await run_while_recording(tell(OSError("disk is full")), do())
        with pytest.raises(OSError, match="disk is full"):
            await run_while_recording(tell(OSError("disk is full")), do(KeyError("done")))
        doing = asyncio.ensure_future(run_while_recording(tell(), asyncio.sleep(9)))
        await asyncio.sleep(0)
        doing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await doing
        assert said[-1] == "told" and len(said) == 9

    asyncio.run(main())
