"""What waits begins only after what moves first was shown; a job that was not done has nothing green."""

import re
from typing import Any

import pytest
from browser.conftest import LARGE, SMALL, make_axis, make_controller, make_entry, make_state
from browser.test_rules import Mock, wait_for
from playwright.sync_api import Page, expect

STOPPED = {"reason": "stopped by anna", "actor": "anna", "utc": "2026-01-01T00:00:00Z"}
DONE: dict[str, Any] = {"refused": None}


def make_motion(name: str, text: str, cause: str = "") -> dict[str, Any]:
    return {"job_id": f"id-{name}", "name": name, "text": text, "axes": ["gantry.x"], "cause": cause}


def make_preview(shown: str, *motions: dict[str, Any], lasting: tuple[dict[str, Any], ...] = ()) -> dict[str, Any]:
    return {"refused": None, "motions": list(motions), "lasting": list(lasting), "shown": shown}


def make_refusal(code: str, text: str, remedy: str = "") -> dict[str, Any]:
    return {"refused": {"code": code, "text": text, "remedy": remedy}}


def make_queue(*jobs: dict[str, Any], stopped: bool = False) -> dict[str, Any]:
    return {"waiting": len(jobs), "total": len(jobs), "jobs": list(jobs), **({"stopped": STOPPED} if stopped else {})}


FIRST = make_motion(
    "alpha", "step 1: move gantry.x to 20 mm", "e-stop by anna; make the machine safe, then `tutti reset`"
)


# The word


def test_the_queue_starts_after_what_moves_first_was_shown(mock: Mock, page: Page) -> None:
    still = make_motion("beta", "step 1: home stage.u", "stage is offline")
    replies = {"preview-start": make_preview("d1", FIRST, lasting=(still,)), "start-queue": DONE}
    stream = mock(
        make_state(queue=make_queue(make_entry("alpha", held_by="restart", ready=True), stopped=True)), replies=replies
    )
    page.get_by_role("region", name=re.compile("^Queue")).get_by_role("button", name="Start queue").click()
    dialog = page.get_by_role("dialog", name="Start queue")
    first = dialog.get_by_role("list", name="This moves first")
    expect(first).to_contain_text("step 1: move gantry.x to 20 mm")
    expect(first).to_contain_text("then Reset")  # no command line
    expect(dialog.get_by_role("list", name="These still wait")).to_contain_text("stage is offline")
    assert stream.asked == [("preview-start", {"job_ids": []})]
    dialog.get_by_role("button", name="Begin now").click()
    expect(dialog).to_have_count(0)
    assert stream.asked[1:] == [("start-queue", {"shown": "d1"})]


def test_what_has_changed_since_is_shown_again(mock: Mock, page: Page) -> None:
    other = make_motion("gamma", "step 1: move gantry.y to 5 mm")
    replies = {
        "preview-start": [make_preview("d1", FIRST), make_preview("d2", other)],
        "start-queue": [make_refusal("not-shown", "what moves first has changed"), DONE],
    }
    stream = mock(make_state(queue=make_queue(make_entry("alpha"), stopped=True)), replies=replies)
    page.get_by_role("button", name="Start queue").first.click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_role("button", name="Begin now").click()
    expect(dialog.get_by_role("alert")).to_contain_text("has changed")
    expect(dialog).to_contain_text("gantry.y to 5 mm")
    dialog.get_by_role("button", name="Begin now").click()
    expect(dialog).to_have_count(0)
    assert [body for verb, body in stream.asked if verb == "start-queue"] == [{"shown": "d1"}, {"shown": "d2"}]


def test_a_queue_that_moves_nothing_starts_with_one_press(mock: Mock, page: Page) -> None:
    stream = mock(
        make_state(queue=make_queue(stopped=True)), replies={"preview-start": make_preview("d0"), "start-queue": DONE}
    )
    page.get_by_role("button", name="Start queue").click()
    wait_for(page, lambda: ("start-queue", {"shown": "d0"}) in stream.asked)
    expect(page.get_by_role("dialog")).to_have_count(0)


