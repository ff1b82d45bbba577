"""Pictures of the operators' page: `screenshots.py FOLDER FIGURES`.

All views, light and dark, on a phone, a tablet and a large screen, of the example fleet at work, in FOLDER; two of them
are those of the README, in FIGURES.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from playwright.sync_api import Browser, Page, ViewportSize, expect, sync_playwright

sys.path.insert(0, str(Path(__file__).parents[1]))  # benches are not installed
from benches.page.browser import find_browser
from orchestrator.runtime.live.fleet import find_free_port

ROOT = Path(__file__).resolve().parents[1]
TUTTI = [sys.executable, "-c", "from orchestrator.cli.main import main; main(prog_name='tutti')"]
SIZES: dict[str, ViewportSize] = {
    "390x844": {"width": 390, "height": 844},
    "1280x800": {"width": 1280, "height": 800},
    "2560x1440": {"width": 2560, "height": 1440},
}
VIEWS = {"run": "Axes", "setup": "Jog", "service": "Clocks"}
COLOURS: tuple[Literal["light", "dark"], ...] = ("light", "dark")
FIGURES = {"page-run.png": ("run", "dark"), "page-setup.png": ("setup", "light")}
JOB = """schema: tutti.job/1
name: raster of sample 7
actor: demo
max_start_skew: 10 ms
steps:
  - {do: move, name: to the sample, to: {gantry.x: 20, gantry.y: 40, stage.u: 3, stage.v: 2}}
  - do: repeat
    times: 200
    steps:
      - {do: move, name: out, to: {gantry.x: 180, gantry.y: 90, stage.u: 9}, speed: 0.25}
      - {do: move, name: back, to: {gantry.x: 20, gantry.y: 40, stage.u: 3}, speed: 0.25}
"""


@contextmanager
def run_fleet(folder: Path) -> Iterator[tuple[str, str]]:
    """The example fleet with its page: the router's endpoint, and the address of the page."""
    port, web = find_free_port(), find_free_port()
    command = ["up", str(ROOT / "deploy/examples/demo.fleet.yaml"), "--sim", "--wait", "--detach"]
    subprocess.run([*TUTTI, *command, "--state", str(folder), "--port", str(port), "--web-port", str(web)], check=True)
    try:
        yield f"tcp/127.0.0.1:{port}", f"http://127.0.0.1:{web}/"
    finally:
        subprocess.run([*TUTTI, "down", "--state", str(folder)], check=True)


def prepare_fleet(connect: str, folder: Path) -> None:
    """A running job with a finished step, and jobs that wait."""

    def tutti(*words: str) -> None:
        subprocess.run([*TUTTI, *words, "--connect", connect], check=True, stdout=subprocess.DEVNULL)

    tutti("axis", "enable", "gantry", "stage")
    tutti("axis", "home")
    (folder / "raster.job.yaml").write_text(JOB, encoding="utf-8")
    tutti("submit", str(folder / "raster.job.yaml"))
    for name, options in (("reference scan", ["--priority", "5"]), ("night run", ["--repeat", "3"]), ("proposed", [])):
        (folder / "next.job.yaml").write_text(JOB.replace("raster of sample 7", name), encoding="utf-8")
        tutti("submit", str(folder / "next.job.yaml"), *options, *(["--proposed"] if name == "proposed" else []))
    # The pictures show seconds of history, of the clocks and of motion: these have to pass by the wall clock.
    time.sleep(8.0)


def take_pictures(browser: Browser, address: str, folder: Path, figures: Path) -> None:
    """All views, colours and sizes."""
    for colours in COLOURS:
        for name, size in SIZES.items():
            page = browser.new_page(viewport=size, color_scheme=colours)
            for view, panel in VIEWS.items():
                open_view(page, address, view, panel)
                path = folder / f"{view}-{colours}-{name}.png"
                page.screenshot(path=path)
                print(path)
                for figure, chosen in FIGURES.items():
                    if chosen == (view, colours) and name == "1280x800":
                        page.screenshot(path=figures / figure)
            page.close()


def open_view(page: Page, address: str, view: str, panel: str) -> None:
    """Show a view, with two axes plotted in that of the run."""
    page.goto("about:blank")
    page.goto(f"{address}#{view}")
    expect(page.get_by_role("region", name=panel, exact=True)).to_be_visible()
    for axis in ("gantry.x", "gantry.y") if view == "run" else ():
        button = page.get_by_role("button", name=f"Plot {axis}")
        if button.count() and button.get_attribute("aria-pressed") != "true":
            button.click()
    page.wait_for_timeout(6000 if view == "run" else 1500)


def main() -> None:
    folder, figures = Path(sys.argv[1]), Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="tutti-page-") as place, sync_playwright() as playwright:
        state = Path(place)
        with run_fleet(state / "state") as (connect, address):
            prepare_fleet(connect, state)
            browser = playwright.chromium.launch(executable_path=find_browser(), args=["--no-sandbox"])
            take_pictures(browser, address, folder, figures)
            browser.close()


if __name__ == "__main__":
    main()
