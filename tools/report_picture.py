"""Draw the report of the demo job as `docs/figures/report.svg`, with the simulated fleet in virtual time."""

import io
import re
from pathlib import Path

from rich.console import Console
from rich.terminal_theme import DEFAULT_TERMINAL_THEME

from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.report import JobReport
from orchestrator.model.templates.template import load_job
from orchestrator.monitor.report_table import make_report_tables
from orchestrator.runtime.virtual.fleet import VirtualFleet

ROOT = Path(__file__).parents[1]
COLUMNS = 84


def run_demo_job() -> JobReport:
    """Run the example job on the example fleet."""

    async def run_job(clock: VirtualClock) -> JobReport:
        fleet = VirtualFleet(load_fleet(ROOT / "deploy/examples/demo.fleet.yaml"), clock, 1)
        await fleet.start()
        job = await fleet.make_client().submit(load_job(ROOT / "deploy/examples/demo.job.yaml"))
        return await job.result()

    return run_virtual(run_job)


def main() -> None:
    """Write the picture. Its fonts are those of the reader: the usual export loads one from a server."""
    console = Console(record=True, width=COLUMNS, file=io.StringIO(), force_terminal=True)
    console.print(make_report_tables(run_demo_job(), detailed=True))
    svg = console.export_svg(title="tutti demo", theme=DEFAULT_TERMINAL_THEME)
    svg = re.sub(r"<!--.*?-->\s*", "", svg, flags=re.DOTALL)
    svg = re.sub(r"@font-face \{.*?\}\s*", "", svg, flags=re.DOTALL).replace("Fira Code", "monospace")
    (ROOT / "docs/figures/report.svg").write_text(svg, encoding="utf-8")


if __name__ == "__main__":
    main()