PRESS_TOO_EARLY = """() => {
  window.empty = false;
  window.pressed = 0;
  const press = () => {
    window.empty ||= document.body.textContent.includes("Nothing moves now.");
    const begin = [...document.querySelectorAll("button")].find(button => button.textContent.startsWith("Begin now"));
    if (begin?.getAttribute("aria-disabled") !== "true") return;
    watch.disconnect();
    begin.click();
    window.pressed += 1;
  };
  const watch = new MutationObserver(press);
  watch.observe(document.body, {subtree: true, childList: true, attributes: true});
}"""
"""Press the button once, at once when it appears: before it counts. Notes whether nothing could move before."""


def test_what_appears_by_itself_must_be_seen_before_a_press_counts(mock: Mock, page: Page) -> None:
    """Right after a reset nothing can move yet; a moment later it can, under the finger."""
    replies = {"preview-start": [make_preview("d0"), make_preview("d1", FIRST)], "start-queue": DONE}
    stream = mock(make_state(queue=make_queue(make_entry("alpha"), stopped=True)), replies=replies)
    page.evaluate(PRESS_TOO_EARLY)
    page.get_by_role("button", name="Start queue").first.click()
    dialog = page.get_by_role("dialog")
    begin = dialog.get_by_role("button", name="Begin now")
    expect(dialog).to_contain_text("move gantry.x to 20 mm")
    expect(begin).not_to_have_attribute("aria-disabled", "true")
    assert page.evaluate("[window.empty, window.pressed]") == [True, 1]
    assert not [verb for verb, _ in stream.asked if verb == "start-queue"]
    begin.click()
    wait_for(page, lambda: ("start-queue", {"shown": "d1"}) in stream.asked)


def test_a_release_shows_the_motion_of_its_job(mock: Mock, page: Page) -> None:
    replies = {"preview-start": make_preview("d3", FIRST), "release": DONE}
    stream = mock(make_state(queue=make_queue(make_entry("alpha", held_by="anna"))), replies=replies)
    page.get_by_role("button", name="Release alpha").click()
    dialog = page.get_by_role("dialog", name="Release alpha")
    expect(dialog).to_contain_text("move gantry.x to 20 mm")
    dialog.get_by_role("button", name="Begin now").click()
    expect(dialog).to_have_count(0)
    asked = [("preview-start", {"job_ids": ["id-alpha"]}), ("release", {"job_ids": ["id-alpha"], "shown": "d3"})]
    assert stream.asked == asked


def test_not_now_begins_nothing_and_the_space_bar_neither(mock: Mock, page: Page) -> None:
    replies = {"preview-start": make_preview("d3", FIRST), "start-queue": DONE}
    stream = mock(make_state(queue=make_queue(make_entry("alpha"), stopped=True)), replies=replies)
    page.get_by_role("button", name="Start queue").first.click()
    begin = page.get_by_role("button", name="Begin now")
    begin.focus()
    page.keyboard.press("Space")
    page.get_by_role("button", name="Not now").click()
    assert [verb for verb, _ in stream.asked] == ["preview-start"]


@pytest.mark.parametrize("view", ["run", "setup", "service"])
def test_a_job_that_is_ready_to_begin_is_said_in_every_view_with_one_button(mock: Mock, page: Page, view: str) -> None:
    replies = {"preview-start": make_preview("d1", FIRST), "start-queue": DONE}
    stream = mock(make_state(queue=make_queue(make_entry("alpha", held_by="restart", ready=True))), view, replies)
    line = page.get_by_role("region", name="Messages")
    expect(line).to_contain_text("Ready to begin: alpha")
    line.get_by_role("button", name="Begin …").click()
    page.get_by_role("button", name="Begin now").click()
    wait_for(page, lambda: ("start-queue", {"shown": "d1"}) in stream.asked)


