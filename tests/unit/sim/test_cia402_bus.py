"""The simulated CiA 402 drive as a CANopen node: NMT, SDOs, PDOs, heartbeat, guarding, EMCY, permanent memory."""

import binascii
from itertools import pairwise

import pytest
from unit.sim.cia402_bench import MS, Aborted, CanBench

from orchestrator.link.can import ERROR_BUS_OFF, ERROR_RESTARTED

CONTROL, STATUS, MODE = 0x60400010, 0x60410010, 0x60600008
TARGET, ACTUAL, INPUTS = 0x607A0020, 0x60640020, 0x60FD0020
NAME = b"Simulated CiA 402 drive"


def test_boot_up_and_the_states_of_nmt() -> None:
    bench = CanBench(2)
    assert [frame.id for _, frame in bench.frames] == [0x701, 0x702]
    bench.write(0x1017, 0, 100, 2)
    for command, state in ((1, 5), (2, 4), (0x80, 127)):
        bench.send(0, bytes([command, 1]))
        bench.wait(150)
        assert bench.heard(0x701)[-1] == bytes([state])
    bench.send(0, bytes([2, 0]))
    bench.wait(5)
    assert bench.ask(bytes.fromhex("4041600000000000")) == []  # stopped: no SDOs
    for command in (0x81, 0x82):
        since_ns = bench.clock.now_ns()
        bench.send(0, bytes([command, 2]))
        bench.wait(300)
        assert bench.heard(0x702, since_ns) == [b"\0"]


def test_resets_restore_what_they_are_documented_to() -> None:
    bench = CanBench()
    bench.write(0x1017, 0, 100, 2)
    bench.write(0x6081, 0, 777, 4)
    bench.send(0, bytes([0x82, 1]))
    bench.wait(20)
    assert (bench.read(0x1017), bench.read(0x6081)) == (0, 777)
    bench.send(0, bytes([0x81, 1]))
    bench.wait(300)
    assert bench.read(0x6081) == 10_000


def test_the_permanent_memory() -> None:
    bench = CanBench(options={"objects": {"6091:1": 3}})
    bench.write(0x6081, 0, 777, 4)
    with pytest.raises(Aborted, match="0x08000020"):
        bench.write(0x1010, 1, 1, 4)
    bench.write(0x1010, 1, int.from_bytes(b"save", "little"), 4)
    assert bench.read(0x1010, 1) == 1
    bench.drive.set_power(on=False)
    bench.drive.set_power(on=True)
    bench.wait(300)
    assert (bench.read(0x6081), bench.read(0x6091, 1)) == (777, 3)
    bench.write(0x1011, 1, int.from_bytes(b"load", "little"), 4)
    assert bench.read(0x6081) == 777
    bench.send(0, bytes([0x81, 1]))
    bench.wait(300)
    assert (bench.read(0x6081), bench.read(0x6091, 1)) == (10_000, 3)


# SDOs


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        ("40 00 30 00", 0x0602_0000),
        ("40 18 10 09", 0x0609_0011),
        ("2f 41 60 00 01", 0x0601_0002),
        ("23 60 60 00 01", 0x0607_0012),
        ("2f 81 60 00 01", 0x0607_0013),
        ("2f 60 60 00 04", 0x0609_0030),
        ("2b 07 60 00 04", 0x0609_0031),
        ("2b 07 60 00 ff ff", 0x0609_0032),
        ("e0 00 00 00", 0x0504_0001),
        ("60 00 00 00", 0x0504_0001),
        ("21 08 10 00", 0x0601_0002),
        ("a0 08 10 00 80", 0x0504_0002),
        ("2f 00 16 00 01", 0x0601_0000),
        ("2f 00 14 02 f5", 0x0609_0030),
    ],
)
def test_abort_codes(request_: str, code: int) -> None:
    bench = CanBench()
    data = bytes.fromhex(request_).ljust(8, b"\0")
    (answer,) = bench.ask(data)
    assert answer[0] == 0x80
    assert int.from_bytes(answer[4:], "little") == code
    assert bench.read(0x1018, 4) == 1  # and it serves on


def test_an_object_that_a_drive_is_built_without() -> None:
    bench = CanBench(options={"without": ["1013"]})
    with pytest.raises(Aborted, match="0x06020000"):
        bench.read(0x1013)


