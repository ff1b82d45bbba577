"""Geometry of paths: lengths and their inverse, derivatives, corners within their tolerance, degenerate pieces."""

import numpy as np
import pytest

from benches.paths.random_paths import KINDS, random_outline
from orchestrator.model.paths.circles import IN_MM
from orchestrator.plan.path.arc_length import find_lengths, find_parameters
from orchestrator.plan.path.corners import fit_corners, make_track
from orchestrator.plan.path.curves import evaluate_polys
from orchestrator.plan.path.errors import PathRefusal
from orchestrator.plan.path.outline import SMOOTH, Circle, Outline, OutlineBuilder, PieceEnd
from orchestrator.plan.path.track import Frame, Track

SEEDS = range(12)


def rounded(outline: Outline, frame: Frame | None = None) -> Track:
    return make_track(outline, frame, fit_corners(outline, even=True))


def draw_track(seed: int, frame: bool = False) -> Track:
    draw = np.random.default_rng(seed)
    axes = int(draw.integers(2, 6))
    outline = random_outline(draw, axes, 8)
    turned = Frame(draw.normal(size=(axes, axes)), draw.normal(size=axes)) if frame else None
    return rounded(outline, turned)


def lines(points: list[list[float]], tolerance: float = 0.1) -> Outline:
    builder = OutlineBuilder(np.array(points[0], dtype=float))
    for number, point in enumerate(points[1:]):
        builder.add_line(PieceEnd(number, tolerance), np.array(point, dtype=float))
    return builder.build()


@pytest.mark.parametrize("seed", SEEDS)
def test_lengths_and_their_inverse_hold_1e_9(seed: int) -> None:
    track = draw_track(seed)
    coefficients, table = track.shapes.polys
    draw = np.random.default_rng(seed)
    row = np.repeat(np.arange(len(coefficients)), 5)
    u = draw.uniform(0, 1, len(row))
    whole = table.lengths[row, -1]
    # Lengths against 2,000 chords each, extrapolated (their error falls by four where they are halved).
    for k in range(0, len(row), 7):
        chords = []
        for n in (1000, 2000):
            fine = np.linspace(0, u[k], n + 1)
            q = evaluate_polys(coefficients, np.full(n + 1, row[k]), fine).q
            chords.append(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())
        true = (4 * chords[1] - chords[0]) / 3
        assert find_lengths(coefficients, table, row[k : k + 1], u[k : k + 1])[0] == pytest.approx(
            true, abs=1e-9 * whole[k]
        )
    s = draw.uniform(0, 1, len(row)) * whole
    back = find_lengths(coefficients, table, row, find_parameters(coefficients, table, row, s, 3))
    assert (np.abs(back - s) <= 1e-9 * whole).all()


