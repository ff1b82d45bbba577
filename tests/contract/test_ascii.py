"""Described controllers against the contract, and descriptions that are wrong."""

import asyncio
import re
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from adapters.ascii.description import DescriptionError, load_description, packaged_names
from adapters.ascii.patterns import BadPattern, LinePattern
from adapters.contract import ConfigError, ExamplePlace, JogMove
from adapters.host.makes import find_make
from adapters.toolkit.lines.driver import LineDriver
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.queue import EventQueue
from orchestrator.conformance.examples import make_case
from orchestrator.conformance.findings import NotApplicable
from orchestrator.conformance.suite import MakeCheck, list_checks
from orchestrator.conformance.worlds import Case, World, run_case
from orchestrator.model.errors import ControllerFault
from orchestrator.model.fleet import Controller
from sim.ascii.grbl import GrblController
from sim.core.vectors import check_file, find_simulator

HERE = Path(__file__).parent
MM: dict[str, Any] = {"unit": "mm", "soft_limits": {"min": 0, "max": 100}}
STAGE: dict[str, Any] = {**MM, "scale": 2000, "limits": {"velocity": 20, "acceleration": 100}}
SERIAL: dict[str, Any] = {"kind": "serial", "device": "/dev/ttyUSB0", "baud": 115_200}


def described(description: str, axes: dict[str, dict[str, Any]], **simulate: Any) -> Controller:
    return Controller.model_validate(
        {
            "adapter": "ascii",
            "link": SERIAL,
            "options": {"description": description},
            "axes": axes,
            "simulate": {"options": simulate},
        }
    )


def stage_case(description: str = "scpi-stage", **simulate: Any) -> Case:
    axes = {"u": {**STAGE, "motors": ["1"]}, "v": {**STAGE, "motors": ["2"], "homing": {"speed": 5}}}
    return make_case("ascii", described(description, axes, **simulate))


def grbl_case() -> Case:
    return make_case("ascii")


def grblhal_case() -> Case:
    config = grbl_case().controller
    return make_case("ascii", config.model_copy(update={"options": {"description": "grblhal"}}))


CAMPAIGN = "no invariant is violated"  # of makes with a description, at night: it takes long, and the driver is one
CHECKS = {
    "grbl": list_checks("ascii"),
    "grblhal": list_checks("ascii", case=grblhal_case()),
    "scpi-stage": list_checks("ascii", case=stage_case()),
}


@pytest.mark.parametrize(
    "check",
    [
        pytest.param(c, id=f"{name}: {c.name}", marks=[pytest.mark.nightly] if c.name.startswith(CAMPAIGN) else [])
        for name, found in CHECKS.items()
        for c in found
    ],
)
def test_the_contract(check: MakeCheck) -> None:
    try:
        check.run()
    except NotApplicable as reason:
        pytest.skip(str(reason))


def test_every_packaged_description_is_checked() -> None:
    assert set(packaged_names()) == set(CHECKS)


@pytest.mark.parametrize("model", ["grbl", "grblhal", "scpi-stage"])
def test_vectors(model: str) -> None:
    report = check_file("ascii", HERE / "vectors" / f"{model}.vectors.jsonl")
    assert list(report.failures.values()) == []
    assert len(report.passed) >= 10


# GRBL's own ways


def test_the_position_is_kept_by_a_stop_and_lost_by_a_reset_in_motion() -> None:
    clock = EventQueue()
    unit = find_simulator("ascii").build_controller(clock, {"settings": {"10": 3}})
    said = bytearray()
    port = unit.connect("serial", said.extend, lambda: None)

    def send(text: bytes, wait_s: float = 0.5) -> str:
        said.clear()
        port.receive_bytes(text)
        clock.run_until_ns(clock.now_ns() + round(wait_s * NS_PER_S))
        return said.decode("latin-1")

    assert send(b"G90G21G94G53G1X20F400\n") == "ok\r\n"
    assert "<Run|" in send(b"?", 0.0)
    assert send(b"!\x18").startswith("ALARM:3")  # the reset comes before the end of the ramp
    assert "<Alarm|" in send(b"?")
    assert "error:9" in send(b"G90G21G94G53G1X0F400\n")
    send(b"$X\n")
    assert send(b"G90G21G94G53G1X0F400\n") == "ok\r\n"
    send(b"!", 3.0)
    assert "<Hold:0|" in send(b"?")
    held = send(b"?")
    assert "Grbl 1.1h" in send(b"\x18")
    assert send(b"?").split("|")[:2] == ["<Idle", held.split("|")[1]]


