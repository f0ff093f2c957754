"""An export replaces a plain file, and nothing else."""

import os
import stat

import pytest

from skincal.files import atomic
from skincal.files.atomic import write_atomically
from skincal.model.errors import InputError

posix = pytest.mark.skipif(os.name == "nt", reason="links, rights and pipes are others there")


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@posix
def test_no_link_device_or_pipe_is_replaced(tmp_path):
    letter = tmp_path / "letter"
    letter.write_text("dear")
    (tmp_path / "link").symlink_to(letter)
    (tmp_path / "dangling").symlink_to(tmp_path / "nothing")
    (tmp_path / "null").symlink_to("/dev/null")
    os.mkfifo(tmp_path / "pipe")
    before = names(tmp_path)
    for name in ("link", "dangling", "null", "pipe"):
        with pytest.raises(InputError, match=r"is a link|is a device or a pipe"):
            write_atomically(tmp_path / name, b"new")
    assert letter.read_text() == "dear"
    assert stat.S_ISFIFO((tmp_path / "pipe").lstat().st_mode)
    assert names(tmp_path) == before


@pytest.mark.parametrize(
    "name", ["segment-0001.mcap", "segment-0002.jsonl", "session.lock", "scene/scene.toml", "scene/new.txt"]
)
def test_no_part_of_a_session_is_replaced(tmp_path, name):
    (tmp_path / "scene").mkdir()
    for each in ("segment-0001.mcap", "scene/scene.toml"):
        (tmp_path / each).write_bytes(b"recorded")
    with pytest.raises(InputError, match="part of a recorded session"):
        write_atomically(tmp_path / name, b"new")
    assert (tmp_path / "segment-0001.mcap").read_bytes() == (tmp_path / "scene/scene.toml").read_bytes() == b"recorded"


@posix
def test_the_mode_stays(tmp_path):
    path = tmp_path / "a.txt"
    write_atomically(path, b"1")
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~_umask()
    path.chmod(0o640)
    write_atomically(path, b"2")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert path.read_bytes() == b"2"


def _umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_every_older_file_is_kept_by_its_number(tmp_path):
    path = tmp_path / "a.txt"
    for text in (b"1", b"2", b"3", b"4"):
        write_atomically(path, text)
    assert names(tmp_path) == ["a.txt", "a.txt.bak", "a.txt.bak-2", "a.txt.bak-3"]
    assert [(tmp_path / name).read_bytes() for name in names(tmp_path)] == [b"4", b"1", b"2", b"3"]


def _refuse(*_):
    raise OSError(1, "Operation not permitted")


@pytest.mark.parametrize("refused", ["fsync", "chmod", "replace", "copyfileobj"])
def test_what_fails_leaves_nothing_behind(tmp_path, monkeypatch, refused):
    path = tmp_path / "a.txt"
    path.write_bytes(b"old")
    with monkeypatch.context() as patch:
        owner = {"fsync": os, "copyfileobj": atomic.shutil}.get(refused, type(path))
        patch.setattr(owner, refused, _refuse)
        with pytest.raises(InputError, match="cannot be written"):
            write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert not [name for name in names(tmp_path) if "part" in name or (refused == "copyfileobj" and "bak" in name)]


def test_names_that_the_system_refuses(tmp_path):
    for name in ("x" * 300, "a\0b"):
        with pytest.raises(InputError, match="cannot be written"):
            write_atomically(tmp_path / name, b"")
    long = tmp_path / ("x" * 240)
    write_atomically(long, b"1")
    assert names(tmp_path) == [long.name]
