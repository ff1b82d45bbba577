"""Metrics of a fleet at work, against its reports; and the dashboard that shows them."""

import asyncio
import json
import re
from pathlib import Path
from urllib.request import urlopen

import pytest
from cluster.recordings import RecordedFleet
from cluster.worlds import PREPARE, demo_job, job, run_fleet, virtual_demo_fleet
from prometheus_client import CollectorRegistry, Gauge, generate_latest

from orchestrator.model.report import JobReport
from orchestrator.monitor.metrics.fleet_metrics import FleetMetrics
from orchestrator.monitor.metrics.server import NoPort, serve_metrics
from orchestrator.runtime.virtual.fleet import VirtualFleet

DASHBOARD = Path(__file__).parents[2] / "deploy" / "grafana" / "tutti.json"
IMPOSSIBLE = job("[{do: move, to: {gantry.x: 1, stage.u: 1}}]", max_start_skew="1 us")


class Measured:
    """The metrics after two jobs, one of which was refused, an e-stop and a lost link."""

    def __init__(self, folder: Path) -> None:
        self.reports: list[JobReport] = []
        self.metrics: FleetMetrics
        self.text = run_fleet(lambda virtual: self._measure(virtual, folder), virtual_demo_fleet())

    async def _measure(self, virtual: VirtualFleet, folder: Path) -> str:
        recorded = RecordedFleet(virtual, folder)
        writer = recorded.writer
        metrics = FleetMetrics(virtual.clock, lambda: (writer.written, writer.dropped, writer.invalid))
        writer.on_message = lambda channel, message: metrics.take_message(message)
        await recorded.recorder.start()
        running = asyncio.ensure_future(recorded.recorder.run())
        tutti = virtual.make_client("anna")
        for each in (PREPARE, demo_job(), IMPOSSIBLE):
            self.reports.append(await tutti.wait_for_job(await tutti.submit(each)))
        await tutti.estop("a test")
        virtual.wires["stage"].cut = True
        await asyncio.sleep(8)
        text = generate_latest(metrics.registry).decode()
        running.cancel()
        await recorded.recorder.close()
        return text

    def value(self, name: str, **labels: str) -> float:
        """The value of one series; a part of its labels is enough."""
        found = [
            float(line.rpartition(" ")[2])
            for line in self.text.splitlines()
            if re.match(rf"{name}(\{{|\s)", line) and all(f'{key}="{value}"' in line for key, value in labels.items())
        ]
        assert len(found) == 1, (name, labels, found)
        return found[0]


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Measured:
    return Measured(tmp_path_factory.mktemp("metrics"))


def test_steps_skews_and_budgets_are_those_of_the_reports(measured: Measured) -> None:
    steps = [step for report in measured.reports for step in report.steps if step.members]
    skews = [step.narrowest_skew.at_most_ns / 1e9 for step in steps if step.narrowest_skew]
    budgets = [step.budget.predicted_ns / step.budget.allowed_ns for step in steps if step.budget]
    assert measured.value("tutti_start_skew_seconds_count") == len(skews) > 1
    assert measured.value("tutti_start_skew_seconds_sum") == pytest.approx(sum(skews))
    assert measured.value("tutti_budget_used_ratio_sum") == pytest.approx(sum(budgets))
    assert measured.value("tutti_steps_total", verdict="green") == sum(step.verdict == "green" for step in steps)
    arms = [member.armed_in_ns / 1e9 for step in steps for member in step.members.values()]
    assert measured.value("tutti_stage_seconds_sum", stage="arm") == pytest.approx(sum(arms))


def test_jobs_and_refusals_are_counted_by_what_they_were(measured: Measured) -> None:
    states = [report.state for report in measured.reports]
    assert states == ["done", "done", "failed"]
    assert measured.value("tutti_jobs_total", state="done") == 2
    refused = next(step.refused for report in measured.reports for step in report.steps if step.refused)
    assert measured.value("tutti_refusals_total", code=refused.code) == 1


def test_what_is_now_is_shown_as_it_is(measured: Measured) -> None:
    assert measured.value("tutti_controller_online", controller="gantry") == 1
    assert measured.value("tutti_controller_online", controller="stage") == 0
    assert measured.value("tutti_link_losses_total", controller="stage") == 1
    assert measured.value("tutti_estop_latched", controller="gantry") == 1
    assert measured.value("tutti_virtual_ready", group="turned") == 0
    assert 0 <= measured.value("tutti_controller_state_age_seconds", controller="gantry") < 2
    assert 0 < measured.value("tutti_clock_bound_seconds", controller="gantry") < 1e-2
    assert abs(measured.value("tutti_clock_rate_ppm", controller="gantry")) < 500
    assert measured.value("tutti_link_bytes_total", controller="gantry", direction="in") > 1000
    assert measured.value("tutti_recorder_messages_total") > 100


def test_no_label_is_the_id_of_a_job(measured: Measured) -> None:
    assert not any(report.job_id in measured.text for report in measured.reports)


def test_every_metric_of_the_dashboard_exists(measured: Measured) -> None:
    dashboard = json.loads(DASHBOARD.read_text(encoding="utf-8"))
    wanted = {name for panel in dashboard["panels"] for target in panel["targets"] for name in names_in(target["expr"])}
    known = {line.split()[2] for line in measured.text.splitlines() if line.startswith("# TYPE")}
    known |= {f"{name}{end}" for name in known for end in ("_bucket", "_sum", "_count")}
    assert wanted and wanted <= known, wanted - known
    # And what is measured is shown, but for what only a look at one controller needs.
    shown = {re.sub(r"_(bucket|sum|count)$", "", name) for name in wanted}
    unseen = {name for name in known if "_created" not in name} - wanted
    unseen = {name for name in unseen if re.sub(r"_(bucket|sum|count)$", "", name) not in shown}
    assert unseen <= {"tutti_events_total", "tutti_controller_faults", "tutti_recorder_invalid_messages_total"} | {
        name for name in unseen if name.endswith(("_bucket", "_sum", "_count"))
    }


def names_in(expression: str) -> list[str]:
    return re.findall(r"tutti_\w+", expression)


def test_metrics_are_served_on_this_machine_and_a_taken_port_is_left_out() -> None:
    registry = CollectorRegistry()
    Gauge("tutti_test", "A test.", registry=registry).set(4)
    address = serve_metrics(registry, None)
    other = serve_metrics(registry, None)
    assert address != other
    with urlopen(address, timeout=10) as answer:
        assert b"tutti_test 4.0" in answer.read()
    port = int(address.rpartition(":")[2].partition("/")[0])
    with pytest.raises(NoPort, match=f"port {port} of 127.0.0.1 are in use; choose another with --metrics-port"):
        serve_metrics(registry, port)