def test_a_segmented_upload_and_its_toggle_bit() -> None:
    bench = CanBench()
    (answer,) = bench.ask(bytes.fromhex("4008100000000000"))
    assert answer == bytes.fromhex("41081000") + len(NAME).to_bytes(4, "little")
    parts = [bench.ask(bytes([0x60 | n % 2 << 4]).ljust(8, b"\0"))[0] for n in range(4)]
    assert b"".join(part[1:] for part in parts)[: len(NAME)] == NAME
    assert [part[0] for part in parts] == [0x00, 0x10, 0x00, 0x10 | (28 - len(NAME)) << 1 | 1]
    bench.ask(bytes.fromhex("4008100000000000"))
    (refused,) = bench.ask(b"\x70".ljust(8, b"\0"))
    assert refused == bytes.fromhex("80081000 00000305")


def test_a_segmented_download() -> None:
    bench = CanBench()
    assert bench.ask(bytes.fromhex("21816000 04000000")) == [bytes.fromhex("60816000 00000000")]
    assert bench.ask(bytes.fromhex("07 d2040000 000000")) == [b"\x20" + bytes(7)]
    assert bench.read(0x6081) == 1234
    bench.ask(bytes.fromhex("21816000 04000000"))
    (refused,) = bench.ask(bytes.fromhex("09 d2040000 000000"))
    assert int.from_bytes(refused[4:], "little") == 0x0607_0010


def test_a_segmented_transfer_is_given_up_when_its_client_is_silent() -> None:
    bench = CanBench()
    bench.ask(bytes.fromhex("4008100000000000"))
    since_ns = bench.clock.now_ns()
    bench.wait(1100)
    assert bench.heard(0x581, since_ns) == [bytes.fromhex("80081000 00000405")]


def test_a_block_upload_with_a_repeated_block() -> None:
    bench = CanBench()
    (answer,) = bench.ask(bytes.fromhex("a4081000 02000000"))
    assert answer == bytes.fromhex("c6081000") + len(NAME).to_bytes(4, "little")
    first = bench.ask(b"\xa3".ljust(8, b"\0"))
    assert [part[0] for part in first] == [1, 2]
    again = bench.ask(bytes([0xA2, 1, 5, 0, 0, 0, 0, 0]))  # the second one was lost
    assert [part[0] for part in again] == [1, 2, 0x83]
    assert (first[0][1:] + b"".join(part[1:] for part in again))[: len(NAME)] == NAME
    (end,) = bench.ask(bytes([0xA2, 3, 5, 0, 0, 0, 0, 0]))
    assert end[0] == 0xC1 | (28 - len(NAME)) << 2
    assert int.from_bytes(end[1:3], "little") == binascii.crc_hqx(NAME, 0)
    assert bench.ask(b"\xa1".ljust(8, b"\0")) == []
    assert bench.read(0x1018, 4) == 1


@pytest.mark.parametrize(("spoil", "code"), [(0, None), (1, 0x0504_0004)])
def test_a_block_download_and_its_crc(spoil: int, code: int | None) -> None:
    bench = CanBench()
    value = (4711).to_bytes(4, "little")
    assert bench.ask(bytes.fromhex("c6816000 04000000")) == [bytes.fromhex("a4816000 7f000000")]
    assert bench.ask(b"\x81" + value + bytes(3)) == [bytes.fromhex("a2017f00 00000000")]
    crc = (binascii.crc_hqx(value, 0) ^ spoil).to_bytes(2, "little")
    (end,) = bench.ask(bytes([0xC1 | 3 << 2]) + crc + bytes(5))
    if code is None:
        assert end[0] == 0xA1
        assert bench.read(0x6081) == 4711
    else:
        assert int.from_bytes(end[4:], "little") == code
        assert bench.read(0x6081) == 10_000


# PDOs


def test_synchronous_pdos_wait_for_sync() -> None:
    bench = CanBench()
    rpdo = bench.map(True, 1, [CONTROL, MODE], 0)
    tpdo = bench.map(False, 1, [STATUS, ACTUAL], 2)
    bench.start()
    bench.send(rpdo, b"\x06\0\x01")
    bench.wait(5)
    assert bench.status() & 0x6F == 0x40
    for _ in range(4):
        bench.send(0x80)
        bench.wait(5)
    assert bench.status() & 0x6F == 0x21
    assert bench.read(0x6061) == 1
    assert [data[0] & 0x6F for data in bench.heard(tpdo)] == [0x21, 0x21]  # with every second SYNC


