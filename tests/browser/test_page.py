"""The page against a fleet: what is seen is what the simulated controllers did."""

import json
import re
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import pytest
from browser.conftest import LARGE, find_address, find_program
from browser.devtools import open_tools
from browser.test_gamepad import PAD, set_pad
from browser.test_rules import wait_for
from children import wait_until
from fleet import RunningFleet
from playwright.sync_api import Browser, Page, Route, WebSocketRoute, expect

from orchestrator.clock.live import LiveClock, raw_ns
from orchestrator.gateway.access.roles import Role
from orchestrator.gateway.access.users import UserFile

PASSWORD = "correct horse"
JOG_MOST_NS = 700_000_000  # 200 ms and the ramp; the rest for a busy machine
AXE = Path(__file__).parents[2] / "orchestrator" / "gateway" / "page" / "node_modules" / "axe-core" / "axe.min.js"
FAR = {"do": "move", "to": {"gantry.x": 100}}


@pytest.fixture(scope="module")
def ready(fleet: RunningFleet) -> RunningFleet:
    fleet.ready()
    assert fleet.run([FAR]).state == "done"
    return fleet


@pytest.fixture
def users(fleet: RunningFleet) -> Iterator[UserFile]:
    """Users of each role, each with `PASSWORD`; none again after the test."""
    file = UserFile(fleet.state / "users.json")
    roles: dict[str, Role] = {"vera": "viewer", "paul": "proposer", "olga": "operator", "mia": "maintainer"}
    for name, role in roles.items():
        file.add_user(name, role, PASSWORD, LiveClock().utc())
    try:
        yield file
    finally:
        file.path.unlink()


def open_page(page: Page, fleet: RunningFleet, view: str = "run") -> None:
    page.goto(f"{find_address(fleet)}#{view}")
    page.get_by_role("region", name={"run": "Axes", "setup": "Jog", "service": "Clocks"}[view], exact=True).wait_for()


def sign_in(page: Page, fleet: RunningFleet, user: str, view: str = "run") -> None:
    page.goto(f"{find_address(fleet)}#{view}")
    page.get_by_label("User", exact=True).fill(user)
    page.get_by_label("Password").fill(PASSWORD)
    page.get_by_role("button", name="Sign in").click()
    page.get_by_test_id("axis-gantry.x").first.wait_for()


def begin_jog(page: Page, fleet: RunningFleet, sign: str = "+") -> None:
    """Hold the jog button of gantry.x; the axis moves then. It is pressed again while another page holds the axis."""
    button = page.get_by_role("button", name=f"Jog gantry.x {sign}", exact=True)
    expect(button).not_to_have_attribute("aria-disabled", "true")
    begun = fleet.starts("gantry")
    button.hover()
    for _ in range(10):
        page.mouse.down()
        for _ in range(100):
            page.wait_for_timeout(20)
            if fleet.starts("gantry") > begun:
                return
        page.mouse.up()
    raise AssertionError(f"the axis does not move: {page.get_by_role('region', name='Messages').inner_text()}")


def require_end(fleet: RunningFleet, since_ns: int, page: Page | None = None) -> None:
    """Wait until gantry is at rest; it took no longer than it may."""

    def rests() -> bool:
        if page is not None:
            page.wait_for_timeout(20)
        return fleet.truth("gantry")[-1]["event"] == "end"

    wait_until(rests, "the axis is at rest")
    assert fleet.truth("gantry")[-1]["end_ns"] - since_ns < JOG_MOST_NS


def test_a_jog_that_is_let_go_stops(page: Page, ready: RunningFleet) -> None:
    open_page(page, ready, "setup")
    begin_jog(page, ready)
    let_go_ns = raw_ns()
    page.mouse.up()
    require_end(ready, let_go_ns)