def test_a_job_whose_cause_lasts_says_so_and_cannot_be_released(mock: Mock, page: Page) -> None:
    reason = "waits for: gantry.x is not referenced; home: `tutti axis home gantry.x`"
    mock(make_state(queue=make_queue(make_entry("alpha", held_by="restart", reason=reason))))
    card = page.locator("[data-job=id-alpha]")
    expect(card).to_contain_text("Get ready, or Home in the menu of the axis")
    expect(card).not_to_contain_text("tutti")
    expect(card.get_by_role("button", name="Release alpha")).to_have_attribute("aria-disabled", "true")


def test_a_work_of_the_page_that_is_ready_begins_with_its_button(mock: Mock, page: Page) -> None:
    replies = {"preview-start": make_preview("d5", make_motion("w", "step 1: move")), "release": DONE}
    stream = mock(view="setup", replies=replies)
    page.get_by_role("button", name="Go: gantry.x").click()
    page.get_by_label("Position in mm").fill("20")
    page.get_by_role("button", name="Go to 20").click()
    wait_for(page, lambda: stream.find("work"))
    number = stream.find("work")[0]["id"]
    stream.send({"work": {"id": number, "state": "queued", "job_id": "id-w", "reason": "", "fraction": 0}})
    progress = {
        **{"job_id": "id-w", "name": "w", "actor": "a", "state": "queued", "step": 0, "steps": 1, "step_name": ""},
        **{"fraction": 0, "reason": "", "utc": "", "ready": True},
    }
    stream.patch({"jobs": {"id-w": progress}})
    page.get_by_role("button", name="Begin Move gantry.x").first.click()
    page.get_by_role("button", name="Begin now").click()
    wait_for(page, lambda: ("release", {"job_ids": ["id-w"], "shown": "d5"}) in stream.asked)


# Get ready


def test_get_ready_lists_the_axes_of_the_jobs_then_enables_and_homes_them(mock: Mock, page: Page) -> None:
    axes = {"x": make_axis(enabled=False, referenced=False), "y": make_axis(referenced=False), "z": make_axis()}
    state = make_state(
        controllers={"gantry": make_controller(axes), "stage": make_controller({"u": make_axis(enabled=False)})},
        queue=make_queue(make_entry("alpha"), stopped=True),
    )
    stream = mock(state, replies={"jobs/id-alpha/axes": {"axes": ["gantry.y", "gantry.x"]}})
    page.get_by_role("button", name="Get ready").click()
    dialog = page.get_by_role("dialog", name="Get ready")
    expect(dialog).to_contain_text("Enable the motors of gantry.x.")
    expect(dialog).to_contain_text("home gantry.x, gantry.y.")
    expect(dialog).not_to_contain_text("stage.u")
    dialog.get_by_role("button", name="Enable and home these").click()
    wait_for(page, lambda: stream.find("work"))
    assert [frame["step"] for frame in stream.find("work")] == [{"do": "enable", "axes": ["gantry.x"]}]
    stream.send({"work": {"id": stream.find("work")[0]["id"], "state": "done"}})
    wait_for(page, lambda: len(stream.find("work")) == 2)
    assert stream.find("work")[1]["step"] == {"do": "home", "axes": ["gantry.x", "gantry.y"]}


def test_get_ready_takes_the_axes_of_every_waiting_job_and_all_if_one_cannot_be_told(mock: Mock, page: Page) -> None:
    axes = {name: make_axis(referenced=False) for name in ("x", "y", "z")}
    queue = make_queue(make_entry("alpha"), make_entry("beta"))
    known = {f"jobs/id-{job}/axes": {"axes": [axis]} for job, axis in (("alpha", "gantry.x"), ("beta", "gantry.y"))}
    stream = mock(make_state(controllers={"gantry": make_controller(axes)}, queue=queue), replies=known)
    page.get_by_role("button", name="Get ready").click()
    dialog = page.get_by_role("dialog", name="Get ready")
    expect(dialog).to_contain_text("home gantry.x, gantry.y.")
    page.keyboard.press("Escape")
    stream.replies["jobs/id-beta/axes"] = make_refusal("no-position", "there is no position there")
    page.get_by_role("button", name="Get ready").click()
    expect(dialog).to_contain_text("home gantry.x, gantry.y, gantry.z.")


