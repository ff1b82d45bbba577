"""Client commands in processes that see what Windows has and nothing more (`tests/without_unix`), on the demo fleet of this
computer. Every command is in one of the lists below: it runs, or says in one line that it cannot be had."""

import json
import os
import pty
import signal
import socket
import subprocess
import sys
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest
from children import LIMIT_S
from fleet import EXAMPLES, RunningFleet
from unit.cli.test_command_rule import leaves

pytestmark = pytest.mark.live

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "tests" / "without_unix"
COMMAND = [sys.executable, "-c", "from orchestrator.cli.main import main; main(prog_name='tutti')"]
JOB = {"schema": "tutti.job/1", "name": "own", "steps": [{"do": "move", "to": {"gantry.x": 3, "stage.u": 1}}]}
UNITS = {"schema": "tutti.job/1", "name": "long", "steps": [{"do": "dwell", "duration": "60 s"}]}

# What a command is run with, its exit code, and what it says. In this order, on one fleet.
RUNS: list[tuple[str, int, str]] = [
    # Files.
    ("schema job", 0, '"tutti.job/1"'),
    ("completion bash", 0, "_tutti_completion()"),
    ("fleet init --make smc4000 -o lab.fleet.yaml", 0, "1 controllers, 2 axes"),
    ("fleet check {examples}/demo.fleet.yaml", 0, "no problem found"),
    ("fleet expand {examples}/hall.fleet.yaml", 0, '"tutti.fleet/1"'),
    ("zones check {examples}/zones.fleet.yaml", 0, "3 bodies, 4 rules"),
    ("job check {examples}/demo.job.yaml --fleet {examples}/demo.fleet.yaml", 0, "no problem found"),
    ("job parameters {examples}/scan.template.job.yaml", 0, "length of a line"),
    ("path import {examples}/lathe-z.csv --to z.job.yaml", 0, "9 pieces"),
    ("adapter ls", 0, "smc4000"),
    ("adapter new mc2000 --into mc2000", 0, "9 files"),
    ("adapter check mc2000", 2, "no adapter 'mc2000'"),
    ("sim check smc30 {vectors}/smc30.vectors.jsonl --only smc30-001-checksum-1A3", 0, "1 passed"),
    ("doctor --state state", 0, "clients"),
    # Certificates and users.
    ("keys init --keys keys --fleet demo", 0, "the authority of fleet demo is in keys"),
    ("keys add-coordinator second --keys keys", 0, "coordinator-second.1"),
    ("keys add-gateway second --keys keys --address localhost", 0, "gateway-second.1"),
    ("keys add-host lab2 --keys keys", 0, "host-lab2.1"),
    ("keys add-opcua --keys keys --address localhost", 0, "cert.der"),
    ("keys add-router second --keys keys --address 127.0.0.1", 0, "router-second.1"),
    ("keys add-user anna --role operator --keys keys", 0, "operator-anna.1"),
    ("keys renew operator-anna --keys keys", 0, "operator-anna.2"),
    ("keys revoke host-lab2 --keys keys", 0, "host-lab2"),
    ("keys ls --keys keys", 0, "revoked"),
    ("router --print-config", 0, '"mode": "router"'),
    ("user add anna --role operator --state users --no-password", 0, "user anna is operator"),
    ("user ls --state users", 0, "tokens only"),
    ("user role anna viewer --state users", 0, "user anna is viewer"),
    ("user token anna --name ci --state users", 0, "tutti_anna_"),
    ("user passwd anna --password-stdin --state users", 2, "8 to 1000 characters"),
    ("user rm anna --state users", 0, "user anna is removed"),
    # The files of a fleet, as it has left them.
    ("journal check --state {state}", 0, "no damage found"),
    ("journal backup --state {state} -o backup.tar", 0, "files of"),
    ("journal export --state {state} -o journal.tar", 0, "records"),
    ("journal import backup.tar --state other", 0, "imported"),
    ("log --state {state} --last 5", 0, "Z  "),
    # A fleet.
    ("estop --reason test", 0, "gantry: latched"),
    ("alarm ls", 0, "estop-fleet"),
    ("alarm shelve estop-fleet --for 1h --why test", 0, "shelved"),
    ("alarm unshelve estop-fleet", 0, "estop-fleet"),
    ("reset", 0, "gantry: reset"),
    ("alarm ack --all", 0, "estop-fleet"),
    ("zones show", 2, "no `zones`"),
    ("wiring check", 1, "no `wiring`"),
    ("stats", 0, "jobs:"),
    ("clock ls", 0, "gantry"),
    ("clock show gantry", 0, "starts by"),
    ("clock forget gantry", 0, "forgotten"),
    ("repair epoch", 0, "nothing was changed"),
    ("coordinator hand-over", 1, "no standby waits"),
    ("raw gantry MG", 1, "--i-know"),
    ("trace gantry", 0, "data record"),
    ("status", 0, "gantry"),
    ("fleet reload {examples}/demo.fleet.yaml", 0, "no controller changed"),
    ("axis enable gantry stage", 0, "enabled: gantry.x"),
    ("axis home", 0, "homed: gantry.x"),
    ("axis ls", 0, "ready"),
    ("axis limits gantry.x", 0, "gantry.x"),
    ("axis move gantry.x=5", 0, "gantry.x 5.000 mm"),
    ("axis acquire gantry --for 1h", 0, "acquired: gantry.x"),
    ("axis release gantry", 0, "released: gantry"),
    ("position save here gantry", 0, "here"),
    ("position show here", 0, "gantry.x"),
    ("position goto here", 0, "gantry.x 5.000 mm"),
    ("position ls", 0, "here"),
    ("position rm here", 0, "here"),
    ("live gantry", 0, "gantry.x 6.0000 mm"),
    ("io ls", 0, "gantry.lamp"),
    ("io set gantry.lamp on", 0, "gantry.lamp is on"),
    ("queue start", 0, "the queue is running"),
    ("job submit own.job.yaml --wait", 0, "done"),
    ("job show last", 0, "own"),
    ("job report last", 0, "own"),
    ("job plot last -o skew.png", 0, "skew.png"),
    ("job timeline last", 0, "coordinator"),
    ("job points last", 0, "no recorded points"),
    ("job retry last --yes", 0, "is accepted"),
    ("job continue last --yes-move --yes-start", 1, "job "),
    ("submit long.job.yaml --hold", 0, "held by"),
    ("job plan last", 0, "held by"),
    ("job approve last --yes", 1, "not proposed"),
    ("job hold last", 0, "held"),
    ("job reorder last --before last", 1, "before"),
    ("job release last", 0, "released"),
    ("job override last 50", 0, "50 %"),
    ("job pause last", 0, "pauses"),
    ("job resume last", 0, "continues"),
    ("job go last", 1, "no step that waits armed"),
    ("job cancel last", 0, "is cancelled"),
    ("job ls", 0, "cancelled"),
    ("job prune --older 365d", 0, "jobs"),
    ("queue stop", 0, "the queue is stopped"),
    ("queue status", 0, "the queue is stopped"),
    ("record ls --folder {state}/recordings", 0, "recordings"),
    ("record repair fleet.mcap", 0, "messages"),
    ("export fleet.mcap --to csv -o positions.csv", 0, "positions.csv"),
    ("axis set-position gantry.x=5", 0, "gantry.x 5.000 mm"),
    ("axis disable gantry", 0, "gantry"),
    ("axis stop", 0, "gantry: stopped"),
    ("stop", 0, "stage: stopped"),
    ("command ls", 0, "stop-queue"),
]
INPUTS = {"live gantry": "move gantry.x=6\nend\n"}
# What they compute takes long, and they draw.
COMPUTE = [
    ("path plot {examples}/path.job.yaml --fleet {examples}/path.fleet.yaml -o path.png", 0, "path.png"),
    ("zones plot {examples}/zones.fleet.yaml -o zones.png", 0, "written: zones.png"),
    ("sim campaign --seeds 1", 0, "smc4000"),
    ("demo --path", 0, "off the path"),
]
# They go on until they are interrupted, each with a test of its own below.
ENDLESS = {"watch", "record start", "sim serve"}
# They need packages that are not installed here. `make test-ecosystem` has tests of what they do.
NOT_INSTALLED = [
    "epics serve",
    "mqtt serve --broker 127.0.0.1",
    "opcua serve --templates .",
    "ros2 serve",
    "job from-useq own.job.yaml --map x=gantry.x -o useq.job.yaml",
]
# What Windows cannot have; on macOS those of UNIX run.
UNIX = [
    "axis jog",
    "sim analog gantry 1 1",
    "sim contact gantry.touch gantry.x 1",
    "sim input gantry.door active",
    "sim limit gantry.x forward",
    "sim power gantry off",
    "sim push gantry.x 1",
    "sim stall gantry.x on",
]
LINUX = [
    "up {examples}/demo.fleet.yaml --sim",
    "host lab2 --fleet demo",
    "coordinator run {examples}/demo.fleet.yaml --journal postgresql://t@a/t --connect tcp/127.0.0.1:1",
    "down",
    "service install {examples}/demo.fleet.yaml router",
    "service udev",
    "demo",
    "router",
    "adapter probe tcp:127.0.0.1:1 MG",
    *(
        f"bench {name}"
        for name in (
            "dispatch",
            "estop",
            "firing",
            "jog",
            "journal",
            "kills",
            "permit",
            "record",
            "scale",
            "steps",
            "sync",
        )
    ),
]