def test_a_gamepad_jogs_until_its_dead_man_button_is_let_go(page: Page, ready: RunningFleet) -> None:
    page.add_init_script(PAD)
    open_page(page, ready, "setup")
    page.get_by_role("button", name="Use a gamepad").click()
    set_pad(page, held=True)
    expect(page.get_by_text("enabled: the stick moves")).to_be_visible()
    count = ready.starts("gantry")
    set_pad(page, across=-1)
    wait_for(page, lambda: ready.starts("gantry") > count)
    set_pad(page, across=-0.5)  # another speed, by a renewal
    page.wait_for_timeout(500)
    let_go_ns = raw_ns()
    set_pad(page, held=False)
    require_end(ready, let_go_ns, page)
    expect(page.get_by_role("region", name="Messages").get_by_text("gantry.x")).to_have_count(0)


@pytest.mark.parametrize("how", ["closed", "silent"])
def test_a_socket_killed_in_mid_jog_stops_the_axis(page: Page, ready: RunningFleet, how: str) -> None:
    """closed: both ends are closed. silent: frames no longer arrive, in neither direction, and nothing is closed."""
    sockets: list[tuple[WebSocketRoute, WebSocketRoute]] = []
    cut: list[int] = []

    def relay(socket: WebSocketRoute) -> None:
        server = socket.connect_to_server()
        socket.on_message(lambda message: None if cut else server.send(message))
        server.on_message(lambda message: None if cut else socket.send(message))
        sockets.append((socket, server))

    page.route_web_socket("**/v1/stream*", relay)
    open_page(page, ready, "setup")
    begin_jog(page, ready, "−")
    cut_ns = raw_ns()
    cut.append(cut_ns)
    if how == "closed":
        for each in sockets[-1]:
            each.close()
    require_end(ready, cut_ns, page)
    cut.clear()
    page.mouse.up()


def test_a_tab_that_is_hidden_in_mid_jog_stops_the_axis(ready: RunningFleet, tmp_path: Path) -> None:
    with open_tools(find_program(), tmp_path) as tools:
        other = tools.open_tab("about:blank")
        tab = tools.open_tab(f"{find_address(ready)}#setup")
        find = """(() => { const button = document.querySelector('[aria-label="Jog gantry.x +"]');
            if (!button || button.getAttribute('aria-disabled')) return null;
            const box = button.getBoundingClientRect(); return [box.x + box.width / 2, box.y + box.height / 2]; })()"""
        wait_until(lambda: tab.evaluate(find) is not None, "the jog button is there")
        begun = ready.starts("gantry")
        tab.press_mouse(*tab.evaluate(find))
        wait_until(lambda: ready.starts("gantry") > begun, "the axis moves")
        hidden_ns = raw_ns()
        other.show()
        require_end(ready, hidden_ns)
        assert tab.evaluate("document.visibilityState") == "hidden"


def test_two_operators_at_one_axis(page: Page, browser: Browser, ready: RunningFleet) -> None:
    open_page(page, ready, "setup")
    begin_jog(page, ready)
    other = browser.new_page()
    open_page(other, ready, "setup")
    other.get_by_role("button", name="Jog gantry.x −", exact=True).hover()
    other.mouse.down()
    expect(other.get_by_text("gantry.x is in use by").first).to_be_visible()
    other.mouse.up()
    page.mouse.up()
    other.close()
    page.get_by_role("button", name=re.compile("^Release gantry")).click()


def test_the_page_comes_back_after_the_gateway_was_killed(page: Page, ready: RunningFleet) -> None:
    open_page(page, ready)
    ready.kill("orchestrator.gateway.process")
    expect(page.get_by_text("not connected").first).to_be_visible()
    expect(page.get_by_text("not connected")).to_have_count(0, timeout=30_000)
    expect(page.get_by_test_id("axis-gantry.x")).to_be_visible()


# Roles


