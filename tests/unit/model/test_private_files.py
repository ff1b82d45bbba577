"""Files that only the user of a fleet may read, and links that are not followed."""

from pathlib import Path

import pytest

from orchestrator.model.files.private_files import (
    UnsafePath,
    open_for_append,
    read_private_file,
    replace_private_file,
    restrict_to_user,
)


def test_what_is_created_is_for_this_user_alone(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "file"
    replace_private_file(path, b"one")
    replace_private_file(path, b"two")
    assert read_private_file(path) == b"two" and [each.name for each in path.parent.iterdir()] == ["file"]
    assert [each.stat().st_mode & 0o777 for each in (path, path.parent, path.parent.parent)] == [0o600, 0o700, 0o700]


def test_links_are_refused_or_replaced_and_never_followed(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("mine")
    link = tmp_path / "link"
    for target in (victim, tmp_path / "missing"):
        link.unlink(missing_ok=True)
        link.symlink_to(target)
        for use in (open_for_append, read_private_file, restrict_to_user):
            with pytest.raises(UnsafePath, match=r"link: is a symbolic link, to .*; remove it") as caught:
                use(link)
            assert caught.value.strerror
    (tmp_path / "link.new").symlink_to(victim)
    replace_private_file(link, b"ours")
    assert victim.read_text() == "mine" and not link.is_symlink() and link.read_bytes() == b"ours"
    assert victim.stat().st_mode & 0o777 != 0o600


def test_what_an_earlier_version_created_is_taken_from_other_users(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.touch(mode=0o644)
    path.chmod(0o644)
    restrict_to_user(path)
    restrict_to_user(tmp_path / "missing")
    assert path.stat().st_mode & 0o777 == 0o600