@pytest.mark.parametrize("frame", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_derivatives_are_those_of_the_positions(seed: int, frame: bool) -> None:
    track = draw_track(seed, frame)
    draw = np.random.default_rng(seed)
    span = np.arange(len(track.kind)).repeat(4)
    local = draw.uniform(0.1, 0.9, len(span)) * track.length[span]
    h = 1e-4 * track.length[span]
    at, before, after = (track.evaluate_spans(span, local + step) for step in (0 * h, -h, h))
    for k in range(3):
        slope = (after[k] - before[k]) / (2 * h[:, None])
        bend = np.abs(at[k + 1]).max() + np.abs(slope).max()
        assert np.abs(slope - at[k + 1]).max() <= 1e-4 * bend
    if not frame:
        assert np.linalg.norm(at.first, axis=1) == pytest.approx(1.0, abs=1e-9)
        across = np.abs((at.first * at.second).sum(axis=1))
        assert (across <= 1e-9 * (1 + np.linalg.norm(at.second, axis=1))).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_where_the_motion_goes_on_tangent_and_curvature_do_too(seed: int) -> None:
    track = draw_track(seed)
    on = np.flatnonzero(~track.stop[:-1])
    ends = track.evaluate_spans(on, track.length[on])
    starts = track.evaluate_spans(on + 1, np.zeros(len(on)))
    assert np.abs(ends.q - starts.q).max() < 1e-8
    assert np.abs(ends.first - starts.first).max() < 1e-7
    curvature = np.linalg.norm(ends.second, axis=1, keepdims=True)
    assert (np.abs(ends.second - starts.second) <= 1e-5 * (1 + curvature)).all()


@pytest.mark.parametrize("turn", [1, 20, 60, 90, 120, 140, 149])
@pytest.mark.parametrize("tolerance", [0.05, 1.0])
def test_the_tolerance_is_the_true_distance_from_the_corner(turn: float, tolerance: float) -> None:
    angle = np.radians(turn)
    corner = np.array([200.0, 0.0])
    track = rounded(lines([[0, 0], [200, 0], [200 + 200 * np.cos(angle), 200 * np.sin(angle)]], tolerance))
    blend = int(np.flatnonzero(track.blend)[0])
    n = 20_001
    q = track.evaluate_spans(np.full(n, blend), np.linspace(0, track.length[blend], n)).q
    distance = np.linalg.norm(q - corner, axis=1).min()
    assert distance <= tolerance * (1 + 1e-9)
    limited = track.length[0] < 100.1  # half of the line is used up
    assert limited or distance == pytest.approx(tolerance, rel=1e-6)


@pytest.mark.parametrize("seed", SEEDS)
def test_blends_of_curved_pieces_stay_within_the_tolerance(seed: int) -> None:
    """True distances in both senses, from dense points: of the blend from the outline, and the other way round."""
    outline = random_outline(np.random.default_rng(seed), 2 + seed % 2, 6, ("arc", "circle", "spline"))
    track = rounded(outline)
    assert track.blend.any()
    for blend in np.flatnonzero(track.blend):
        before = int(track.source[blend])
        q = track.evaluate_spans(np.full(400, blend), np.linspace(0, track.length[blend], 400)).q
        cut = outline.length[before] - track.low[blend - 1] - track.length[blend - 1], track.low[blend + 1]
        sharp = [
            outline.shapes.evaluate(np.full(400, outline.kind[k]), np.full(400, outline.row[k]), s).q
            for k, s in (
                (before, np.linspace(outline.length[before] - cut[0], outline.length[before], 400)),
                (before + 1, np.linspace(0, cut[1], 400)),
            )
        ]
        distances = np.linalg.norm(q[:, None] - np.vstack(sharp)[None], axis=2)
        step = track.length[blend] / 400
        worst = max(distances.min(axis=1).max(), distances.min(axis=0).max())
        assert worst <= outline.tolerance[before] + step


def test_neighbouring_blends_share_a_short_line() -> None:
    track = rounded(lines([[0, 0], [100, 0], [100, 0.2], [0, 0.2]], tolerance=5.0))
    assert track.blend.sum() == 2
    at = track.evaluate_spans(np.flatnonzero(track.blend)[1:], np.zeros(1)).q
    assert at[0] == pytest.approx([100, 0.1])
    assert (track.length > 0).all()


def test_lines_that_go_straight_on_need_neither_stop_nor_blend() -> None:
    track = rounded(lines([[0, 0], [10, 10], [30, 30]]))
    assert track.stop.tolist() == [False, True] and not track.blend.any()


def test_a_tangent_arc_is_blended_for_third_order_and_joined_for_second() -> None:
    builder = OutlineBuilder(np.zeros(2))
    builder.add_line(PieceEnd(0, 0.1), np.array([50.0, 0.0]))
    builder.add_arc(PieceEnd(1, 0.1), Circle((0, 1), (50.0, 25.0), ccw=True), np.array([50.0, 50.0]))
    outline = builder.build()
    assert rounded(outline).blend.tolist() == [False, True, False]
    second = make_track(outline, None, fit_corners(outline, even=False))
    assert second.stop.tolist() == [False, True] and not second.blend.any()


@pytest.mark.parametrize("turn", [155.0, 180.0])
def test_a_reversal_is_a_stop(turn: float) -> None:
    angle = np.radians(turn)
    track = rounded(lines([[0, 0], [50, 0], [50 + 50 * np.cos(angle), 50 * np.sin(angle)]]))
    assert track.stop.tolist() == [True, True]


def test_a_full_circle_and_a_helix() -> None:
    builder = OutlineBuilder(np.array([10.0, 0.0, 0.0]))
    builder.add_arc(PieceEnd(0), Circle((0, 1), (0.0, 0.0), ccw=True), np.array([10.0, 0.0, 0.0]))
    builder.add_arc(PieceEnd(1), Circle((0, 1), (0.0, 0.0), ccw=False, turns=1), np.array([0.0, 10.0, 7.0]))
    outline = builder.build()
    assert outline.length[0] == pytest.approx(20 * np.pi, rel=1e-12)
    assert outline.length[1] == pytest.approx(np.hypot(20 * np.pi * 1.75, 7), rel=1e-12)
    track = rounded(outline)
    q = track.evaluate(np.array([outline.length[0] / 4, outline.length[0] + outline.length[1] / 7])).q
    assert q[0] == pytest.approx([0, 10, 0], abs=1e-12)
    assert q[1] == pytest.approx([0, -10, 1], abs=1e-12)  # clockwise: a quarter turn of 1.75


def test_an_arc_through_a_point_takes_the_side_of_the_point() -> None:
    for side, length in ((1.0, np.pi / 2), (-1.0, 3 * np.pi / 2)):
        builder = OutlineBuilder(np.array([1.0, 0.0]))
        builder.add_arc_through(PieceEnd(0), side * np.array([1.0, 1.0]) / np.sqrt(2), np.array([0.0, 1.0]))
        assert builder.build().length[0] == pytest.approx(length, rel=1e-12)


def test_a_spline_goes_through_its_points_without_a_jump_of_curvature() -> None:
    points = np.array([[10, 5], [20, -5], [30, 5], [25, 20]], dtype=float)
    builder = OutlineBuilder(np.zeros(2))
    builder.add_spline(PieceEnd(0), points)
    track = rounded(builder.build())
    near = [
        np.linalg.norm(track.evaluate(np.linspace(0, track.end, 20_001)).q - point, axis=1).min() for point in points
    ]
    assert max(near) < 5e-3
    assert not track.stop[:-1].any() and not track.blend.any()


def refuse(code: str, words: str, piece: int, build: object) -> None:
    builder = OutlineBuilder(np.zeros(2))
    builder.add_line(PieceEnd(0), np.array([1.0, 0.0]))
    with pytest.raises(PathRefusal, match=words) as caught:
        build(builder)  # type: ignore[operator]
    assert (caught.value.code, caught.value.piece) == (code, piece)
    assert caught.value.remedy and caught.value.text.startswith(f"piece {piece}")


def point(x: float, y: float) -> np.ndarray:
    return np.array([x, y])


def test_degenerate_pieces_are_refused_by_name() -> None:
    end = PieceEnd(1)
    refuse("zero-length", "line.*no length", 2, lambda b: b.add_line(end, point(1, 0)))
    refuse("zero-length", "line.*no length", 2, lambda b: b.add_line(end, point(1, 1e-16)))
    refuse("collinear", "straight line", 2, lambda b: b.add_arc_through(end, point(2, 0), point(3, 0)))
    refuse("doubled-point", "start and `through`", 2, lambda b: b.add_arc_through(end, point(1, 0), point(3, 0)))
    refuse("doubled-point", "start and `to`", 2, lambda b: b.add_arc_through(end, point(2, 1), point(1, 0)))
    refuse(
        "no-circle",
        "end of the arc is 2 from .* its start 1",
        2,
        lambda b: b.add_arc(end, Circle((0, 1), (0, 0), True), point(0, 2)),
    )
    refuse("zero-length", "arc", 2, lambda b: b.add_arc(end, Circle((0, 1), (1, 0), True), point(0, 2)))
    refuse("doubled-point", "point 1 is the same as the start", 2, lambda b: b.add_spline(end, np.array([[1.0, 0.0]])))
    refuse(
        "doubled-point", "point 2 is the same as point 1", 2, lambda b: b.add_spline(end, np.array([[2.0, 0], [2, 0]]))
    )
    cusp = np.zeros((1, 6, 2))
    cusp[0, 2, 0], cusp[0, 1, 0] = 1.0, -1.0  # goes back on itself at u = 1/2
    refuse("cusp", "cusp", 2, lambda b: b.add_polys(end, cusp, "spline"))


def test_a_spline_that_goes_back_on_itself_is_a_cusp() -> None:
    refuse("cusp", "spline.*cusp", 2, lambda b: b.add_spline(PieceEnd(1), np.array([[2.0, 0.0], [1.5, 0.0]])))


def test_inside_a_spline_joints_are_smooth() -> None:
    outline = random_outline(np.random.default_rng(0), 3, 1, ("spline",))
    assert (outline.tolerance[:-1] == SMOOTH).all() and KINDS


@pytest.mark.parametrize(
    ("end", "words"),
    [((10.001, 0.0), "full circle that does not end at its start"), ((10.0, -0.001), "from its start")],
)
def test_a_circle_whose_end_is_off_by_rounding_does_not_become_a_point(end: tuple[float, float], words: str) -> None:
    builder = OutlineBuilder(point(10, 0))
    circle = Circle((0, 1), (5, 0), False, precision=IN_MM)
    with pytest.raises(PathRefusal, match=words):
        builder.add_arc(PieceEnd(0), circle, point(*end))
    builder.add_arc(PieceEnd(0), circle, point(9.99, 0.2))
    assert builder.build().length[0] == pytest.approx(2 * np.pi * 5, rel=0.02)