def test_without_a_job_get_ready_is_for_all_axes(mock: Mock, page: Page) -> None:
    mock(make_state(controllers={"gantry": make_controller({"x": make_axis(referenced=False), "y": make_axis()})}))
    page.get_by_role("region", name="Axes").get_by_role("button", name="Get ready …").click()
    dialog = page.get_by_role("dialog", name="Get ready")
    expect(dialog).to_contain_text("home gantry.x.")
    expect(dialog.get_by_role("button", name="Home these")).to_be_visible()


@pytest.mark.parametrize("how", ["Pause", "failed"])
def test_get_ready_does_not_go_on_after_a_stop_or_a_failure(mock: Mock, page: Page, how: str) -> None:
    axes = {"x": make_axis(enabled=False, referenced=False)}
    stream = mock(make_state(controllers={"gantry": make_controller(axes)}), view="setup")
    page.get_by_role("button", name="Get ready …").click()
    page.get_by_role("button", name="Enable and home these").click()
    wait_for(page, lambda: stream.find("work"))
    number = stream.find("work")[0]["id"]
    if how == "Pause":
        page.keyboard.press("Pause")
        wait_for(page, lambda: stream.find("cancel-work"))
        stream.send({"work": {"id": number, "state": "done"}})  # the enable was done just before the stop came
    else:
        stream.send({"work": {"id": number, "state": "failed", "reason": "the drive refused"}})
    page.wait_for_timeout(200)
    assert len(stream.find("work")) == 1


# Verdicts


def make_step(state: str, verdict: str = "green") -> dict[str, Any]:
    return {"index": 0, "do": "move", "name": "out", "state": state, "t0_fleet_ns": 5, "verdict": verdict}


def make_report(state: str, *steps: dict[str, Any]) -> dict[str, Any]:
    report = {
        **{"job_id": "id-old", "name": "old", "actor": "anna", "state": state, "reason": "e-stop by anna"},
        **{"submitted_utc": "2026-01-01T00:00:00Z", "max_start_skew_ns": 1, "steps": list(steps)},
    }
    return {"entry": {**make_entry("old"), "state": state}, "report": report}


@pytest.mark.parametrize("state", ["aborted", "failed", "cancelled", "interrupted"])
def test_a_job_that_was_not_done_has_no_green_anywhere(mock: Mock, page: Page, state: str) -> None:
    scan = make_step("done") | {"index": 1, "scan": {"points": 9, "done": 5, "verdicts": {"green": 5}}}
    reports = make_report(state, make_step("done"), scan, make_step("aborted") | {"index": 2})
    replies = {"jobs/id-old": reports, "jobs": {"jobs": [reports["entry"]]}}
    mock(replies=replies)
    last = page.get_by_role("region", name="Last motion step")
    expect(last).to_contain_text(f"{state}: e-stop by anna")
    expect(last).to_contain_text("Last: old, step 3 out")
    page.get_by_role("navigation", name="Views").get_by_role("button", name="Service").click()
    page.get_by_role("button", name="old").first.click()
    expect(page.get_by_role("dialog")).to_contain_text("Step 3: out")
    for text in ("green", "✓"):
        expect(page.get_by_text(text)).to_have_count(0)


@pytest.mark.parametrize("verdict", ["green", "amber", "red"])
def test_a_step_that_was_done_has_its_verdict(mock: Mock, page: Page, verdict: str) -> None:
    reports = make_report("done", make_step("done", verdict))
    mock(replies={"jobs/id-old": reports, "jobs": {"jobs": [reports["entry"]]}})
    expect(page.get_by_role("region", name="Last motion step")).to_contain_text(verdict)