def test_a_line_behind_a_hold_waits_for_its_start() -> None:
    async def main(world: World) -> None:
        await world.ready()
        await world.arm(await world.plan(world.targets()))
        state = await world.driver.send_raw("?")
        assert "Hold:0" in state
        await sleep_ns(world.clock, NS_PER_S)
        assert not world.motions
        await world.driver.slots.unload()
        assert "Idle" in await world.driver.send_raw("?")

    run_case(grbl_case(), main)


def connect_as(description: str, model: str) -> ControllerFault:
    """The fault with which a simulated controller of `model` is refused that has a wrong description."""
    right_case = grblhal_case() if model == "grblhal" else grbl_case()
    config = right_case.controller.model_copy(update={"options": {"description": description}})
    faults: list[ControllerFault] = []

    async def main(world: World) -> None:
        with pytest.raises(ControllerFault) as caught:
            await world.driver.connect()
            await world.driver.configure()
            await world.driver.set_enabled(world.axes, on=True)
        faults.append(caught.value)

    run_case(Case(config.model_dump(mode="json", by_alias=True), right_case.simulate, right_case.port), main)
    return faults[0]


def test_another_firmware_of_the_family_is_refused_by_its_name() -> None:
    fault = connect_as("grbl", "grblhal")
    assert "it is grblHAL, and not GRBL 1.1 (grbl.yaml:" in fault.text
    assert "grblhal" in fault.remedy
    # GRBL has no 0x80.
    assert re.search(r"no reply to b'\\x80' .* \(grbl\.yaml:\d+: status\.last\)", connect_as("grblhal", "grbl").text)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        # The tool, the mark of before: each line of G-code without T sets it to 0, and on grblHAL it only is selected.
        (
            "session: {match: '\\[GC:.* T(?P<number>\\d+) .*\\]', write: \"T{number}\\n\"}",
            r"number 1 was written, and 0 is read back \(mine\.yaml:4: session\)",
        ),
        (
            "status: {free_when_empty: 128}",
            r"1023 free bytes at rest, not 128 \(mine\.yaml:4: status\.free_when_empty\)",
        ),
        (
            "finish_stop: [{send: \"\\x18\", last: 'Grbl 1.1.*'}]",
            r"a line like 'Grbl 1\.1\.\*' \(mine\.yaml:4: finish_stop",
        ),
    ],
)
def test_a_wrong_line_of_a_description_is_named_when_connecting(tmp_path: Path, changed: str, words: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(f"schema: tutti.ascii/1\nextends: grblhal\nname: mine\n{changed}\n")
    case = grblhal_case()
    config = case.controller.model_copy(update={"options": {"description": str(file)}})

    async def main(world: World) -> None:
        other = world.hit.controller.connect("serial", lambda _: None, lambda: None)
        for data in (b"$X\n", b"!"):
            other.receive_bytes(data)
            await sleep_ns(world.clock, NS_PER_S // 10)
        with pytest.raises(ControllerFault, match=words):
            await world.driver.connect()

    run_case(Case(config.model_dump(mode="json", by_alias=True), case.simulate, case.port), main)


def test_the_session_number_outlives_moves_jogs_and_stops() -> None:
    for case in (grbl_case(), grblhal_case()):

        async def main(world: World) -> None:
            await world.ready()
            await world.move(world.targets())
            assert not (await world.driver.poll()).restarted
            await world.manual.jog_axis(world.axes[0], JogMove(-500.0, 1000.0, None))
            await sleep_ns(world.clock, NS_PER_S)
            await world.driver.stop(abort=False)
            await sleep_ns(world.clock, 2 * NS_PER_S)
            assert not (await world.driver.poll()).restarted

        run_case(case, main)


def test_a_connection_after_a_hold_succeeds_at_once() -> None:
    for case in (grbl_case(), grblhal_case()):

        async def main(world: World, case: Case = case) -> None:
            await world.ready()
            await world.arm(await world.plan(world.targets()))
            await world.driver.close()
            guardian = world.hit.controller.connect("serial", lambda _: None, lambda: None)
            guardian.receive_bytes(find_make("ascii").stop_bytes(case.controller))
            began_ns = world.clock.now_ns()
            await world.driver.connect()
            await world.driver.configure()
            assert world.clock.now_ns() - began_ns < NS_PER_S
            assert not (await world.driver.poll()).restarted

        run_case(case, main)


def test_a_search_in_vain_finds_no_reference() -> None:
    """It is answered `ok`, and the axes that did not have their turn stand at 0 counts, as before."""

    async def main(world: World) -> None:
        await world.ready()
        assert not await world.manual.home_axes(world.axes, lambda _: None)
        controller = world.hit.controller
        assert isinstance(controller, GrblController)
        controller._machine = replace(controller._machine, switch_counts={"Z": 10_000})
        controller.settings[132] = 1.0
        failures = await world.manual.home_axes(world.axes, lambda _: None)
        assert set(failures) == set(world.axes)
        assert all("the controller reports Alarm" in failure.text for failure in failures.values())

    run_case(grbl_case(), main)


def test_a_status_that_is_lost_is_asked_again() -> None:
    async def main(world: World) -> None:
        await world.ready()
        await world.arm(await world.plan(world.targets()))
        drops = [True]
        world.hit.wire.to_far = lambda data: data.replace(b"?", b"", 1) if drops and drops.pop() else data
        await world.driver.slots.present.verify()
        assert not drops
        await world.driver.slots.unload()

    run_case(grbl_case(), main)


def test_the_direction_of_the_search_is_compared() -> None:
    case = grbl_case()
    wrong = {**case.simulate, "settings": {**case.simulate["settings"], "23": 2.0}}

    async def main(world: World) -> None:
        with pytest.raises(ControllerFault, match=r"\$23, .* of axis y is 1, required is 0") as caught:
            await world.driver.connect()
            await world.driver.configure()
        assert "homing.direction" in caught.value.remedy

    run_case(Case(case.config, wrong, case.port), main)


# Bad input


def test_settings_that_do_not_match_the_fleet_file_are_named() -> None:
    case = grbl_case()
    plain = dict(case.simulate)
    for number, value, words in (
        ("100", 200.0, "steps per mm"),
        ("10", 1.0, "status reports"),
        ("110", 1.0, "at least"),
    ):
        wrong = {**plain, "settings": {**plain["settings"], number: value}}

        async def main(world: World, words: str = words) -> None:
            with pytest.raises(ControllerFault, match=words) as caught:
                await world.driver.connect()
                await world.driver.configure()
            assert caught.value.remedy

        run_case(Case(case.config, wrong, case.port), main)


def write_description(folder: Path, **changed: Any) -> str:
    plain = yaml.safe_load((HERE.parents[1] / "adapters/ascii/descriptions/scpi-stage.yaml").read_text())
    for path, value in changed.items():
        *parts, last = path.split("__")
        into = plain
        for part in parts:
            into = into[part]
        into[last] = value
    file = folder / "mine.yaml"
    file.write_text(yaml.safe_dump(plain))
    return str(file)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"refused": "(?P<reason>a)(?=b)"}, "refused: .*is no pattern of RE2"),
        ({"refused": r"(a)\1"}, "refused: .*is no pattern of RE2"),
        ({"refused": "(" * 10}, "refused: .*is no pattern of RE2"),
        ({"refused": "a" * 2000}, "at most are 1000"),
        ({"status__match": "x"}, r"status: .*has no group \(\?P<positions>"),
        ({"session__match": "x"}, r"session: .*has no group \(\?P<number>"),
        ({"target": "{motr} {position}"}, r"target: .*unknown name 'motr'.*\{motor\}"),
        ({"positions": "inches"}, "positions"),
        ({"schema": "tutti.ascii/2"}, "schema"),
        ({"surprise": 1}, "surprise"),
    ],
)
def test_a_wrong_description_is_named_with_its_field(tmp_path: Path, changed: dict[str, Any], words: str) -> None:
    file = write_description(tmp_path, **changed)
    with pytest.raises(DescriptionError, match=words) as caught:
        load_description(file)
    assert file in str(caught.value)


