"""Faults of drives and their bus are reported in words, and nothing continues that should not."""

from collections.abc import Callable
from pathlib import Path

import pytest
from unit.adapters.cia402_bench import ACCELERATION, Drives, config, run

from adapters.cia402 import MAKE
from adapters.cia402.canopen.bus import SHARED
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.can import ERROR_BUS_OFF, ERROR_RESTARTED, FRAME_BYTES, CanFrame, decode_frames, encode_frames
from orchestrator.model.errors import ControllerFault, Refusal
from sim import cia402


def test_a_following_error_in_a_move_is_reported_in_words_and_can_be_reset() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await world.go()
        await world.driver.slots.present.wait_for_start()
        await world.until(t0_ns + 300 * NS_PER_MS)
        world.unit.set_stalled("1", stalled=True)
        outcome = await world.driver.slots.present.wait_for_end()
        assert outcome.state == "fault"
        assert "following error (8611h)" in outcome.reason
        reading = await world.driver.poll()
        assert [fault.code for fault in reading.faults] == ["emergency"]
        assert reading.faults[0].remedy
        for refused in (world.driver.set_enabled(["a"], on=True), world.driver.home_axes(["a"], lambda _: None)):
            with pytest.raises(Refusal) as caught:
                await refused
            assert caught.value.code == "fault"
        world.unit.set_stalled("1", stalled=False)
        await world.driver.clear_faults()
        await world.driver.set_enabled(["a"], on=True)
        reading = await world.driver.poll()
        assert not reading.faults
        assert reading.axes["a"].enabled

    run(main, simulate={"objects": {"6065": 500, "6066": 10}})


def test_a_drive_that_is_switched_off_by_its_enable_input_is_reported_so() -> None:
    async def main(world: Drives) -> None:
        world.unit.set_input(2, level=True)
        await world.ready()
        t0_ns = await world.go()
        await world.driver.slots.present.wait_for_start()
        await world.until(t0_ns + 300 * NS_PER_MS)
        world.unit.set_input(2, level=False)
        outcome = await world.driver.slots.present.wait_for_end()
        assert outcome.state == "fault"
        assert "enable input" in outcome.reason
        with pytest.raises(Refusal) as caught:
            await world.driver.set_enabled(["a"], on=True)
        assert caught.value.code == "not-switched"
        assert "enable input" in caught.value.remedy
        world.unit.set_input(2, level=True)
        await world.driver.set_enabled(["a"], on=True)

    run(main, simulate={"enable_input": 2})


@pytest.mark.parametrize("stage", ["armed", "released", "moving"])
def test_a_drive_that_was_switched_off_and_on_is_detected(stage: str) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = world.clock.now_ns() + 500 * NS_PER_MS
        await world.arm(0, 40_000, t0_ns)
        if stage != "armed":
            await world.driver.slots.present.release()
        if stage == "moving":
            await world.driver.slots.present.wait_for_start()
            await world.until(t0_ns + 200 * NS_PER_MS)
        world.unit.set_power(on=False)
        await world.rest(20)
        world.unit.set_power(on=True)
        if stage == "armed":
            await world.rest(300)
            with pytest.raises(Refusal):
                await world.driver.slots.present.verify()
        elif stage == "released":
            with pytest.raises(ControllerFault) as caught:
                await world.driver.slots.present.wait_for_start()
            assert "switched off and on" in caught.value.text
        else:
            outcome = await world.driver.slots.present.wait_for_end()
            assert outcome.state == "fault"
            assert "switched off and on" in outcome.reason
        await world.rest(300)
        assert (await world.driver.poll()).restarted
        assert not (await world.driver.poll()).restarted
        await world.driver.set_enabled(["a"], on=True)
        here = (await world.driver.poll()).axes["a"].commanded_counts
        t0_ns = world.clock.now_ns() + 200 * NS_PER_MS
        await world.arm(0, here + 5000, t0_ns, begin=here)
        await world.driver.slots.present.release()
        await world.driver.slots.present.wait_for_start()
        assert (await world.driver.slots.present.wait_for_end()).state == "done"

    run(main)


