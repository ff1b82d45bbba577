"""Jobs that arrive as text."""

import pytest

from tutti import FileError, read_job

JOB = "schema: tutti.job/1\nname: scan\nsteps:\n  - {do: dwell, duration: 1 s}\n"


def test_a_job_is_read_from_text() -> None:
    assert read_job(JOB).name == "scan"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "not YAML"),
        ("- 1", "must be a mapping"),
        (JOB.replace("dwell", "dance"), "dance"),
        (JOB + "  - {do: scan, points: {file: /etc/passwd}}\n", "points in a file"),
    ],
)
def test_what_is_no_job_and_what_names_files_here_is_refused(text: str, words: str) -> None:
    with pytest.raises(FileError, match=words):
        read_job(text)
