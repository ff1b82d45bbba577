"""Cameras in the fleet file: only addresses that a browser's policy can name exactly, and that give nothing away."""

import re

import pytest

from orchestrator.gateway.guard import make_content_policy
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, parse_document
from orchestrator.model.web_views import WebView

FLEET = """schema: tutti.fleet/1
fleet: demo
controllers:
  gantry:
    adapter: smc4000
    link: {kind: tcp, host: 127.0.0.1, port: 2023}
    axes:
      x: {motors: [X], unit: mm, limits: {velocity: 200, acceleration: 1000}}
"""


def load(*views: str) -> Fleet:
    text = FLEET + ("web:\n  views:\n" + "".join(f"    - {view}\n" for view in views) if views else "")
    return parse_document(text, Fleet, "f.yaml")


def test_views_have_a_kind_and_an_origin() -> None:
    above, side = load(
        "{title: ' From above ', url: 'http://192.0.2.7/a.mjpg?w=640#x'}",
        "{title: Side, url: 'HTTPS://Media.lab:8889/side/', kind: page}",
    ).web.views
    assert (above.title, above.kind, above.origin) == ("From above", "image", "http://192.0.2.7")
    assert (side.kind, side.origin) == ("page", "https://media.lab:8889")


def test_cameras_are_no_difference_between_the_parts_of_a_fleet() -> None:
    """A host with an older copy of the file drives the same machine."""
    assert load().digest == load("{title: a, url: 'http://cam/'}").digest


@pytest.mark.parametrize(
    ("url", "problem"),
    [
        ("javascript:alert(1)", "it must begin with http:// or https://, e.g. http://camera-1.lab:8080/stream.mjpg"),
        ("data:text/html,x", "it must begin with http:// or https://"),
        ("file:///etc/passwd", "it must begin with http:// or https://"),
        ("//cam/x", "it must begin with http:// or https://"),
        ("cam/x", "it must begin with http:// or https://"),
        ("http:///x", "it has no host, write e.g. http://camera-1.lab:8080/stream.mjpg"),
        ("http://:80/x", "it has no host"),
        ("http://eve:secret@cam/", "has a user or a password, which every page would show; give the camera a user"),
        ("rtsp://eve:secret@cam/", "has a user or a password"),
        ("http://eve@cam/", "has a user or a password"),
        ("http://*/x", "the host '*' is no name and no IPv4 address"),
        ("http://*.lab/x", "the host '*.lab' is no name"),
        ("http://a;script-src/", "the host 'a;script-src' is no name"),
        ("http://a,b/", "the host 'a,b' is no name"),
        ("http://[::1]/x", "the host '::1' is no name and no IPv4 address"),
        ("http://käm/", "has a character that an address does not have; write it as %XX"),
        ("http://cam/a b", "has a character that an address does not have"),
        ("http://cam/a\\nb", "has a character that an address does not have"),
        ("http://cam:0/", "has a colon and no port after its host"),
        ("http://cam:/", "has a colon and no port after its host"),
        ("http://cam:99999/", "is no address (Port out of range"),
        ("http://cam/" + "x" * 500, "has 511 entries or characters; at most 500"),
    ],
)
def test_an_address_that_the_page_must_not_show_is_refused_with_its_line(url: str, problem: str) -> None:
    with pytest.raises(FileError) as caught:
        load("{title: a, url: 'http://cam/'}", f'{{title: b, url: "{url}"}}')
    (found_problem,) = caught.value.problems
    assert (found_problem.line, found_problem.field) == (12, "web.views[1].url")
    assert problem in found_problem.text
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    ("views", "problem"),
    [
        (["{title: '', url: 'http://cam/'}"], "f.yaml:11: web.views[0].title: must be a text that is seen"),
        (['{title: "a\\tb", url: "http://cam/"}'], "f.yaml:11: web.views[0].title: must be a text that is seen"),
        (["{title: a, url: 'http://cam/', kind: video}"], "f.yaml:11: web.views[0].kind: found 'video'; allowed: 'image'"),
        (["{title: a}"], "f.yaml:11: web.views[0].url: is missing"),
        (["{title: a, url: 'http://a/'}", "{title: a, url: 'http://b/'}"], "two views have the title 'a'; give each its own"),
        ([f"{{title: v{number}, url: 'http://cam/'}}" for number in range(9)], "f.yaml:10: web.views: has 9 entries"),
    ],
)  # fmt: skip
def test_wrong_views_are_refused_in_words(views: list[str], problem: str) -> None:
    with pytest.raises(FileError, match=re.escape(problem)):
        load(*views)


def test_the_policy_names_each_origin_for_its_kind_alone() -> None:
    plain = make_content_policy([])
    assert "frame-src" not in plain and "img-src 'self' data: blob:;" in plain
    views = [
        WebView(title="a", url="http://cam/1"),
        WebView(title="b", url="http://cam/2"),
        WebView(title="c", url="https://media.lab:8889/side", kind="page"),
    ]
    parts = dict(part.strip().partition(" ")[::2] for part in make_content_policy(views).split(";"))
    assert parts.pop("img-src") == "'self' data: blob: http://cam"
    assert parts.pop("frame-src") == "https://media.lab:8889"
    assert parts == dict(part.strip().partition(" ")[::2] for part in plain.split(";") if "img-src" not in part)


def test_settings_of_integrations_are_no_difference_either() -> None:
    text = FLEET + "integrations:\n  ros2: {domain: 7, joints: {a: gantry.x}}\n"
    fleet = parse_document(text, Fleet, "f.yaml")
    assert fleet.integrations == {"ros2": {"domain": 7, "joints": {"a": "gantry.x"}}}
    assert (fleet.digest, "integrations" in load().to_plain()) == (load().digest, False)
    with pytest.raises(FileError, match="integrations"):
        parse_document(FLEET + "integrations: {ros2: 7}\n", Fleet, "f.yaml")