def test_a_burst_of_error_frames_disturbs_no_move() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        await world.go()
        await world.driver.slots.present.wait_for_start()
        world.bus.disturb_frames(10)
        assert (await world.driver.slots.present.wait_for_end()).state == "done"
        assert world.unit.position("1") == 40_000

    run(main)


def test_bus_off_in_a_move_is_reported_and_a_stop_is_sent_again_afterwards() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await world.go(target=400_000)
        await world.driver.slots.present.wait_for_start()
        await world.until(t0_ns + 500 * NS_PER_MS)
        # Only the frames of this computer are destroyed: the drives stay on the bus.
        node = world.bus._nodes[-1]
        node.transmit_errors = 255
        node.queue_frames(CanFrame(0x201, bytes([0x0F, 0])))
        world.bus.disturb_frames(1)
        outcome = await world.driver.slots.present.wait_for_end()
        assert outcome.state == "fault"
        assert "bus-off" in outcome.reason
        with pytest.raises(ControllerFault) as caught:
            await world.driver.poll()
        assert caught.value.code == "bus-off"
        assert caught.value.remedy
        await world.driver.stop(abort=False)
        assert world.unit.is_moving("1")
        await world.rest(600)
        assert not world.unit.is_moving("1")
        assert world.unit.position("1") < 400_000
        assert not (await world.driver.poll()).axes["a"].moving

    run(main)


@pytest.mark.parametrize("without", ["6064", "6083", "607A"])
def test_an_object_that_cannot_be_mapped_is_named(without: str) -> None:
    async def main(world: Drives) -> None:
        with pytest.raises(ControllerFault) as caught:
            await world.driver.connect()
        assert caught.value.code == "pdo-mapping"
        assert f"{without}h" in caught.value.text
        assert caught.value.remedy

    run(main, simulate={"without": (without,)})


def test_a_device_of_another_profile_is_refused() -> None:
    async def main(world: Drives) -> None:
        with pytest.raises(ControllerFault) as caught:
            await world.driver.connect()
        assert caught.value.code == "wrong-make"
        assert "401" in caught.value.text

    run(main, simulate={"objects": {"1000": 401}})


@pytest.mark.parametrize(
    ("objects", "options", "words"),
    [
        ({"6091:1": 5}, {"gear": "3"}, "gear"),
        ({"6092:1": 4000}, {"feed": "10000"}, "feed"),
        ({"608F:1": 8192}, {"encoder": "10000"}, "encoder"),
    ],
)
def test_a_factor_group_that_differs_is_refused(objects: dict[str, int], options: dict[str, str], words: str) -> None:
    async def main(world: Drives) -> None:
        await world.driver.connect()
        with pytest.raises(ControllerFault) as caught:
            await world.driver.configure()
        assert caught.value.code == "config-mismatch"
        assert words in caught.value.text
        assert caught.value.remedy

    run(main, simulate={"objects": objects}, options=options)


def test_a_factor_group_that_agrees_is_accepted_and_both_ramps_are_loaded() -> None:
    """A halt before the first move brakes with the deceleration that the drive has by then."""

    async def main(world: Drives) -> None:
        await world.driver.connect()
        await world.driver.configure()
        held = world.unit.station.dictionary
        assert [held.get_value(index) for index in (0x6083, 0x6084)] == [round(ACCELERATION)] * 2

    ratios = {"gear": "7/2", "feed": "10000/3", "encoder": "8192"}
    objects = {"6091:1": 7, "6091:2": 2, "6092:1": 10_000, "6092:2": 3, "608F:1": 8192, "6083": 90, "6084": 80}
    run(main, simulate={"objects": objects}, options=ratios)


def test_a_missing_node_is_reported() -> None:
    async def main(world: Drives) -> None:
        world.unit.set_power(on=False)
        with pytest.raises(ControllerFault) as caught:
            await world.driver.connect()
        assert caught.value.code == "no-answer"
        assert "node number" in caught.value.remedy

    run(main)


def test_duplicate_answers_are_reported() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        world.wire.to_near = lambda data: data * 2 if data[:4] == bytes.fromhex("81050000") else data
        with pytest.raises(ControllerFault) as caught:
            for _ in range(10):
                await world.driver.send_raw("6041:0/16")
                await world.rest(5)
        assert caught.value.code == "two-answers"
        assert caught.value.remedy

    run(main)