def test_an_acyclic_synchronous_pdo_is_sent_after_a_change_only() -> None:
    bench = CanBench()
    tpdo = bench.map(False, 1, [STATUS], 0)
    bench.start()
    for _ in range(3):
        bench.send(0x80)
        bench.wait(2)
    assert len(bench.heard(tpdo)) == 1
    bench.control(0x06)
    bench.send(0x80)
    bench.wait(2)
    assert len(bench.heard(tpdo)) == 2


def test_an_event_driven_pdo_keeps_its_inhibit_time_and_its_event_timer() -> None:
    bench = CanBench()
    bench.write(0x1800, 1, 0x80000181, 4)
    bench.write(0x1800, 3, 200, 2)  # 20 ms
    bench.write(0x1800, 5, 50, 2)
    bench.map(False, 1, [INPUTS], 255)
    bench.start()
    bench.wait(25)
    since_ns = bench.clock.now_ns()
    for level in (True, False, True):
        bench.drive.set_input(1, level=level)
        bench.wait(5)
    assert len(bench.heard(0x181, since_ns)) == 1
    bench.wait(15)
    assert len(bench.heard(0x181, since_ns)) == 1  # on, off and on again is no change
    bench.drive.set_input(1, level=False)
    bench.wait(110)
    times = [at for at, frame in bench.frames if frame.id == 0x181 and at > since_ns]
    assert len(times) == 4
    assert [round((b - a) / MS) for a, b in pairwise(times[1:])] == [50, 50]


def test_a_position_is_sent_while_it_changes_and_not_at_rest() -> None:
    bench = CanBench()
    tpdo = bench.map(False, 1, [ACTUAL], 255)
    bench.enable(3)
    bench.start()
    since_ns = bench.clock.now_ns()
    bench.wait(100)
    assert len(bench.heard(tpdo, since_ns)) == 0
    bench.write(0x60FF, 0, 50_000, 4)
    bench.wait(100)
    assert 90 <= len(bench.heard(tpdo, since_ns)) <= 110


def test_a_pdo_is_requested_by_a_remote_frame() -> None:
    bench = CanBench()
    bench.start()
    since_ns = bench.clock.now_ns()
    bench.send(0x181, bytes(2), rtr=True)
    bench.wait(2)
    assert len(bench.heard(0x181, since_ns)) == 1


def test_a_pdo_that_is_too_short_is_reported_by_an_emergency() -> None:
    bench = CanBench()
    bench.map(True, 1, [CONTROL], 255)
    bench.start()
    bench.send(0x201, b"\x06")
    bench.wait(2)
    assert bench.heard(0x81)[-1][:2] == bytes([0x10, 0x82])
    assert bench.status() & 0x6F == 0x40


@pytest.mark.parametrize(
    ("objects", "code"),
    [
        ([0x10000020], 0x0604_0041),
        ([STATUS], 0x0604_0041),
        ([0x60400020], 0x0604_0041),
        ([0x30000008], 0x0602_0000),
        ([TARGET, 0x60810020, CONTROL], 0x0604_0042),
    ],
)
def test_an_impossible_mapping_is_refused(objects: list[int], code: int) -> None:
    bench = CanBench()
    with pytest.raises(Aborted) as refused:
        bench.map(True, 1, objects, 255)
    assert refused.value.code == code


@pytest.mark.parametrize(("value", "code"), [(0x203, 0x0609_0030), (0x601, 0x0609_0030), (0x20000201, 0x0609_0030)])
def test_an_impossible_identifier_is_refused(value: int, code: int) -> None:
    bench = CanBench()
    with pytest.raises(Aborted) as refused:
        bench.write(0x1400, 1, value, 4)
    assert refused.value.code == code


# Being watched


def test_node_guarding_toggles_and_its_loss_is_an_emergency() -> None:
    bench = CanBench()
    bench.write(0x100C, 0, 20, 2)
    bench.write(0x100D, 0, 3, 1)
    since_ns = bench.clock.now_ns()
    for _ in range(3):
        bench.send(0x701, bytes(1), rtr=True)
        bench.wait(20)
    assert bench.heard(0x701, since_ns) == [b"\x7f", b"\xff", b"\x7f"]
    bench.enable(1)
    bench.wait(60)
    assert bench.heard(0x81)[-1][:3] == bytes([0x30, 0x81, 0x11])
    assert bench.status() & 0x4F == 0x08