def test_roles_are_enforced_whatever_the_page_shows(page: Page, ready: RunningFleet, users: UserFile) -> None:
    sign_in(page, ready, "vera")
    expect(page.get_by_role("button", name="Stop queue")).to_have_attribute("aria-disabled", "true")
    ask = """async (path) => { const session = await (await fetch('v1/session')).json();
        const answer = await fetch(path, {method: 'POST', body: '{}',
            headers: {'content-type': 'application/json', 'x-tutti-csrf': session.csrf}});
        return [answer.status, (await answer.json()).refused?.code]; }"""
    assert page.evaluate(ask, "v1/stop-queue") == [403, "not-allowed"]
    assert page.evaluate(ask, "v1/stop")[0] == 200
    assert page.evaluate("document.cookie") == ""  # scripts do not see the session
    page.get_by_role("button", name="Settings").click()
    page.get_by_role("button", name="Sign out").click()
    expect(page.get_by_role("button", name="Sign in")).to_be_visible()
    ready.ready()


def test_a_maintainer_asks_a_controller_in_its_own_language(page: Page, ready: RunningFleet, users: UserFile) -> None:
    sign_in(page, ready, "mia")
    page.get_by_role("navigation", name="Views").get_by_role("button", name="Service").click()
    panel = page.get_by_role("region", name="Console")
    panel.get_by_role("checkbox", name=re.compile("^I know")).check()
    panel.get_by_role("textbox").fill("MG _TPX")
    panel.get_by_role("textbox").press("Enter")
    log = panel.get_by_role("log", name="Commands and replies")
    expect(log).to_contain_text(re.compile(r"MG _TPX\s*-?[0-9]"))
    expect(panel.get_by_role("log", name="Trace of gantry")).to_contain_text("MG _TPX")


def test_a_wrong_password_is_said(page: Page, ready: RunningFleet, users: UserFile) -> None:
    page.goto(find_address(ready))
    page.get_by_label("User", exact=True).fill("olga")
    page.get_by_label("Password").fill("wrong password")
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_text("user or password is wrong").first).to_be_visible()


def drop_file(page: Page, name: str, text: str) -> None:
    """Drop a file on the page."""
    transfer = page.evaluate_handle(
        """([name, text]) => { const data = new DataTransfer();
        data.items.add(new File([text], name, {type: 'application/yaml'})); return data; }""",
        [name, text],
    )
    for event in ("dragenter", "dragover", "drop"):
        page.dispatch_event("#page", event, {"dataTransfer": transfer})


def test_a_proposal_is_released_as_exactly_the_plan_that_was_seen(
    page: Page, browser: Browser, ready: RunningFleet, users: UserFile
) -> None:
    run = ready.tutti("position", "save", "corner", "--at", "gantry.x=60")
    assert run.returncode == 0, run.stderr
    sign_in(page, ready, "paul")
    text = "schema: tutti.job/1\nname: corner run\nsteps:\n  - {do: move, to: {gantry.x: corner}}\n"
    drop_file(page, "corner.job.yaml", text)
    page.get_by_role("button", name="Propose").click()
    expect(page.get_by_role("list", name="Waiting jobs")).to_contain_text("corner run")
    context = browser.new_context(viewport=LARGE)
    other = context.new_page()
    sign_in(other, ready, "olga")
    other.get_by_role("button", name="Review corner run").click()
    dialog = other.get_by_role("dialog")
    expect(dialog).to_contain_text("corner")
    expect(dialog.locator("canvas").first).to_be_visible()
    # The position changes while the plan is on the screen.
    assert ready.tutti("position", "save", "corner", "--at", "gantry.x=70").returncode == 0
    dialog.get_by_role("button", name="Release exactly this plan").click()
    expect(other.get_by_text(re.compile("60.*70|plan.*changed")).first).to_be_visible()
    assert ready.ask(lambda tutti: tutti.list_jobs(1)).jobs[0].state == "queued"
    other.keyboard.press("Tab")
    if dialog.count():
        dialog.get_by_role("button", name="Close").click()
    other.get_by_role("button", name="Review corner run").click()
    expect(dialog).to_contain_text("70")
    dialog.get_by_role("button", name="Release exactly this plan").click()
    wait_until(
        lambda: (other.wait_for_timeout(50), ready.ask(lambda tutti: tutti.list_jobs(1)).jobs[0].state == "done")[1],
        "the job is done",
    )
    assert ready.status()["gantry"].axes["x"].position == pytest.approx(70, abs=0.01)
    commands = ready.ask(lambda tutti: tutti.list_commands(50))
    assert any(each.verb == "approve" and each.actor.startswith("olga@") for each in commands)
    context.close()