def test_a_late_answer_is_not_taken_for_that_to_another_request() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        held: list[bytes] = []

        def delay(data: bytes) -> bytes:
            if data[:4] != bytes.fromhex("81050000"):
                return data
            held.append(data)
            return b"" if len(held) == 1 else b"".join(held)

        await world.driver.send_raw("6081:0/32=1234")
        world.wire.to_near = delay
        with pytest.raises(ControllerFault) as caught:
            await world.driver.send_raw("6041:0/16")
        assert caught.value.code == "no-answer"
        assert await world.driver.send_raw("6081:0/32") == "1234"

    run(main)


def test_sdo_aborts_are_reported_in_words() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        for command, words in (
            ("5FFF:0/32", "object does not exist"),
            ("6041:0/16=1", "read only"),
            ("1018:9/32", "sub-index does not exist"),
            ("6083:0/32=0", "invalid value"),
            ("6081:0/16=1", "length"),
        ):
            with pytest.raises(ControllerFault, match=words) as caught:
                await world.driver.send_raw(command)
            assert caught.value.code == "sdo-abort"
        with pytest.raises(Refusal) as refused:
            await world.driver.send_raw("hello")
        assert refused.value.code == "raw-line"

    run(main)


def test_an_emergency_between_arming_and_the_promise_is_detected() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = world.clock.now_ns() + 400 * NS_PER_MS
        await world.arm(0, 40_000, t0_ns)
        world.unit.station.drive.enter_fault(0x4310, 0)
        await world.rest(5)
        with pytest.raises(Refusal) as caught:
            await world.driver.slots.present.verify()
        assert "excess temperature of the drive (4310h)" in caught.value.text
        await world.driver.slots.unload()
        await world.until(t0_ns + 200 * NS_PER_MS)
        assert not world.unit.commanded_motions

    run(main)


def test_a_fault_just_before_the_start_is_reported_by_its_emergency() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await world.go()
        await world.until(t0_ns - 10 * NS_PER_MS)
        world.unit.station.drive.enter_fault(0x3210, 0)
        with pytest.raises(ControllerFault) as caught:
            await world.driver.slots.present.wait_for_start()
        assert "DC link over-voltage (3210h)" in caught.value.text
        assert not world.unit.commanded_motions

    run(main)


_EDS = Path(cia402.__file__).with_name("drive.eds")


def test_the_drives_own_eds_file_is_accepted() -> None:
    async def main(world: Drives) -> None:
        await world.ready()

    run(main, options={"eds": str(_EDS)})


def test_the_eds_file_of_another_product_is_detected(tmp_path: Path) -> None:
    other = tmp_path / "other.eds"
    other.write_text(_EDS.read_text().replace("ProductNumber=0x00000402", "ProductNumber=0x00000777"))

    async def main(world: Drives) -> None:
        with pytest.raises(ControllerFault) as caught:
            await world.driver.connect()
        assert caught.value.code == "config-mismatch"
        assert "0x00000777" in caught.value.text

    run(main, options={"eds": str(other)})


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[6064]", "[5064]", "no position actual value"),
        ("[DeviceInfo]", "rubbish [DeviceInfo", "cannot be read"),
        ("", "", "cannot be read"),
    ],
)
def test_an_eds_file_that_is_not_enough_is_refused_offline(tmp_path: Path, old: str, new: str, words: str) -> None:
    other = tmp_path / "other.eds"
    if old:
        text = _EDS.read_text()
        other.write_text(new + "\n" + text if words != "no position actual value" else text.replace(old, new))
    with pytest.raises(ValueError, match=words):
        MAKE.check_config(config(1, {"eds": str(other)}))


def test_a_drive_that_accepts_a_mapping_only_pre_operational_is_switched_to_it() -> None:
    commands: list[int] = []

    async def main(world: Drives) -> None:
        def orders(data: bytes) -> bytes:
            frame = decode_frames(data)[0] if len(data) == FRAME_BYTES else None
            if frame is not None and frame.id == 0:
                commands.append(frame.data[0])
            return data

        def refuses(data: bytes) -> bytes:
            frame = decode_frames(data)[0]
            if frame.id == 0x581 and frame.data[:3] == bytes.fromhex("600014") and 0x80 not in commands:
                return encode_frames(CanFrame(0x581, bytes.fromhex("8000140122000008")))
            return data

        world.wire.to_far, world.wire.to_near = orders, refuses
        await world.ready()
        assert commands == [0x80, 0x01]
        await world.go()
        await world.driver.slots.present.wait_for_start()
        assert (await world.driver.slots.present.wait_for_end()).state == "done"

    run(main)