def test_an_aborted_job_without_a_motion_replaces_the_verdict_before_it(mock: Mock, page: Page) -> None:
    reports = make_report("done", make_step("done"))
    aborted = make_report("aborted")
    aborted["report"] |= {"job_id": "id-new", "name": "new"}
    stream = mock(replies={"jobs/id-old": reports, "jobs": {"jobs": [reports["entry"]]}, "jobs/id-new": aborted})
    last = page.get_by_role("region", name="Last motion step")
    expect(last).to_contain_text("green")
    stream.patch({"jobs": {"id-new": {"job_id": "id-new", "name": "new", "state": "aborted", "utc": "2026"}}})
    expect(last).to_contain_text("Last: new")
    expect(last).not_to_contain_text("green")


def test_run_again_is_beside_the_job_that_has_ended(mock: Mock, page: Page) -> None:
    reports = make_report("aborted", make_step("aborted"))
    retried = {"refused": None, "steps": ["step 1: move gantry.x"], "warnings": []}
    replies = {"jobs/id-old": reports, "jobs": {"jobs": [reports["entry"]]}, "retry": retried}
    stream = mock(replies=replies)
    page.get_by_role("button", name="Run again: old").click()
    expect(page.get_by_role("dialog")).to_contain_text("step 1: move gantry.x")
    page.get_by_role("button", name="Run these steps now").click()
    wait_for(page, lambda: len(stream.asked) == 2)
    assert [body["dry_run"] for _, body in stream.asked] == [True, False]


# What is seen


def make_fleet(**changed: dict[str, Any]) -> dict[str, Any]:
    """Twelve axes on six controllers; changed: axes of each controller."""
    return {
        f"c{n}": make_controller({"x": make_axis(**changed.get(f"c{n}", {})), "y": make_axis()}) for n in range(1, 7)
    }


def test_what_moves_is_above_every_inner_edge_with_twelve_axes(mock: Mock, page: Page) -> None:
    page.set_viewport_size(LARGE)
    jobs = [make_entry(f"job {n}") for n in range(3)]
    stream = mock(make_state(controllers=make_fleet(), queue=make_queue(*jobs)))
    for n in (5, 6):
        stream.patch(
            {"controllers": {f"c{n}": {"mode": "moving", "axes": {"x": {"moving": True}, "y": {"moving": True}}}}}
        )
    for axis in ("c5.x", "c5.y", "c6.x", "c6.y"):
        expect(page.get_by_test_id(f"axis-{axis}")).to_be_in_viewport(ratio=1)
    for axis in ("c1.x", "c2.x"):  # with a plot there is less room: those that move come first
        page.get_by_role("button", name=f"Plot {axis}").click()
    page.mouse.move(5, 5)
    for axis in ("c5.x", "c5.y", "c6.x", "c6.y"):
        expect(page.get_by_test_id(f"axis-{axis}")).to_be_in_viewport(ratio=1)


def test_twelve_axes_that_all_move_fit_beside_a_running_job_and_a_queue(mock: Mock, page: Page) -> None:
    page.set_viewport_size(LARGE)
    moving = {f"c{n}": {"moving": True, "target": 100.0} for n in range(1, 7)}
    controllers = make_fleet(**moving)
    for controller in controllers.values():
        controller["mode"] = "moving"
        controller["axes"]["y"] |= {"moving": True, "target": 50.0}
    job = {
        **{"job_id": "id-r", "name": "raster", "actor": "a", "state": "running", "step": 0, "steps": 3},
        **{"step_name": "out", "fraction": 0.2, "reason": "", "utc": "2026"},
    }
    jobs = [make_entry(f"job {n}") for n in range(3)]
    mock(make_state(controllers=controllers, queue=make_queue(*jobs), jobs={"id-r": job}))
    for axis in (f"c{n}.{name}" for n in range(1, 7) for name in "xy"):
        expect(page.get_by_test_id(f"axis-{axis}")).to_be_in_viewport(ratio=1)
    expect(page.get_by_role("progressbar", name="Progress of raster")).to_be_in_viewport(ratio=1)
    assert page.evaluate("document.documentElement.scrollHeight <= innerHeight")