def test_the_sign_in_page_goes_when_the_last_user_is_removed(page: Page, ready: RunningFleet, users: UserFile) -> None:
    page.goto(find_address(ready))
    page.get_by_label("Password").wait_for()
    for name in users.load().users:
        users.remove_user(name)
    page.get_by_role("region", name="Axes", exact=True).wait_for()


# Jobs


def test_a_template_is_a_form(page: Page, ready: RunningFleet) -> None:
    open_page(page, ready)
    page.get_by_role("button", name="New job").click()
    page.get_by_role("button", name="Fill in scan.template").click()
    dialog = page.get_by_role("dialog")
    width = dialog.get_by_label(re.compile(r"^width \(mm\)"))
    width.fill("900 mm")
    expect(dialog.get_by_text(re.compile("at most|maximum|100 mm")).first).to_be_visible()
    width.fill("10 mm")
    dialog.get_by_label(re.compile("^points")).fill("3")
    dialog.get_by_label(re.compile("^lines")).fill("2")
    expect(dialog.locator("canvas").first).to_be_visible()
    submit = dialog.get_by_role("button", name="Submit")
    expect(submit).not_to_have_attribute("aria-disabled", "true")
    submit.click()
    wait_until(
        lambda: (page.wait_for_timeout(50), ready.ask(lambda tutti: tutti.list_jobs(1)).jobs[0].state == "done")[1],
        "the scan is done",
    )
    expect(page.get_by_role("region", name="Running job")).to_contain_text("raster test")


def test_a_dropped_job_file_with_mistakes_is_not_submitted(page: Page, ready: RunningFleet) -> None:
    open_page(page, ready)
    drop_file(page, "far.job.yaml", "schema: tutti.job/1\nname: far\nsteps:\n  - {do: move, to: {gantry.x: 9000}}\n")
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_text("line 4:").first).to_be_visible()
    expect(dialog.get_by_text(re.compile("soft limits")).first).to_be_visible()
    expect(dialog.get_by_role("button", name="Submit")).to_have_attribute("aria-disabled", "true")


PATH_JOB = """schema: tutti.job/1
name: part on the page
steps:
  - {do: move, to: {gantry.x: 20, gantry.y: 10}}
  - do: path
    axes: [gantry.x, gantry.y]
    start: [20, 10]
    pieces: [{piece: arc, to: [40, 10], centre: [30, 10]}, {piece: line, to: [20, 10]}]
    tolerance: 200 um
"""


def test_a_path_says_how_far_it_may_be_off_before_it_runs_and_after(page: Page, ready: RunningFleet) -> None:
    open_page(page, ready)
    drop_file(page, "part.job.yaml", PATH_JOB)
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_text(re.compile(r"path of 51\.4\d* mm in \d+\.\d s"))).to_be_visible()
    expect(dialog.get_by_text(re.compile(r"at most 0\.\d+ mm off it; 0\.2 mm are allowed"))).to_be_visible()
    dialog.get_by_text("Bound by member").click()
    terms = dialog.get_by_role("table").filter(has_text="Profile fit").last  # inside that of the steps
    expect(terms.get_by_role("row")).to_have_count(3)  # the head, the plan, the gantry
    expect(terms.get_by_role("row").filter(has_text="gantry")).to_contain_text("mm")
    dialog.get_by_role("button", name="Submit").click()
    wait_until(
        lambda: (page.wait_for_timeout(50), ready.ask(lambda tutti: tutti.list_jobs(1)).jobs[0].state == "done")[1],
        "the path is done",
    )
    open_page(page, ready, "service")
    page.get_by_role("button", name="part on the page").first.click()
    report = page.get_by_role("dialog")
    expect(report.get_by_text(re.compile(r"proven afterwards: at most 0\.\d+ mm"))).to_be_visible()