def test_a_new_connection_stops_a_moving_drive_before_it_queries_anything() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await world.go(target=400_000)
        await world.driver.slots.present.wait_for_start()
        await world.until(t0_ns + 500 * NS_PER_MS)
        fresh = world.fresh()
        assert await fresh.stop_before_connect()
        await world.rest(300)
        assert not world.unit.is_moving("1")
        await fresh.connect()
        await fresh.configure()
        await fresh.set_enabled(["a"], on=True)
        assert (await fresh.poll()).axes["a"].enabled
        await fresh.close()

    run(main)


STATUS = 0x181  # PDO with the statusword of node 1
AT_REST, DISABLED = 0x0637, 0x0250


def replace_status(word: int) -> Callable[[bytes], bytes]:
    """Return a hook for a wire: every statusword is `word`."""

    def change(frame: CanFrame) -> CanFrame:
        return CanFrame(STATUS, word.to_bytes(2, "little") + frame.data[2:]) if frame.id == STATUS else frame

    return lambda data: encode_frames(*map(change, decode_frames(data)))


@pytest.mark.parametrize("how", ["closed", "wrong status"])
def test_a_halt_that_was_not_completed_is_no_motion_of_the_next_step(how: str) -> None:
    """The halt keeps the target: the connection ended within the ramp, or the drive seemed to be disabled."""

    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await world.go(target=400_000)
        await world.driver.slots.present.wait_for_start()
        await world.until(t0_ns + 700 * NS_PER_MS)
        await world.driver.stop(abort=False)
        if how == "closed":
            await world.rest(2)
            await world.driver.close()
        else:
            world.wire.to_near = replace_status(DISABLED)
            await world.rest(100)
            world.wire.to_near = None
        await world.rest(500)
        assert not world.unit.is_moving("1")
        here = world.unit.position("1")
        await world.ready()
        await world.rest(500)
        assert world.unit.position("1") == here
        begin = (await world.driver.poll()).axes["a"].commanded_counts
        await world.arm(0, begin + 3000, world.clock.now_ns() + 400 * NS_PER_MS, begin)
        assert world.unit.position("1") == here
        await world.driver.slots.present.release()
        await world.driver.slots.present.wait_for_start()
        assert (await world.driver.slots.present.wait_for_end()).state == "done"

    run(main)


def test_a_stop_reaches_a_moving_drive_that_seems_to_be_disabled() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await world.go(target=400_000)
        await world.driver.slots.present.wait_for_start()
        await world.until(t0_ns + 500 * NS_PER_MS)
        world.unit.set_input(3, level=True)
        world.wire.to_near = replace_status(DISABLED)
        await world.rest(100)
        await world.driver.stop(abort=False)
        await world.rest(500)
        assert not world.unit.is_moving("1")

    run(main)


@pytest.mark.parametrize("lost", [False, True])
def test_a_stop_of_an_earlier_connection_stops_no_later_motion(lost: bool) -> None:
    """It was given while this computer was off the bus, and its frames are repeated when that is back."""

    async def main(world: Drives) -> None:
        await world.ready()
        bus, driver = world.shared[SHARED], world.driver
        bus._handle_bus_state(ERROR_BUS_OFF)
        await driver.stop(abort=True)
        if lost:
            world.wire.links[0].hang_up()
            await world.rest(20)
        await driver.close()
        await world.ready()
        await world.go(target=40_000)
        await driver.slots.present.wait_for_start()
        bus._handle_bus_state(ERROR_BUS_OFF)
        bus._handle_bus_state(ERROR_RESTARTED)
        await world.rest(50)
        # The host cannot follow the move any more, and the drive goes on.
        assert world.unit.is_moving("1") and world.unit.station.drive.states.state.name == "ENABLED"
        await world.rest(3000)
        assert world.unit.position("1") == 40_000

    run(main)