@pytest.mark.parametrize("base", ["no-such", "./grbl", "7"])
def test_a_description_extends_only_what_comes_with_tutti(tmp_path: Path, base: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(f"schema: tutti.ascii/1\nextends: {base}\n")
    with pytest.raises(DescriptionError, match=r"mine\.yaml:2: extends: .* is none of grbl, grblhal, scpi-stage"):
        load_description(str(file))
    file = tmp_path / "wrong.yaml"
    file.write_text("schema: tutti.ascii/1\nextends: grbl\nstatus: {match: x}\n")
    with pytest.raises(DescriptionError, match=r"wrong\.yaml:3: status: .*has no group"):
        load_description(str(file))


def test_files_that_are_no_descriptions(tmp_path: Path) -> None:
    for name, text in (("broken", "a: [1"), ("list", "[1, 2]"), ("large", "#" * 200_000)):
        file = tmp_path / name
        file.write_text(text)
        with pytest.raises(DescriptionError, match=name):
            load_description(str(file))
    with pytest.raises(DescriptionError, match="give the path of a description, or one of grbl, grblhal, scpi-stage"):
        load_description("no-such")
    config = described("no-such", {"u": {**STAGE, "motors": ["1"]}})
    with pytest.raises(ConfigError, match=r"options\.description"):
        find_make("ascii").check_config(config)
    with pytest.raises(ConfigError, match=r"axes\.u\.motors: 'Q' is none of 1, 2"):
        find_make("ascii").check_config(described("scpi-stage", {"u": {**STAGE, "motors": ["Q"]}}))
    with pytest.raises(ConfigError, match="cannot be told apart"):
        find_make("ascii").check_config(described("grbl", {"u": {**STAGE, "scale": 5000, "motors": ["X"]}}))


def test_patterns_take_a_time_that_is_linear_in_the_line() -> None:
    """A pattern that takes other engines longer than the universe has existed."""
    pattern, line = LinePattern(r"((a+)+)+b"), "a" * 2000
    began_s = time.process_time()
    assert not pattern.matches(line)
    assert time.process_time() - began_s < 0.5
    with pytest.raises(BadPattern):
        LinePattern("(")


def test_a_pattern_that_never_matches_is_a_fault_with_the_pattern(tmp_path: Path) -> None:
    file = write_description(tmp_path, status__last="never", status__match=r"never(?P<positions>\d)(?P<flags>\d)")

    async def main(world: World) -> None:
        async with asyncio.timeout(10):
            with pytest.raises(ControllerFault, match="expected is a line like 'never'") as caught:
                await world.driver.connect()
        assert caught.value.code == "garbage"

    run_case(stage_case(file, model="scpi-stage"), main)


def test_a_move_that_never_ends_is_stopped_and_reported(tmp_path: Path) -> None:
    """A controller whose status always says that an axis moves."""
    case = stage_case()

    async def main(world: World) -> None:
        await world.ready()
        profiles = await world.plan(world.targets())
        await world.arm(profiles)
        await world.driver.slots.present.verify()
        await world.driver.slots.present.release()
        started = await world.driver.slots.present.wait_for_start()
        assert started
        world.hit.wire.to_near = lambda data: data.replace(b";0,0\n", b";1,0\n")
        outcome = asyncio.ensure_future(world.driver.slots.present.wait_for_end())
        async with asyncio.timeout(60):
            while not outcome.done():
                await sleep_ns(world.clock, NS_PER_S // 10)
                if world.clock.now_ns() > 20 * NS_PER_S:
                    world.hit.wire.to_near = None
        assert outcome.result().state == "fault"
        assert "does not end" in outcome.result().reason

    run_case(case, main)


def test_a_description_of_ones_own_has_no_simulator(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no simulator for the description .*simulate\.options\.model"):
        stage_case(write_description(tmp_path))


def test_a_stop_does_not_depend_on_the_file_of_the_description(tmp_path: Path) -> None:
    file = write_description(tmp_path)
    config = described(file, {"u": {**STAGE, "motors": ["1"]}})
    make = find_make("ascii")
    make.check_config(config)
    stop = make.stop_bytes(config)
    Path(file).unlink()
    assert make.stop_bytes(config) == stop != b""


def test_settings_that_one_query_shows_are_read_by_one() -> None:
    async def main(world: World) -> None:
        await world.driver.connect()
        sent: list[bytes] = []

        def record(data: bytes) -> bytes:
            sent.append(data)
            return data

        world.hit.wire.to_far = record
        await world.driver.configure()
        assert b"".join(sent).count(b"$$\n") == 1

    run_case(grbl_case(), main)


def test_the_example_names_the_packaged_descriptions() -> None:
    example = find_make("ascii").fleet_example(ExamplePlace(0, 0))
    assert all(name in example for name in packaged_names())


def test_a_position_lost_by_an_alarm_is_known_again_axis_by_axis() -> None:
    """Only a search of all axes at once made them known again: homed one after the other, none ever was."""

    async def main(world: World) -> None:
        await world.ready()
        driver = world.driver
        assert isinstance(driver, LineDriver)
        driver._reader.lost_axes.update(("u", "v"))  # as after an alarm

        async def list_lost() -> list[str]:
            return [name for name, axis in (await driver.poll()).axes.items() if axis.position_lost]

        assert await list_lost() == ["u", "v"]
        assert not await driver.home_axes(["u"], lambda _: None)
        assert await list_lost() == ["v"]
        assert not await driver.home_axes(["v"], lambda _: None)
        assert await list_lost() == []

    run_case(stage_case(), main)