LONG_PATH_JOB = """schema: tutti.job/1
name: long part
steps:
- {do: move, to: {gantry.x: 20, gantry.y: 10}}
- do: path
  axes: [gantry.x, gantry.y]
  start: [20, 10]
  speed: 20 mm/s
  pieces: [{piece: helix, to: [20, 10], centre: [30, 10], turns: 4}]
  tolerance: 1 mm
"""


def test_the_speed_on_a_path_is_changed_by_keyboard(page: Page, ready: RunningFleet) -> None:
    open_page(page, ready)
    drop_file(page, "long.job.yaml", LONG_PATH_JOB)
    page.get_by_role("dialog").get_by_role("button", name="Submit").click()
    job = page.get_by_role("article", name="Job long part")
    speed = job.get_by_role("slider", name="Speed on the path")
    expect(speed).to_have_value("100")
    speed.press("ArrowUp")
    speed.press("Home")
    expect(speed).to_have_attribute("aria-valuetext", "10 %")
    expect(job.get_by_text("now 100 % of the planned speed")).to_be_visible()  # nothing is sent on the way there
    for _ in range(10):
        speed.press("ArrowRight")
    speed.press("Enter")
    expect(job.get_by_text("now 60 % of the planned speed")).to_be_visible()
    speed.press("End")
    job.get_by_role("button", name="Override long part").click()
    expect(job.get_by_text("now 120 % of the planned speed")).to_be_visible()
    expect(job).to_have_count(0, timeout=60_000)
    sent = [each for each in ready.ask(lambda tutti: tutti.list_commands()) if each.verb == "override"]
    assert len(sent) == 2
    assert ready.ask(lambda tutti: tutti.list_jobs(1)).jobs[0].state == "done"


def test_a_file_that_is_too_large_is_said(page: Page, ready: RunningFleet) -> None:
    open_page(page, ready)
    drop_file(page, "large.job.yaml", "x" * 3_000_000)
    expect(page.get_by_text("larger than 1 MB").first).to_be_visible()


# The word for what waits


def submit(fleet: RunningFleet, folder: Path, name: str, to: float, speed: float = 1.0) -> None:
    file = folder / f"{name}.job.yaml"
    step = f"{{do: move, to: {{gantry.x: {to}}}, speed: {speed}}}"
    file.write_text(f"schema: tutti.job/1\nname: {name}\nsteps:\n  - {step}\n")
    run = fleet.tutti("submit", str(file))
    assert run.returncode == 0, run.stderr


def wait_until_done(page: Page, fleet: RunningFleet, name: str) -> None:
    def is_done() -> bool:
        page.wait_for_timeout(50)
        newest = fleet.ask(lambda tutti: tutti.list_jobs(1)).jobs[0]
        return newest.name == name and newest.state == "done"

    wait_until(is_done, f"{name} is done")


def test_after_an_e_stop_the_next_job_begins_by_three_presses(page: Page, ready: RunningFleet, tmp_path: Path) -> None:
    """Reset, Start queue, Begin now. What moves first is shown before, and the stopped job has nothing green."""
    open_page(page, ready)
    begun = ready.starts("gantry")
    submit(ready, tmp_path, "slow", 300, 0.05)
    submit(ready, tmp_path, "next", 50)
    wait_until(lambda: (page.wait_for_timeout(50), ready.starts("gantry") > begun)[1], "the axis moves")
    page.get_by_role("button", name="E-stop", exact=True).click()
    panel = page.get_by_role("region", name="Running job")
    expect(panel.get_by_text("aborted").first).to_be_visible()
    expect(panel.get_by_text("green")).to_have_count(0)
    page.get_by_role("button", name="Reset").click()
    page.get_by_role("region", name="Messages").get_by_role("button", name="Start queue").click()
    dialog = page.get_by_role("dialog", name="Start queue")
    expect(dialog.get_by_role("list", name="This moves first")).to_contain_text("gantry.x")
    stopped_at = ready.starts("gantry")
    page.wait_for_timeout(500)
    assert ready.starts("gantry") == stopped_at  # nothing moves before the word
    dialog.get_by_role("button", name="Begin now").click()
    wait_until_done(page, ready, "next")