def test_rows_stay_under_the_pointer(mock: Mock, page: Page) -> None:
    stream = mock(make_state(controllers=make_fleet()))
    page.get_by_test_id("axis-c2.x").hover()
    first = page.locator("tbody").first
    stream.patch({"controllers": {"c6": {"axes": {"x": {"moving": True}}}}})
    expect(page.get_by_test_id("axis-c6.x")).to_contain_text("moving")
    expect(first).to_have_attribute("data-controller", "c1")
    page.mouse.move(5, 5)
    expect(first).to_have_attribute("data-controller", "c6")


def test_an_empty_plot_takes_no_room(mock: Mock, page: Page) -> None:
    mock()
    expect(page.get_by_role("region", name="Plots")).to_have_count(0)
    page.get_by_role("button", name="Plot gantry.x").click()
    expect(page.get_by_role("region", name="Plots")).to_be_visible()


def test_on_a_phone_the_running_job_is_above_the_axes(mock: Mock, page: Page) -> None:
    page.set_viewport_size(SMALL)
    job = {
        **{"job_id": "id-r", "name": "raster", "actor": "a", "state": "running", "step": 0, "steps": 3},
        **{"step_name": "out", "fraction": 0.2, "reason": "", "utc": "2026"},
    }
    mock(make_state(controllers=make_fleet(), jobs={"id-r": job}))
    panel = page.get_by_role("region", name="Running job")
    expect(panel.get_by_text("step 1 of 3")).to_be_in_viewport()
    above, below = panel.bounding_box(), page.get_by_role("region", name="Axes").bounding_box()
    assert above is not None and below is not None and above["y"] < below["y"]


def test_a_target_beyond_the_soft_limits_is_named_before_go(mock: Mock, page: Page) -> None:
    far = {"name": "far", "axes": {"gantry.x": "450 mm", "gantry.y": 10}, "source": "file", "problems": []}
    near = {"name": "near", "axes": {"gantry.x": 400}, "source": "file", "problems": []}
    stream = mock(view="setup", replies={"positions": {"positions": [far, near]}})
    go = page.get_by_role("button", name="Go to far")
    expect(go).to_have_attribute("aria-disabled", "true")
    expect(page.get_by_text("gantry.x: 450.000 mm is beyond the soft limit 400.000 mm").first).to_be_visible()
    expect(page.get_by_role("button", name="Go to near")).not_to_have_attribute("aria-disabled", "true")
    page.get_by_role("button", name="Go: gantry.x").click()
    page.get_by_label("Position in mm").fill("-11")
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_role("button", name="Go to -11")).to_have_attribute("aria-disabled", "true")
    expect(dialog.get_by_text("is beyond the soft limit -10.000 mm")).to_be_visible()
    assert not stream.find("work")


def test_all_alarms_are_acknowledged_from_the_list_in_every_view(mock: Mock, page: Page) -> None:
    alarm = {
        **{"kind": "vacuum", "priority": "high", "text": "too high", "action": "see `tutti trace`"},
        **{"state": "unacknowledged", "raised_utc": "2026-01-01T00:00:00Z", "count": 1},
    }
    alarms = {name: {**alarm, "id": name, "subject": name} for name in ("a", "b")}
    stream = mock(make_state(alarms=alarms), replies={"acknowledge": DONE})
    page.get_by_role("button", name="2 alarms").click()
    expect(page.get_by_role("dialog")).to_contain_text("see Links, in Service")
    page.get_by_role("button", name="Acknowledge all 2").click()
    wait_for(page, lambda: stream.asked)