@cache
def list_commands() -> frozenset[str]:
    """The names of all commands."""
    return frozenset(name for name, _ in leaves())


def find_command(words: str) -> str:
    """The command of a line."""
    return max((name for name in list_commands() if f"{words} ".startswith(f"{name} ")), key=len)


class OtherSystem:
    """A process that runs commands, and sees what another system has."""

    def __init__(self, folder: Path, system: str, fleet: RunningFleet | None = None) -> None:
        self.folder = folder
        self.places = {"examples": EXAMPLES, "vectors": ROOT / "tests/contract/vectors", "state": fleet and fleet.state}
        self.environment = make_environment(system, fleet)
        self.process = subprocess.Popen(
            [sys.executable, str(FOLDER / "run_commands.py")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=folder,
            env=self.environment,
        )

    def run(self, line: str) -> tuple[int, str]:
        """Exit code and output of a command."""
        assert self.process.stdin is not None and self.process.stdout is not None
        words = [word.format_map(self.places) for word in line.split()]
        self.process.stdin.write(json.dumps({"words": words, "input": INPUTS.get(line)}) + "\n")
        self.process.stdin.flush()
        result = json.loads(self.process.stdout.readline())
        return result["code"], result["text"]

    def close(self) -> None:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.close()
        self.process.stdout.close()
        self.process.wait(LIMIT_S)


def make_environment(system: str, fleet: RunningFleet | None) -> dict[str, str]:
    connect = {} if fleet is None else {"TUTTI_CONNECT": fleet.endpoint}
    # Text without a stated encoding is of another one on Windows.
    strict = {"PYTHONWARNDEFAULTENCODING": "1", "TUTTI_ACTOR": "lab", "TUTTI_TEST_SYSTEM": system}
    return {**os.environ, **connect, **strict, "PYTHONPATH": f"{FOLDER}{os.pathsep}{ROOT}"}


@pytest.fixture(scope="module")
def windows(tmp_path_factory: pytest.TempPathFactory, demo_fleet: RunningFleet) -> Iterator[OtherSystem]:
    folder = tmp_path_factory.mktemp("windows")
    for job in (JOB, UNITS):
        (folder / f"{job['name']}.job.yaml").write_text(json.dumps(job), encoding="utf-8")
    system = OtherSystem(folder, "win32", demo_fleet)
    yield system
    system.close()


def has_encoding_warning(text: str) -> bool:
    """Whether our code opens a text file without a stated encoding."""
    return any("EncodingWarning" in line and "site-packages" not in line for line in text.splitlines())


def test_every_command_is_in_one_list() -> None:
    lists = [[words for words, _, _ in RUNS], [words for words, _, _ in COMPUTE], NOT_INSTALLED, UNIX, LINUX]
    names = [{find_command(words) for words in lines} for lines in lists] + [ENDLESS]
    assert set().union(*names) == list_commands()
    # `demo` alone is in two: with --path it needs no processes. So is `router`, which prints its settings.
    assert sum(map(len, names)) - len(set().union(*names)) == 2


def test_client_commands_run(windows: OtherSystem, shared: RunningFleet) -> None:
    shared.ready()
    wrong: list[str] = []
    for line, code, said in RUNS:
        if line.startswith("record repair"):
            newest = max((shared.state / "recordings").glob("job-*-own-*.mcap"))
            (windows.folder / "fleet.mcap").write_bytes(newest.read_bytes())
        result, text = windows.run(line)
        if result != code or said not in text or has_encoding_warning(text):
            wrong.append(f"{line}: {result}: {text}")
    assert not wrong, "\n".join(wrong)
    shared.bring_back()


@pytest.mark.parametrize("line", [*UNIX, *LINUX])
def test_a_command_that_cannot_be_had_says_so_in_one_line(windows: OtherSystem, line: str) -> None:
    code, text = windows.run(line)
    systems = "Linux and macOS" if line in UNIX else "Linux"
    first, *more = text.strip().splitlines()
    assert code == 2 and first.endswith(f"can be had on {systems} only, and this is Windows"), text
    assert len(more) == 1  # the remedy


@pytest.mark.parametrize("line", NOT_INSTALLED)
def test_a_command_of_a_package_names_it(windows: OtherSystem, line: str) -> None:
    code, text = windows.run(line)
    assert code == 2 and "not installed: " in text


@pytest.mark.parametrize(("line", "code", "said"), COMPUTE)
def test_a_command_that_computes_runs(windows: OtherSystem, line: str, code: int, said: str) -> None:
    result, text = windows.run(line)
    assert result == code and said in text, text


# Processes that go on until they are interrupted


@contextmanager
def run_alone(
    folder: Path, fleet: RunningFleet | None, *words: str, stdin: int = subprocess.PIPE
) -> "Iterator[subprocess.Popen[str]]":
    """A command in a process of its own, killed at last if it has not ended."""
    process = subprocess.Popen(
        [*COMMAND, *words],
        stdin=stdin,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=folder,
        env=make_environment("win32", fleet),
    )
    with process:
        try:
            yield process
        finally:
            process.kill()


def read_until(process: "subprocess.Popen[str]", said: str) -> str:
    assert process.stdout is not None
    lines: list[str] = []
    while not lines or said not in lines[-1]:
        lines.append(process.stdout.readline())
        assert lines[-1], f"ended without {said!r}: {lines}"
    return lines[-1]


def interrupt(process: "subprocess.Popen[str]") -> tuple[int, str]:
    """Ctrl-C: the exit code, and what was still printed."""
    process.send_signal(signal.SIGINT)
    assert process.stdout is not None
    rest = process.stdout.read()
    return process.wait(LIMIT_S), rest


def test_axes_are_acquired_until_an_interrupt(tmp_path: Path, shared: RunningFleet) -> None:
    with run_alone(tmp_path, shared, "axis", "acquire", "gantry") as process:
        read_until(process, "acquired: gantry.x")
        assert interrupt(process) == (0, "released\n")


def test_an_interrupt_stops_a_job_that_is_attended(tmp_path: Path, shared: RunningFleet) -> None:
    shared.bring_back()
    job = {**JOB, "steps": [{"do": "move", "to": {"gantry.x": 201, "stage.u": 21}, "speed": 0.05}]}
    (tmp_path / "slow.job.yaml").write_text(json.dumps(job), encoding="utf-8")
    with run_alone(tmp_path, shared, "submit", "slow.job.yaml", "--wait", "--cancel-on-interrupt") as process:
        read_until(process, "running")
        code, rest = interrupt(process)
    assert code == 130 and "stopped: gantry.x" in rest
    shared.bring_back()


def test_watch_prints_lines(tmp_path: Path, shared: RunningFleet) -> None:
    with run_alone(tmp_path, shared, "watch", "--json") as process:
        assert json.loads(read_until(process, "/state"))["value"]["axes"]
        assert interrupt(process)[0] == 130


def test_an_armed_button_is_pressed_by_a_line(tmp_path: Path, shared: RunningFleet) -> None:
    with run_alone(tmp_path, shared, "estop", "--armed") as process:
        read_until(process, "a line of text here presses the button")
        read_until(process, "armed: connected")
        assert process.stdin is not None
        process.stdin.write("\npress\n")
        process.stdin.flush()
        read_until(process, "E-STOP SENT")
        read_until(process, "E-STOP LATCHED")
        assert interrupt(process) == (0, "disarmed\n")
    shared.bring_back()


def test_an_armed_button_is_pressed_by_a_key_of_the_console(tmp_path: Path, shared: RunningFleet) -> None:
    keys, console = pty.openpty()
    tty.setraw(console)
    with run_alone(tmp_path, shared, "estop", "--armed", stdin=console) as process:
        read_until(process, "any key here presses the button")
        read_until(process, "armed: connected")
        os.write(keys, b"x")
        read_until(process, "E-STOP LATCHED")
        os.write(keys, b"\x03")
        read_until(process, "disarmed")
        assert process.wait(LIMIT_S) == 0
    os.close(keys)
    os.close(console)
    shared.bring_back()


def test_an_armed_button_ends_with_its_input(tmp_path: Path, shared: RunningFleet) -> None:
    with run_alone(tmp_path, shared, "estop", "--armed") as process:
        read_until(process, "presses the button")
        assert process.stdin is not None
        process.stdin.close()
        read_until(process, "standard input has ended")
        assert process.wait(LIMIT_S) == 1


def test_a_fleet_is_recorded_from_there(tmp_path: Path, shared: RunningFleet) -> None:
    words = ("record", "start", "--fleet", "demo", "--folder", "own", "--metrics-port", "0")
    with run_alone(tmp_path, shared, *words) as process:
        read_until(process, "records fleet demo")
        with run_alone(tmp_path, shared, *words) as second:  # the folder is locked by the first
            read_until(second, "another recorder uses this folder")
        assert interrupt(process)[0] == 0
    assert list((tmp_path / "own").glob("*.mcap"))


def ask(port: int, command: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", port), LIMIT_S) as line:
        line.sendall(command)
        return line.recv(1000)


def test_a_simulator_is_served_by_tcp(tmp_path: Path) -> None:
    words = ("sim", "serve", "smc4000", "--truth", "--state", "state", "--json")
    with run_alone(tmp_path, None, *words) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline()]
        while lines[-1] != "}\n":
            lines.append(process.stdout.readline())
        (link,) = json.loads("".join(lines))["links"]
        assert ask(link["port"], b"MG 1+1\r").startswith(b" 0000000002.0000")
        assert interrupt(process) == (0, "")
    assert Path(link["controllers"][0]["truth"]).exists()
    with pytest.raises(OSError):
        ask(link["port"], b"MG 1+1\r")


def test_a_serial_line_is_not_simulated(windows: OtherSystem) -> None:
    code, text = windows.run("sim serve smc30")
    assert code == 2 and "can be had on Linux and macOS only" in text and "--link tcp" in text


def test_an_identity_is_used_whatever_the_mode_of_its_key(windows: OtherSystem) -> None:
    """Files on Windows have no mode, and Python makes up one by which all users may read them."""
    identity = windows.folder / "keys/identities/operator-anna"
    (identity / "key.pem").chmod(0o666)
    code, text = windows.run(f"--identity {identity} status --connect tls/127.0.0.1:1")
    assert code == 3 and "key.pem" not in text, text


def test_on_macos_commands_run_too(tmp_path: Path, shared: RunningFleet) -> None:
    system = OtherSystem(tmp_path, "darwin", shared)
    try:
        assert system.run("status")[0] == 0
        assert "and this is macOS" in system.run(LINUX[0])[1]
        assert "needs a terminal" in system.run("axis jog")[1]
    finally:
        system.close()