def test_a_job_that_waited_for_the_reset_is_ready_and_begins_by_its_button(
    page: Page, ready: RunningFleet, tmp_path: Path
) -> None:
    open_page(page, ready)
    page.get_by_role("button", name="E-stop", exact=True).click()
    expect(page.get_by_role("button", name="Reset")).to_be_visible()
    ready.ask(lambda tutti: tutti.start_queue())
    submit(ready, tmp_path, "patient", 60)
    card = page.get_by_role("list", name="Waiting jobs").get_by_role("listitem").filter(has_text="patient")
    expect(card.get_by_role("button", name="Release patient")).to_have_attribute("aria-disabled", "true")
    expect(card).not_to_contain_text("tutti reset")
    begun = ready.starts("gantry")
    page.get_by_role("button", name="Reset").click()
    message = page.get_by_role("region", name="Messages")
    expect(message).to_contain_text("Ready to begin: patient")
    expect(card).to_contain_text("ready to begin")
    assert ready.starts("gantry") == begun
    message.get_by_role("button", name="Begin …").click()
    page.get_by_role("dialog").get_by_role("button", name="Begin now").click()
    wait_until_done(page, ready, "patient")


# Alarms


def is_served(fleet: RunningFleet) -> bool:
    """Whether the gateway accepts connections."""
    port = int(re.findall(r":(\d+)/", find_address(fleet))[0])
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def test_an_acknowledged_alarm_is_acknowledged_after_a_restart_of_everything_shown(
    page: Page, ready: RunningFleet
) -> None:
    from orchestrator.bus.base import Priority
    from orchestrator.client.api import Tutti

    async def raise_alarm(tutti: Tutti) -> None:
        request = {"kind": "vacuum", "subject": "chamber", "text": "pressure above 1 mbar", "action": "check the pump"}
        key = f"{tutti.keys.prefix}/alarm-request/vacuum/test"
        tutti.bus.put(key, json.dumps({**request, "priority": "high", "active": True}).encode(), Priority.EVENT)
        await tutti.status()

    ready.ask(raise_alarm)
    open_page(page, ready, "service")
    page.get_by_role("button", name=re.compile("Acknowledge the alarm of chamber")).click()
    expect(page.get_by_text("acknowledged by operator").first).to_be_visible()
    ready.kill("orchestrator.gateway.process")
    ready.kill("orchestrator.coordinator.process")
    ready.works()
    # The page may not have noticed yet that its gateway was away, so its own word is no sign.
    wait_until(lambda: is_served(ready), "the gateway serves again")
    expect(page.get_by_text("not connected")).to_have_count(0, timeout=30_000)
    page.reload()
    expect(page.get_by_text("acknowledged by operator").first).to_be_visible(timeout=30_000)


# Accessibility


@pytest.mark.parametrize("colours", ["light", "dark"])
@pytest.mark.parametrize("view", ["run", "setup", "service"])
def test_axe_finds_no_serious_fault(
    browser: Browser, ready: RunningFleet, view: str, colours: Literal["dark", "light"]
) -> None:
    page = browser.new_page(color_scheme=colours, viewport=LARGE)
    open_page(page, ready, view)
    page.wait_for_timeout(500)
    page.evaluate(AXE.read_text())
    found = page.evaluate("axe.run().then(result => result.violations)")
    serious = [each for each in found if each["impact"] in ("serious", "critical")]
    shown = [(each["id"], [node["html"][:120] for node in each["nodes"]][:3]) for each in serious]
    page.close()
    assert not serious, shown


def test_nothing_is_loaded_from_elsewhere(page: Page, ready: RunningFleet) -> None:
    elsewhere: list[str] = []
    address = find_address(ready)

    def note(route: Route) -> None:
        if not route.request.url.startswith((address, "data:", "blob:")):
            elsewhere.append(route.request.url)
        route.continue_()

    page.route("**/*", note)
    for view in ("run", "setup", "service"):
        open_page(page, ready, view)
        page.wait_for_timeout(500)
    assert not elsewhere
