"""The simulators against the test vectors of the manuals. The counts may only rise."""

from pathlib import Path

import pytest

from sim.core.vectors import check_file, same_reply

VECTORS = Path(__file__).parent / "vectors"
AT_LEAST = {
    "vectors": {"smc2000": 164, "smc4000": 136, "shrc203": 400, "smc30": 94, "ppsmc": 82},
    # From the manuals' application chapters and whole programs.
    "applications": {"smc2000": 18, "smc4000": 33, "shrc203": 37, "smc30": 21, "ppsmc": 20},
}


@pytest.mark.parametrize(("kind", "model"), [(kind, model) for kind, counts in AT_LEAST.items() for model in counts])
def test_vectors(kind: str, model: str) -> None:
    report = check_file(model, VECTORS / f"{model}.{kind}.jsonl")
    assert list(report.failures.values()) == []
    assert len(report.passed) >= AT_LEAST[kind][model]


def test_replies_are_compared_as_the_vector_defines() -> None:
    assert same_reply("1\r\n", "1\r\n", "exact")
    assert not same_reply("1\r\n", "1", "exact")
    assert same_reply(" 1, 2", "1,2", "blanks")
    assert same_reply("0010.00,-3", "10,-003.0", "numeric")
    assert not same_reply("10,K", "10,R", "numeric")
    assert same_reply("a\r\nb", " a\nb \r\n", "lines")


def test_a_vector_that_does_not_hold_is_reported(tmp_path: Path) -> None:
    file = tmp_path / "wrong.jsonl"
    file.write_text('{"id": "smc4000-x", "lines": "L1", "send": "MG 1+1\\r", "expect": {"reply": "3\\r\\n:"}}\n')
    failure = check_file("smc4000", file).failures["smc4000-x"][0]
    assert failure.sent == "MG 1+1\r"
    assert "3" in failure.expected
    assert "2.0000" in failure.received


@pytest.mark.parametrize("text", ["nonsense\n", "[1]\n", '{"id": "a"}\n'])
def test_a_bad_file_is_named_with_its_line(tmp_path: Path, text: str) -> None:
    file = tmp_path / "bad.jsonl"
    file.write_text("\n" + text)
    with pytest.raises(ValueError, match=r"bad\.jsonl:2: "):
        check_file("smc4000", file)


def test_unknown_model_and_id() -> None:
    with pytest.raises(ValueError, match=r"known models: .*shrc203"):
        check_file("abc", VECTORS / "smc4000.vectors.jsonl")
    with pytest.raises(ValueError, match="no vector has the id"):
        check_file("smc4000", VECTORS / "smc4000.vectors.jsonl", only="smc4000-none")
