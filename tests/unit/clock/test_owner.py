"""What becomes of owned tasks, and of those that run beside a context."""

import asyncio

import pytest

from orchestrator.clock.owner import TaskOwner, running, wait_for_first


async def fail() -> None:
    raise ValueError("broken")


def test_an_owner_reports_each_defect_and_cancels_what_runs() -> None:
    async def check() -> None:
        reported: list[tuple[str, bool]] = []
        owner = TaskOwner(lambda error, vital: reported.append((str(error), vital)))
        endless = owner.spawn(asyncio.sleep(3600))
        owner.spawn(fail(), vital=True)
        await asyncio.sleep(0)
        assert owner.pending == [endless]
        await owner.end_all()
        assert endless.cancelled()
        assert owner.pending == []
        assert reported == [("broken", True)]
        await owner.end_all()  # nothing is left

    asyncio.run(check())


def test_an_owner_without_a_callback_reports_to_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    async def check() -> None:
        reported: list[dict[str, object]] = []
        monkeypatch.setattr(asyncio.get_running_loop(), "call_exception_handler", reported.append)
        TaskOwner().spawn(fail())
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert [str(context["exception"]) for context in reported] == ["broken"]

    asyncio.run(check())


def test_a_coroutine_beside_a_context_ends_with_it() -> None:
    async def check() -> None:
        async with running(asyncio.sleep(3600)) as beside:
            await asyncio.sleep(0)
            assert not beside.done()
        await asyncio.wait([beside])
        assert beside.cancelled()

    asyncio.run(check())


def test_the_first_to_end_ends_the_others_and_its_error_is_raised() -> None:
    async def check() -> None:
        never = asyncio.Event()
        await wait_for_first(asyncio.sleep(0), never.wait())
        with pytest.raises(ValueError, match="broken"):
            await wait_for_first(never.wait(), fail())

    asyncio.run(check())
