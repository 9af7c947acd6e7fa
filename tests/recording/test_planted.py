"""Another local user has put something where a recording will be."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from tests.recording.test_recover import write

from esair.recording import is_whole, recover, replaced
from esair.recording._recover import left_cut

pytest.importorskip("foxglove", reason="needs esair[record]")

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("REC-3", "SEC-2")]


@pytest.fixture
def cut(tmp_path: Path) -> Path:
    """A recording that was cut."""
    write(tmp_path / "run.mcap", 20)
    path = tmp_path / "cut.mcap"
    path.write_bytes((tmp_path / "run.mcap").read_bytes()[:-700])
    (tmp_path / "run.mcap").unlink()
    return path


@pytest.mark.parametrize("name", ["cut-recovered.mcap", "cut-recovered.part"])
def test_recovery_writes_through_no_link(cut: Path, name: str) -> None:
    """What the link leads to stays as it is; the new file is a file of this user alone."""
    victim = cut.parent / "victim"
    victim.write_text("mine")
    (cut.parent / name).symlink_to(victim)
    found = recover(cut)

    assert victim.read_text() == "mine"
    assert not found.path.is_symlink()
    assert is_whole(found.path)
    assert found.path.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("kind", ["pipe", "folder", "of a process"])
def test_what_is_no_file_stays_what_it_is(tmp_path: Path, kind: str) -> None:
    """Of root ``-o /dev/null`` and ``-o /dev/stdout`` made a file of the device."""
    place = tmp_path / "place"
    if kind == "of a process":  # as /dev/stdout, which may lead to a file
        place.symlink_to("/proc/self/exe")
    else:
        (os.mkfifo if kind == "pipe" else os.mkdir)(place)
    before = place.lstat()

    with pytest.raises(FileExistsError, match="expected a file"), replaced(place):
        pass
    assert place.lstat() == before
    assert list(tmp_path.iterdir()) == [place]


def test_what_fails_leaves_nothing_behind(tmp_path: Path) -> None:
    """Neither a half of the new file, nor a descriptor."""
    before = len(os.listdir("/proc/self/fd"))

    def fails() -> None:
        with replaced(tmp_path / "new") as file:
            file.write(b"half")
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        fails()
    assert list(tmp_path.iterdir()) == []
    assert len(os.listdir("/proc/self/fd")) == before


def test_only_what_is_this_users_is_recovered_by_itself(cut: Path) -> None:
    """No link, no file of another user, and nothing where anybody may write."""
    folder = cut.parent
    assert left_cut(folder) == [cut]
    (folder / "linked.mcap").symlink_to(cut)
    (folder / "planted.mcap").symlink_to("/etc/passwd")
    assert left_cut(folder) == [cut]
    (folder / "cut-recovered.mcap").symlink_to("nowhere")
    assert left_cut(folder) == []
    (folder / "cut-recovered.mcap").unlink()
    folder.chmod(0o777)
    assert left_cut(folder) == []
    folder.chmod(0o1777)
    assert left_cut(folder) == [cut]
    if os.geteuid() == 0:
        os.chown(cut, 65534, 65534)
        assert left_cut(folder) == []


def test_what_has_no_room_is_named(tmp_path: Path) -> None:
    """The system says of a full disk only that it is full."""
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with (
        pytest.raises(OSError, match="run-plot"),
        replaced(tmp_path / "run-plot.png"),
    ):
        raise full
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_read_keeps_its_name(tmp_path: Path) -> None:
    """It is no error of the file that would have been made of it."""
    (tmp_path / "run.mcap").mkdir()
    with pytest.raises(IsADirectoryError, match=r"run[.]mcap"):
        recover(tmp_path / "run.mcap")
