"""Mutated files: each is read, or refused with places and remedies, in bounded time; none ends in another error."""

import random
import time
from pathlib import Path

import pytest

from orchestrator.model.jobs.files import FileError, load_fleet, parse_document, read_document
from orchestrator.model.jobs.job import Job
from orchestrator.model.templates.template import load_job

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
FILES = [
    EXAMPLES / name
    for name in ("demo.fleet.yaml", "demo.job.yaml", "chain.fleet.yaml", "all.job.yaml", "scan.template.job.yaml")
]
LIMIT_S = 1.0
CASES = 2000
NIGHTLY = 500_000

NASTY = [
    *(
        "010",
        "1:30",
        "1_000",
        "no",
        "on",
        "~",
        "null",
        ".inf",
        "-.inf",
        ".nan",
        "1e999",
        "1e-999",
        "-0",
        "0x1F",
        "0o17",
    ),
    *("9" * 100, "1e99999999", "1/0", "10000/3", "2026-11-25", "1,5", '"200 mm/s"', "50%", "µm", "°", "\u2028", "😀"),
    *(
        "<<: *a",
        "&a",
        "*a",
        "!!float",
        "!!python/object:os.system",
        "!!binary",
        "? ",
        ": ",
        "- ",
        "|",
        ">",
        "%TAG ! x",
        "---",
        "...",
    ),
    *(
        "[" * 40,
        "{" * 40,
        "[]",
        "{}",
        "{a: 1}",
        "''",
        '"',
        "'",
        "\t",
        "\r",
        "\x00",
        "\x85",
        "\ufeff",
        "#",
        "\\",
        "true",
        "schema",
    ),
]


def mutate(data: bytes, draw: random.Random) -> bytes:
    """One to six changes of bytes, lines, words or values."""
    for _ in range(draw.randint(1, 6)):
        at, end = sorted((draw.randrange(len(data) + 1), draw.randrange(len(data) + 1)))
        end = min(end, at + 40)
        word = draw.choice(NASTY).encode()
        lines = data.split(b"\n")
        here, there = draw.randrange(len(lines)), draw.randrange(len(lines))
        match draw.randrange(8):
            case 0:
                data = data[:at] + bytes([draw.randrange(256)]) + data[at + 1 :]
            case 1:
                data = data[:at] + data[end:]
            case 2:
                data = data[:at] + word + data[at:]
            case 3:
                data = data[:at] + data[at:end] * 3 + data[end:]
            case 4:
                lines.insert(there, lines[here])
                data = b"\n".join(lines)
            case 5:
                del lines[here]
                data = b"\n".join(lines)
            case 6:
                key, colon, _ = lines[here].partition(b": ")
                lines[here] = key + colon + word
                data = b"\n".join(lines)
            case _:
                lines[here] = b" " * draw.randrange(6) + lines[here].lstrip()
                data = b"\n".join(lines)
        data = data or b"\n"
    return data


def run_cases(first: int, cases: int, folder: Path) -> None:
    path = folder / "mutated.yaml"
    refused = 0
    for seed in range(first, first + cases):
        draw = random.Random(seed)
        source = FILES[seed % len(FILES)]
        path.write_bytes(mutate(source.read_bytes(), draw))
        load = load_job if ".job." in source.name else load_fleet
        began_s = time.process_time()
        try:
            load(path)
        except FileError as error:
            refused += 1
            for problem in error.problems:
                assert problem.line >= 1 and problem.text, seed
        except Exception as error:
            raise AssertionError(f"seed {seed}: {type(error).__name__}") from error
        assert time.process_time() - began_s < LIMIT_S, seed
    assert cases / 3 < refused < cases


@pytest.mark.parametrize("part", range(4))
def test_mutated_files_are_read_or_refused(part: int, tmp_path: Path) -> None:
    run_cases(part * CASES // 4, CASES // 4, tmp_path)


@pytest.mark.nightly
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("part", range(8))
def test_many_mutated_files_are_read_or_refused(part: int, tmp_path: Path) -> None:
    run_cases(CASES + part * NIGHTLY // 8, NIGHTLY // 8, tmp_path)


HEAD = "schema: tutti.job/1\nname: j\nsteps:\n"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[" * 200_000, "nested deeper than 32"),
        ("{a: " * 200_000, "nested deeper than 32"),
        ("- " * 200_000, "nested deeper than 32"),
        (HEAD + "  - {do: dwell, duration: 1 s}\n" * 200_000, "has more than 10000 entries"),
        (
            "a: &a0 [x, x]\n" + "".join(f"k{n}: &a{n + 1} [{', '.join([f'*a{n}'] * 8)}]\n" for n in range(20)),
            "more than 1000000 values",
        ),
        ("".join(f"k{n}: &a{n} 1\nj{n}: *a{n}\n" for n in range(2000)), "more than 1000 aliases"),
        ("a: &a [*a]", "alias *a is inside its own anchor"),
        ("x" * 17_000_000, "the maximum is 16777216"),
        ("a: '" + "\n" * 200_000, "not YAML"),
        ("#" * 5_000_000, "must be a mapping that starts with `schema:`"),
        ('a: "' + "\\x" * 100_000 + '"', "not YAML"),
    ],
    ids=range(11),
)
def test_documents_that_would_take_all_memory_or_time(text: str, expected: str) -> None:
    began_s = time.process_time()
    with pytest.raises(FileError, match=expected.replace("*", r"\*")):
        parse_document(text, Job, "f.yaml")
    assert time.process_time() - began_s < LIMIT_S


def test_a_number_of_many_digits_is_refused_where_it_stands() -> None:
    with pytest.raises(FileError, match=r"f\.yaml:2: b: a number of 5000 characters; the maximum is 60"):
        read_document("a: 1\nb: " + "9" * 5000, "f.yaml")
