"""The display of the jog panel, at 80 columns or more."""

from fractions import Fraction

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from orchestrator.cli.manual.jog.held_key import REPEAT_WAIT_NS, SILENCE_NS, TAP_NS
from orchestrator.cli.manual.jog.panel import IDLE_NS, JogPanel
from orchestrator.cli.manual.jog.work import STEP_SIZES
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.fleet import Axis
from orchestrator.model.state import AxisState

STALE_NS = 2 * NS_PER_S  # without a state of a controller that publishes several per second
WIDE_COLUMNS = 100  # columns from which there is room for wider gaps
# Minimum widths, so that columns do not shift while figures grow.
_MIN_WIDTHS = {"position>": 12, "velocity>": 10, "− room>": 6, "+ room>": 6}
OTHER_LINES = 15  # lines of the screen that are neither rows of axes nor messages

_LIMITS = {"none": "", "reverse": "− end", "forward": "+ end", "both": "both"}
_ARROWS = {-1: "◀◀◀", 0: " ■ ", 1: "▶▶▶"}


def render_panel(panel: JogPanel, now_ns: int, columns: int, rows: int) -> RenderableType:
    """Render the whole panel for a terminal of this size."""
    troubles = _list_troubles(panel, now_ns)
    other_lines = OTHER_LINES + sum(-(-len(text) // columns) for text in troubles)
    axes = _render_axes(panel, now_ns, columns, max(1, rows - other_lines))
    return Group(
        _render_head(panel),
        "",
        axes,
        "",
        _render_motion(panel),
        "",
        *troubles,
        "",
        _render_keys(),
        _describe_release(releases=panel.releases),
    )


def _render_head(panel: JogPanel) -> RenderableType:
    grid = Table.grid(expand=True)
    grid.add_column(no_wrap=True)
    grid.add_column(justify="right", no_wrap=True)
    lease = ("acquired", "bold cyan") if panel.is_acquired else ("not acquired", "dim")
    grid.add_row(
        Text.assemble(("Manual jog", "bold"), f"   fleet {panel.fleet}"), Text.assemble(f"{panel.chosen_axis}: ", lease)
    )
    return grid


def _render_axes(panel: JogPanel, now_ns: int, columns: int, room: int) -> Table:
    """Build one row per axis; as many as fit, around the chosen one."""
    gap = 2 if columns >= WIDE_COLUMNS else 1
    table = Table(box=None, header_style="bold underline", pad_edge=False, padding=(0, gap, 0, 0), expand=True)
    for name in ("", "axis", "position>", "velocity>", "motor", "ref.", "limit", "− room>", "+ room>"):
        right, least = name.endswith(">"), _MIN_WIDTHS.get(name)
        table.add_column(name.removesuffix(">"), justify="right" if right else "left", no_wrap=True, min_width=least)
    table.add_column("held by", ratio=1, no_wrap=True, overflow="ellipsis")
    names = list(panel.axes)
    first = max(0, min(panel.chosen - room // 2, len(names) - room))
    for name in names[first : first + room]:
        is_chosen = name == panel.chosen_axis
        table.add_row(*_make_row(panel, name, now_ns), style="bold" if is_chosen else "")
    return table


def _make_row(panel: JogPanel, name: str, now_ns: int) -> list[str | Text]:
    state_now, axis = panel.axis_state(name), panel.axes[name]
    mark, by = "▸" if name == panel.chosen_axis else "", panel.describe_holder(name)
    held_by = Text(by, style="bold cyan" if by == "you" else "yellow")
    if state_now is None or _is_stale(panel, name, now_ns):
        absence = "offline" if state_now is None else "silent"
        return [mark, name, "-", "-", Text(absence, style="red"), "", "", "", "", held_by]
    low, high = _describe_room(axis, state_now)
    return [
        mark,
        name,
        f"{state_now.position:,.3f} {state_now.unit}",
        f"{state_now.velocity:,.2f} /s",
        Text("on", style="green") if state_now.enabled else Text("off", style="yellow"),
        Text("yes", style="green") if state_now.referenced else Text("no", style="yellow"),
        Text(_LIMITS[state_now.limit], style="bold red"),
        low,
        high,
        held_by,
    ]


def _describe_room(axis: Axis, now: AxisState) -> tuple[str, str]:
    """Return the distances to the soft limits, which are motor positions; unknown for an axis that is not
    referenced."""
    if axis.soft_limits is None:
        return "∞", "∞"
    if not now.referenced:
        return "?", "?"
    low, high = axis.soft_limits.in_unit(axis.unit)
    at = Fraction(now.motor_position)
    return _format_short(float(at - low)), _format_short(float(high - at))


def _format_short(value: float) -> str:
    """Format with four figures, which is enough to see the remaining distance."""
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def _render_motion(panel: JogPanel) -> RenderableType:
    """Describe the speed of a key press, and the current motion."""
    axis, state_now = panel.axes[panel.chosen_axis], panel.axis_state(panel.chosen_axis)
    most = panel.jog_speed(panel.chosen_axis)
    hint = "" if state_now is None or state_now.referenced else ", slow: unreferenced"
    unit = axis.unit
    doing_words = "at rest"
    if panel.work.running is not None:
        doing_words = panel.work.running.words
    elif panel.jog_direction:
        doing_words = "jogging"
    elif state_now is not None and state_now.moving:
        doing_words = "moving"
    length = round(panel.speed_fraction * 20)
    return Group(
        Text.assemble(
            f"{panel.chosen_axis}  ",
            (_ARROWS[panel.jog_direction], "bold cyan" if panel.jog_direction else "dim"),
            f"  {doing_words}",
        ),
        _describe_arrows(panel, unit),
        Text.assemble(
            "speed  ",
            ("━" * length, "cyan"),
            ("─" * (20 - length), "dim"),
            f"  {panel.speed_fraction:.0%} = ",
            (f"{panel.key_speed():.4g} {unit}/s", "bold"),
            f" of {most:.4g} {unit}/s{hint}",
        ),
    )


def _describe_arrows(panel: JogPanel, unit: str) -> Text:
    """What a press of an arrow does now, of all that `tab` chooses."""
    text = Text("arrows ")
    for size in (None, *STEP_SIZES):
        words = "hold" if size is None else f"{size:g}"
        text.append(
            f"[{words}]" if size == panel.work.step_size else f" {words} ",
            "bold cyan" if size == panel.work.step_size else "dim",
        )
    return text.append(f" {unit}", "dim")


def _list_troubles(panel: JogPanel, now_ns: int) -> list[Text]:
    """List the reasons why axes are not ready, and the last refusal."""
    lines: list[Text] = []
    for controller in dict.fromkeys(name.partition(".")[0] for name in panel.axes):
        state = panel.states.get(controller)
        if state is None:
            continue
        if state.estop is not None:
            reason = f": {state.estop.reason}" if state.estop.reason else ""
            text = f"{controller}: E-STOP by {state.estop.actor}{reason} → `tutti reset` when it is safe"
            lines.append(Text(text, style="bold red"))
        lines += [Text(f"{controller}: {fault.text} → {fault.remedy}", style="red") for fault in state.faults]
        if _is_stale(panel, controller, now_ns):
            lines.append(
                Text(f"{controller}: no state received for {_silence_s(panel, controller, now_ns):.0f} s", style="red")
            )
    if panel.refusal is not None:
        remedy = f" → {panel.refusal.remedy}" if panel.refusal.remedy else ""
        lines.append(Text(f"refused: {panel.refusal.text} ({panel.refusal.code}){remedy}", style="bold yellow"))
    if panel.note:
        lines.append(Text(panel.note, style="yellow"))
    return lines


def _silence_s(panel: JogPanel, name: str, now_ns: int) -> float:
    return (now_ns - panel.seen_ns.get(name.partition(".")[0], now_ns)) / NS_PER_S


def _is_stale(panel: JogPanel, name: str, now_ns: int) -> bool:
    return _silence_s(panel, name, now_ns) > STALE_NS / NS_PER_S


def _render_keys() -> RenderableType:
    text = Text()
    for key, meaning in (
        ("←/→", "jog or step"),
        ("↑/↓", "axis"),
        ("+ - 1…9", "speed"),
        ("tab", "step size\n"),
        ("e", "enable"),
        ("h h", "home"),
        ("z z", "zero\n"),
        ("space esc", "stop"),
        ("s", "stop the fleet"),
        ("x", "e-stop"),
        ("q", "leave"),
    ):
        text.append(key, style="bold").append(f" {meaning}   ".replace("\n   ", "\n"), style="dim")
    return text


def _describe_release(*, releases: bool) -> RenderableType:
    if releases:
        silent = f"{SILENCE_NS / NS_PER_S:g} s"
        text = f"Releases are reported: the axis slows down on release, or after {silent} without repeats."
    else:
        text = (
            "Tap, or hold: this terminal reports no releases. The axis slows down within "
            f"{REPEAT_WAIT_NS / NS_PER_MS:g} ms after a release, a tap after {TAP_NS / NS_PER_MS:g} ms."
        )
    idle = f"The axis is released after {IDLE_NS / NS_PER_S:g} s at rest."
    return Text(f"{text} {idle}", style="dim")
