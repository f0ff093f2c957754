"""The solver's compiled program is kept, and what another may have written is never run."""

import os

import pytest
import wasmtime

from skincal.solver import compiled as kept
from skincal.solver.compiled import compiled, kept_at
from skincal.solver.machine import PROGRAM

pytestmark = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="nothing is kept where no rights can be asked for")
PLAIN_POSE = PROGRAM.read_bytes()


@pytest.fixture(autouse=True)
def own(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


@pytest.fixture
def loaded(monkeypatch):
    """Load the program; return whether it was read back."""
    compilations = []

    class Watched(wasmtime.Module):
        def __init__(self, *arguments):
            compilations.append(arguments)
            super().__init__(*arguments)

    monkeypatch.setattr(kept.wasmtime, "Module", Watched)

    def load():
        compilations.clear()
        engine = wasmtime.Engine()
        store = wasmtime.Store(engine)
        exports = wasmtime.Instance(store, compiled(engine, PLAIN_POSE), []).exports(store)
        assert exports["answer_size"](store) > 0
        return not compilations

    return load


def test_the_second_start_reads_what_the_first_has_compiled(loaded):
    assert not loaded()
    assert kept_at(PLAIN_POSE).stat().st_mode & 0o777 == 0o600
    assert kept_at(PLAIN_POSE).parent.stat().st_mode & 0o777 == 0o700
    assert list(kept_at(PLAIN_POSE).parent.iterdir()) == [kept_at(PLAIN_POSE)]
    assert loaded()


def cut(path):
    path.write_bytes(path.read_bytes()[:-100])


def flipped(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))


def empty(path):
    path.write_bytes(b"")


def foreign(path):
    """Whole by its checksum, and none of wasmtime's."""
    path.write_bytes(kept.hashlib.sha256(b"other").digest() + b"other")


def for_all(path):
    path.chmod(0o622)


def open_folder(path):
    path.parent.chmod(0o777)


def linked(path):
    path.rename(path.with_name("other"))
    path.symlink_to(path.with_name("other"))


@pytest.mark.parametrize("spoilt", [cut, flipped, empty, foreign, for_all, linked])
def test_what_is_not_whole_or_another_may_have_written_is_compiled_anew_and_replaced(loaded, spoilt):
    loaded()
    spoilt(kept_at(PLAIN_POSE))
    assert not loaded()
    assert loaded()


def test_a_folder_that_others_may_write_is_not_believed(loaded):
    loaded()
    open_folder(kept_at(PLAIN_POSE))
    assert not loaded()
    assert not loaded()


def test_what_belongs_to_another_user_is_not_believed(loaded, monkeypatch):
    loaded()
    other = os.geteuid() + 1
    monkeypatch.setattr(kept.os, "geteuid", lambda: other)
    assert not loaded()


def test_another_program_has_a_file_of_its_own():
    assert kept_at(PLAIN_POSE) != kept_at(PLAIN_POSE + b" ")


def test_where_nothing_can_be_kept_it_is_compiled(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    engine = wasmtime.Engine()
    assert isinstance(compiled(engine, PLAIN_POSE), wasmtime.Module)