@pytest.mark.parametrize(("code", "ends"), [(0, 0x27), (1, 0x08), (2, 0x40), (3, 0x40)])
def test_a_master_that_falls_silent_stops_the_motor_as_configured(code: int, ends: int) -> None:
    bench = CanBench()
    bench.write(0x6007, 0, code, 2)
    bench.write(0x1016, 1, 0x007F0032, 4)  # node 127, 50 ms
    bench.enable(3)
    bench.start()
    bench.write(0x60FF, 0, 5_000, 4)
    for _ in range(5):
        bench.send(0x77F, b"\x05")
        bench.wait(40)
    assert bench.drive.velocity("1") == pytest.approx(5_000)
    bench.wait(250)
    assert bench.status() & 0x4F == ends & 0x4F
    assert bench.drive.is_moving("1") == (code == 0)
    assert bench.heard(0x81)[-1][:2] == bytes([0x30, 0x81])


def test_the_computers_controller_leaves_the_bus_and_comes_back() -> None:
    bench = CanBench()
    bench.bus.disturb_frames(32)
    bench.send(0x181, bytes(2), rtr=True)
    bench.wait(20)
    troubles = [frame.id for _, frame in bench.frames if frame.error]
    assert troubles[-1] == ERROR_BUS_OFF
    with pytest.raises(ValueError, match="not enough values"):
        bench.read(0x6041)  # nothing is sent
    bench.wait(150)
    assert [frame.id for _, frame in bench.frames if frame.error][-1] == ERROR_RESTARTED
    assert bench.status() & 0x4F == 0x40


def test_a_drive_in_bus_off_stops_and_comes_back_with_an_emergency() -> None:
    bench = CanBench()
    bench.enable(3)
    bench.write(0x60FF, 0, 5_000, 4)
    bench.wait(100)
    bench.bus.disturb_frames(32)
    bench.drive.station.emergencies.send_emergency(0x1000, 1)  # the frame that it is sending when the errors come
    bench.wait(50)
    assert bench.drive.station.can.node_state == "off"
    assert not bench.drive.is_moving("1")
    bench.wait(700)
    assert bench.heard(0x81)[-1][:2] == bytes([0x40, 0x81])
    assert bench.status() & 0x4F == 0x08


def test_the_time_stamp_runs_on_the_drives_own_crystal() -> None:
    bench = CanBench(drift_ppm=[200.0])
    bench.write(0x1013, 0, 0, 4)
    bench.wait(10_000)
    assert bench.read(0x1013) == pytest.approx(10_000_000 * (1 + 200e-6), abs=6000)
    tpdo = bench.map(False, 1, [0x10130020], 1)
    bench.start()
    for _ in range(2):
        bench.send(0x80)
        bench.wait(1000)
    first, second = (int.from_bytes(data, "little") for data in bench.heard(tpdo))
    assert second - first == pytest.approx(1_000_200, abs=15)


def test_a_wrong_option_is_named() -> None:
    with pytest.raises(ValueError, match="6999"):
        CanBench(options={"objects": {"6999": 1}})
    with pytest.raises(ValueError, match="cycle_us"):
        CanBench(options={"cycle_us": 0})


def test_emergencies_keep_their_inhibit_time() -> None:
    bench = CanBench()
    bench.write(0x1015, 0, 50, 2)
    began_ns = bench.clock.now_ns()
    for code in (0x4310, 0x3210, 0x2310):
        bench.drive.station.emergencies.send_emergency(code, 1)
    bench.wait(20)
    told = [(at_ns, frame.data[:2]) for at_ns, frame in bench.frames if frame.id == 0x81 and at_ns >= began_ns]
    assert [data for _, data in told] == [b"\x10\x43", b"\x10\x32", b"\x10\x23"]
    assert [round((after - before) / MS) for (before, _), (after, _) in pairwise(told)] == [5, 5]


def test_positions_are_not_buffered_and_no_client_can_have_it_otherwise() -> None:
    bench = CanBench()
    assert [bench.read(0x60C4, sub) for sub in (1, 2, 3, 4)] == [1, 1, 0, 0]
    bench.write(0x60C4, 6, 1, 1)
    with pytest.raises(Aborted, match="0x06090031"):
        bench.write(0x60C4, 2, 2, 4)
    with pytest.raises(Aborted, match="0x06010001"):
        bench.read(0x60C4, 6)
