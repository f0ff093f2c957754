"""`start.py` and `check.py`: what they find missing, what they say, and that they leave a right environment alone."""

from __future__ import annotations

import ast
import importlib.util
import os
import sys
from pathlib import Path

import pytest

from tools import apt, launch, places, python_env, python_version, system_libs, words

CHECKOUT = Path(__file__).resolve().parent.parent
posix_only = pytest.mark.skipif(os.name == "nt", reason="paths of a POSIX environment")
linux_only = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux has a system step")


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkout with an empty lock and no environment."""
    venv = tmp_path / ".venv"
    for name, value in {"CHECKOUT": tmp_path, "VENV": venv, "LOG": venv / "install.log", "SYSTEM": venv / "system"}.items():
        monkeypatch.setattr(places, name, value)
    monkeypatch.setattr(system_libs, "SYSTEM", venv / "system")
    monkeypatch.setattr(python_env, "STAMP", venv / "skincal-installed.txt")
    monkeypatch.setattr(python_env, "UNFINISHED", venv / "skincal-unfinished.txt")
    lock = tmp_path / "requirements.lock"
    lock.write_text("# nothing\n", encoding="utf-8")
    return lock


@pytest.mark.skipif(importlib.util.find_spec("ensurepip") is None, reason="this Python comes without pip")
def test_an_environment_is_made_once_and_again_when_it_is_stale(checkout: Path) -> None:
    assert python_env.ensure(checkout)
    assert places.interpreter().exists()
    assert not python_env.ensure(checkout)

    checkout.write_text("# another lock\n", encoding="utf-8")
    assert python_env.ensure(checkout)
    assert not python_env.ensure(checkout)

    python_env.UNFINISHED.touch()  # as pip leaves it when it is killed while it unpacks
    assert not python_env.is_ready(checkout)
    assert not python_env._venv_is_right()


def test_an_environment_of_another_python_is_not_taken(checkout: Path) -> None:
    places.interpreter().parent.mkdir(parents=True)
    places.interpreter().touch()
    configuration = places.VENV / "pyvenv.cfg"
    this = f"{sys.version_info.major}.{sys.version_info.minor}.9"
    for key, version, right in (("version", this, True), ("version_info", this, True), ("version", "3.9.2", False)):
        configuration.write_text(f"home = /usr/bin\n{key} = {version}\n", encoding="utf-8")
        python_env.STAMP.write_text(python_env._stamp_line(checkout), encoding="utf-8")
        assert python_env.is_ready(checkout) is right


@pytest.mark.usefixtures("checkout")
@pytest.mark.parametrize("word", ["-h", "--help"])
def test_help_is_told_before_anything_is_installed(word: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert launch.start([word]) == 0
    said = capfd.readouterr().out
    assert all(words in said for words in ("start.py --session DIR", "start.py COMMAND --help", "README.md"))
    assert not places.VENV.exists()


@pytest.mark.parametrize(
    ("log", "said", "code"),
    [
        ("WARNING: Retrying ... NewConnectionError(...)\nERROR: No matching distribution found for numpy==2.4.6", "network", 2),
        ("ERROR: Could not install packages due to an OSError: [Errno 28] No space left on device", "disk is full", 2),
        ("ERROR: THESE PACKAGES DO NOT MATCH THE HASHES FROM THE REQUIREMENTS FILE", "not the one that was tested", 2),
        ("ERROR: No matching distribution found for vtk==9.7.2", "no vtk==9.7.2 for this kind of machine", 2),
        ("first\nTraceback: something nobody foresaw", "something nobody foresaw", 1),
    ],
)
def test_a_failed_installation_is_put_in_words(log: str, said: str, code: int) -> None:
    failure = python_env._pip_failure(log)
    assert said in str(failure)
    assert failure.code == code


@pytest.mark.usefixtures("checkout")
def test_an_environment_counts_as_unfinished_only_once_pip_changes_it() -> None:
    places.VENV.mkdir()
    lines = iter(["Collecting numpy==2.4.6\n", "Installing collected packages: numpy\n", "Successfully installed\n"])
    told = python_env._told(lines)
    assert next(told) == "Collecting numpy==2.4.6\n"
    assert not python_env.UNFINISHED.exists()
    assert next(told) == "Installing collected packages: numpy\n"
    assert python_env.UNFINISHED.exists()
    assert list(told) == ["Successfully installed\n"]


@posix_only
def test_of_two_starts_one_waits(tmp_path: Path) -> None:
    with (tmp_path / "lock").open("w", encoding="utf-8") as first, (tmp_path / "lock").open("w", encoding="utf-8") as second:
        assert python_env._held(first.fileno())
        assert not python_env._held(second.fileno())
        first.close()
        assert python_env._held(second.fileno())


@pytest.mark.parametrize("version", [(3, 10, 14), (3, 15, 0)])
def test_a_python_that_is_too_old_or_too_new_is_refused(
    version: tuple[int, int, int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "version_info", version)
    with pytest.raises(SystemExit) as end:
        python_version.require()
    assert end.value.code == 2
    assert f"this is Python {version[0]}.{version[1]}" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["start.py", "check.py", "tools/__init__.py", "tools/python_version.py"])
def test_an_old_python_can_read_its_refusal(name: str) -> None:
    text = (CHECKOUT / name).read_text(encoding="utf-8")
    ast.parse(text, feature_version=(3, 7))
    assert "from __future__ import annotations" not in text  # unknown to 3.6


@linux_only
@pytest.mark.usefixtures("checkout")
def test_a_missing_library_is_named_with_the_line_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[list[str]] = []
    monkeypatch.setattr(system_libs, "loads", lambda name: name == "libc.so.6")
    monkeypatch.setattr(apt, "is_here", lambda: True)
    monkeypatch.setattr(apt, "provide", lambda packages, _: asked.append(packages))
    with pytest.raises(words.StopError) as stop:
        system_libs.provide({"libc.so.6": "libc6", "libxcb-cursor.so.0": "libxcb-cursor0"})
    assert asked == [["libxcb-cursor0"]]
    assert "libxcb-cursor.so.0" in str(stop.value)
    assert "sudo apt-get install --no-install-recommends libxcb-cursor0" in str(stop.value)
    assert stop.value.code == 2


@linux_only
@pytest.mark.usefixtures("checkout")
def test_without_apt_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system_libs, "loads", lambda _: False)
    monkeypatch.setattr(apt, "is_here", lambda: False)
    with pytest.raises(words.StopError, match=r"lacks libEGL\.so\.1"):
        system_libs.provide({"libEGL.so.1": "libegl1"})


@linux_only
@pytest.mark.usefixtures("checkout")
def test_nothing_is_fetched_where_nothing_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system_libs, "loads", lambda _: True)
    monkeypatch.setattr(apt, "provide", lambda *_: pytest.fail("apt was called"))
    assert not system_libs.provide({"libEGL.so.1": "libegl1"})
    assert system_libs.environment() == dict(os.environ)


@linux_only
@pytest.mark.usefixtures("checkout")
def test_an_unpacked_library_is_found_by_the_started_program(monkeypatch: pytest.MonkeyPatch) -> None:
    folder = places.SYSTEM / "usr" / "lib" / "x86_64-linux-gnu"
    folder.mkdir(parents=True)
    (folder / "libxcb-cursor.so.0").touch()
    monkeypatch.setattr(system_libs, "loads", lambda _: False)
    monkeypatch.setenv("LD_LIBRARY_PATH", "/own")
    assert not system_libs.provide({"libxcb-cursor.so.0": "libxcb-cursor0"})
    assert system_libs.environment()["LD_LIBRARY_PATH"].split(":")[-2:] == [str(folder), "/own"]


@linux_only
@pytest.mark.usefixtures("checkout")
def test_unpacked_fonts_are_listed() -> None:
    fonts = places.SYSTEM / "usr" / "share" / "fonts"
    fonts.mkdir(parents=True)
    system_libs._list_fonts()
    assert f"<dir>{fonts}</dir>" in (places.SYSTEM / "fonts.conf").read_text(encoding="utf-8")


def test_the_display_for_tests_is_asked_for_before_anything_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system_libs, "has_display", lambda: False)
    monkeypatch.setattr(system_libs, "_can_provide_xvfb", lambda: False)
    monkeypatch.setattr(system_libs.shutil, "which", lambda *_, **__: None)
    with pytest.raises(words.StopError, match="Xvfb"):
        system_libs.require_test_display()
