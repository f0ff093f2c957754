"""`start.py` and `check.py`: what they find missing, what they say, and that they leave a right environment alone."""

from __future__ import annotations

import ast
import importlib.util
import os
import re
import sys
import time
import tomllib
import venv
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tests.approved import approved
from tools import checkout as places
from tools import install, launch
from tools.lock import select_packages

CHECKOUT = Path(__file__).resolve().parent.parent
posix_only = pytest.mark.skipif(os.name == "nt", reason="paths of a POSIX environment")
linux_only = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux has a system step")


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkout with an empty lock and no environment."""
    venv = tmp_path / ".venv"
    monkeypatch.setattr(places, "CHECKOUT", tmp_path)
    monkeypatch.setattr(places, "VENV", venv)
    monkeypatch.setattr(install, "SYSTEM", venv / "system")
    for name, file in {
        "STAMP_FILE": "skincal-installed.txt",
        "UNFINISHED_FILE": "skincal-unfinished.txt",
        "LOG": "install.log",
    }.items():
        monkeypatch.setattr(install, name, venv / file)
    lock = tmp_path / "requirements.lock"
    lock.write_text("# nothing\n", encoding="utf-8")
    return lock


def pretend(pip: str) -> None:
    """Make an environment whose Python only does, in the words of a shell, what stands for the installation of packages."""
    site = places.VENV / "lib" / f"python{install.VERSION}" / "site-packages"
    for folder in (site, places.interpreter().parent):
        folder.mkdir(parents=True, exist_ok=True)
    (places.VENV / "pyvenv.cfg").write_text(f"home = /usr/bin\nversion = {install.VERSION}.9\n", encoding="utf-8")
    script = f'#!/bin/sh\ncase "$*" in *--require-hashes*) ;; *) exit 0 ;; esac\n{pip}\n'
    places.interpreter().write_text(script, encoding="utf-8")
    places.interpreter().chmod(0o755)


@pytest.mark.skipif(importlib.util.find_spec("ensurepip") is None, reason="this Python comes without pip")
def test_an_environment_is_made_once_and_again_when_it_is_stale(checkout: Path, poisoned: Path) -> None:
    assert install.ensure(checkout)
    assert places.interpreter().exists()
    assert not install.ensure(checkout)

    checkout.write_text("# another lock\n", encoding="utf-8")
    assert install.ensure(checkout)
    assert not install.ensure(checkout)

    # Pip and the compiler of modules are run in the folder where the person stands: nothing of it is.
    assert not (poisoned.parent / "ran").exists()


@posix_only
def test_what_was_interrupted_while_it_was_unpacked_begins_from_an_empty_folder(
    checkout: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    emptied: list[bool] = []

    def create(builder: venv.EnvBuilder, _: Path) -> None:
        emptied.append(builder.clear)
        pretend("exit 0")

    monkeypatch.setattr(venv.EnvBuilder, "create", create)
    pretend("exit 0")
    assert install.ensure(checkout)
    assert not emptied, "it was right"
    install.UNFINISHED_FILE.touch()  # as pip leaves it when it is killed while it unpacks
    assert not install.is_ready(checkout)
    assert install.ensure(checkout)
    assert emptied == [True]
    assert install.is_ready(checkout)


@posix_only
def test_an_environment_of_another_python_is_not_taken(checkout: Path) -> None:
    pretend("exit 0")
    assert install.ensure(checkout)
    configuration = places.VENV / "pyvenv.cfg"
    this = f"{sys.version_info.major}.{sys.version_info.minor}.9"
    for key, version, right in (("version", this, True), ("version_info", this, True), ("version", "3.9.2", False)):
        configuration.write_text(f"home = /usr/bin\n{key} = {version}\n", encoding="utf-8")
        assert install.is_ready(checkout) is right


@pytest.mark.usefixtures("checkout")
@pytest.mark.parametrize("word", ["-h", "--help"])
def test_help_is_shown_before_anything_is_installed(word: str, capfd: pytest.CaptureFixture[str]) -> None:
    import start

    assert launch.start(start.__doc__, [word]) == 0
    said = capfd.readouterr().out
    assert all(
        words in said
        for words in (
            "start.py --session DIR",
            "start.py COMMAND --help",
            "apply, compare, report, devices, watch",
            "README.md",
        )
    )
    assert not places.VENV.exists()


def test_what_stops_a_command_is_said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def stopped(_: Sequence[str]) -> int:
        raise places.StopError("The disk is full.")

    monkeypatch.setattr(sys, "argv", ["start.py"])
    assert launch.run(stopped) == 2
    assert capsys.readouterr().err == "The disk is full.\n"


@posix_only
@pytest.mark.parametrize(
    ("work", "code", "unfinished"),
    [
        ("", 1, False),
        ("touch $(echo lib/*/site-packages)/numpy", 1, True),
        ("touch $(echo lib/*/site-packages)/numpy", 0, False),
    ],
)
def test_an_environment_counts_as_unfinished_only_once_pip_changes_it(
    checkout: Path, work: str, code: int, unfinished: bool
) -> None:
    """As where the network is gone, and what is installed still runs; or where pip was killed while it unpacked."""
    there = f"test -e {install.UNFINISHED_FILE}"  # should it be killed now
    pretend(f"{there} || exit 9\ncd {places.VENV}\n{work}\nexit {code}")
    if code:
        with pytest.raises(places.StopError) as stop:
            install.ensure(checkout)
        for words in (str(install.LOG), "connect this machine to the network", "the disk is full", "glibc 2.34 or later"):
            assert words in str(stop.value)
    else:
        assert install.ensure(checkout)
    assert install.UNFINISHED_FILE.exists() is unfinished
    assert install.is_ready(checkout) is (code == 0)


@posix_only
@pytest.mark.parametrize(
    ("uv_works", "loader", "runs"),
    [
        (True, "/bin/sh", ["pip uv", "uv"]),
        (False, "/bin/sh", ["pip uv", "uv", "pip"]),
        (None, "/bin/sh", ["pip uv", "pip"]),
        (True, "/no/such/loader", ["pip uv", "pip"]),
    ],
)
def test_uv_installs_the_packages_and_pip_where_uv_cannot_be_had(
    checkout: Path, uv_works: bool | None, loader: str, runs: list[str]
) -> None:
    """As where uv fails, cannot be fetched or cannot run."""
    noted = checkout.with_name("runs")
    fetch = "exit 1" if uv_works is None else "exit 0"
    pretend_uv(checkout, loader, f"echo uv >> {noted}\nexit {0 if uv_works else 2}")
    pretend(f'case "$*" in *requirements-uv.lock) echo pip uv >> {noted}; {fetch} ;; esac\necho pip >> {noted}')
    assert install.ensure(checkout)
    assert noted.read_text(encoding="utf-8").splitlines() == runs
    assert install.is_ready(checkout)


def pretend_uv(lock: Path, loader: str, does: str) -> None:
    """Make a program that stands for uv, and the lock that pip fetches it by."""
    lock.with_name("requirements-uv.lock").write_text("uv==1\n", encoding="utf-8")
    uv = places.interpreter().with_name("uv")
    uv.parent.mkdir(parents=True)
    uv.write_text(f"#!{loader}\n{does}\n", encoding="utf-8")
    uv.chmod(0o755)


@posix_only
@pytest.mark.parametrize(
    ("of_pip", "value", "of_uv", "expected"),
    [
        ("PIP_INDEX_URL", "https://lab/simple", "UV_DEFAULT_INDEX", "https://lab/simple"),
        ("PIP_EXTRA_INDEX_URL", "https://a/simple https://b/simple", "UV_INDEX", "https://a/simple https://b/simple"),
        ("PIP_FIND_LINKS", " /wheels  https://lab/wheels/", "UV_FIND_LINKS", "/wheels,https://lab/wheels/"),
        ("PIP_TRUSTED_HOST", "lab:8080 mirror", "UV_INSECURE_HOST", "lab:8080 mirror"),
        ("PIP_CERT", "/etc/lab certificates.pem", "SSL_CERT_FILE", "/etc/lab certificates.pem"),
        ("PIP_PROXY", "http://lab:3128", "ALL_PROXY", "http://lab:3128"),
        ("PIP_PROXY", "", "ALL_PROXY", "http://other"),
    ],
)
def test_uv_takes_packages_from_where_pip_does(
    checkout: Path, monkeypatch: pytest.MonkeyPatch, of_pip: str, value: str, of_uv: str, expected: str
) -> None:
    noted = checkout.with_name("runs")
    pretend_uv(checkout, "/bin/sh", f'printf "%s\\n%s" "${of_uv}" "${of_pip}" > {noted}')
    pretend("exit 0")
    monkeypatch.setenv(of_uv, "http://other")
    monkeypatch.setenv(of_pip, value)
    assert install.ensure(checkout)
    assert noted.read_text(encoding="utf-8").splitlines() == ([expected, value] if value else [expected])


@posix_only
@pytest.mark.parametrize(("value", "offline"), [("1", True), ("Yes", True), ("0", False), ("", False)])
def test_uv_asks_no_index_where_pip_may_not(checkout: Path, monkeypatch: pytest.MonkeyPatch, value: str, offline: bool) -> None:
    noted = checkout.with_name("runs")
    pretend_uv(checkout, "/bin/sh", f'echo "$@" > {noted}')
    pretend("exit 0")
    monkeypatch.setenv("PIP_NO_INDEX", value)
    assert install.ensure(checkout)
    assert ("--no-index" in noted.read_text(encoding="utf-8").split()) is offline


@posix_only
def test_of_two_starts_one_waits(checkout: Path, capfd: pytest.CaptureFixture[str]) -> None:
    runs, done = checkout.with_name("runs"), checkout.with_name("done")
    pretend(f"echo run >> {runs}\nwhile ! test -e {done}; do sleep 0.05; done")
    said, end = "", time.monotonic() + 10.0
    with ThreadPoolExecutor(2) as pool:
        starts = [pool.submit(install.ensure, checkout) for _ in range(2)]
        while "waiting for it" not in said and time.monotonic() < end:
            time.sleep(0.05)
            said += capfd.readouterr().err
        waited = sum(start.running() for start in starts)
        done.touch()
    assert "waiting for it" in said
    assert waited == 2
    assert [start.result() for start in starts] == [True, True]
    assert runs.read_text(encoding="utf-8") == "run\n", "the other found it installed"


@pytest.mark.parametrize("version", [(3, 10, 14), (3, 15, 0)])
def test_a_python_that_is_too_old_or_too_new_is_refused(
    version: tuple[int, int, int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "version_info", version)
    with pytest.raises(SystemExit) as end:
        places.require_python()
    assert end.value.code == 2
    assert approved("install.this_is", version=f"{version[0]}.{version[1]}") in capsys.readouterr().err


@pytest.mark.parametrize("name", ["start.py", "check.py", "tools/__init__.py", "tools/checkout.py"])
def test_an_old_python_can_read_its_refusal(name: str) -> None:
    text = (CHECKOUT / name).read_text(encoding="utf-8")
    ast.parse(text, feature_version=(3, 7))
    assert "from __future__ import annotations" not in text  # unknown to 3.6


@linux_only
@pytest.mark.usefixtures("checkout")
def test_a_missing_library_is_named_with_the_line_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[list[str]] = []
    monkeypatch.setattr(install, "loads", lambda name: name == "libc.so.6")
    monkeypatch.setattr(install, "has_apt", lambda: True)
    monkeypatch.setattr(install, "apt_provide", asked.append)
    with pytest.raises(places.StopError) as stop:
        install.provide({"libc.so.6": "libc6", "libxcb-cursor.so.0": "libxcb-cursor0"})
    assert asked == [["libxcb-cursor0"]]
    assert "libxcb-cursor.so.0" in str(stop.value)
    assert approved("install.system_step", packages="libxcb-cursor0") in str(stop.value)


@linux_only
@pytest.mark.usefixtures("checkout")
def test_without_apt_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(install, "loads", lambda _: False)
    monkeypatch.setattr(install, "has_apt", lambda: False)
    with pytest.raises(places.StopError, match=r"lacks libEGL\.so\.1"):
        install.provide({"libEGL.so.1": "libegl1"})


@linux_only
@pytest.mark.usefixtures("checkout")
def test_nothing_is_fetched_where_nothing_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(install, "loads", lambda _: True)
    monkeypatch.setattr(install, "apt_provide", lambda *_: pytest.fail("apt was called"))
    assert not install.provide({"libEGL.so.1": "libegl1"})
    assert install.environment() == dict(os.environ)


@linux_only
@pytest.mark.usefixtures("checkout")
def test_an_unpacked_library_is_found_by_the_started_program(monkeypatch: pytest.MonkeyPatch) -> None:
    folder = install.SYSTEM / "usr" / "lib" / "x86_64-linux-gnu"
    folder.mkdir(parents=True)
    (folder / "libxcb-cursor.so.0").touch()
    monkeypatch.setattr(install, "loads", lambda _: False)
    monkeypatch.setenv("LD_LIBRARY_PATH", "/own")
    assert not install.provide({"libxcb-cursor.so.0": "libxcb-cursor0"})
    assert install.environment()["LD_LIBRARY_PATH"].split(":")[-2:] == [str(folder), "/own"]


@linux_only
@pytest.mark.usefixtures("checkout")
def test_unpacked_fonts_are_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    fonts, libraries = install.SYSTEM / "usr" / "share" / "fonts", install.SYSTEM / "usr" / "lib"

    def unpack(_: Sequence[str]) -> None:
        for folder in (fonts, libraries):
            folder.mkdir(parents=True)
        (libraries / "libEGL.so.1").touch()

    monkeypatch.setattr(install, "loads", lambda _: False)
    monkeypatch.setattr(install, "has_apt", lambda: True)
    monkeypatch.setattr(install, "apt_provide", unpack)
    assert install.provide({"libEGL.so.1": "libegl1"})
    assert f"<dir>{fonts}</dir>" in (install.SYSTEM / "fonts.conf").read_text(encoding="utf-8")


def test_the_display_for_tests_is_asked_for_before_anything_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(install, "has_display", lambda: False)
    monkeypatch.setattr(install, "has_apt", lambda: False)
    monkeypatch.setattr(install.shutil, "which", lambda *_, **__: None)
    with pytest.raises(places.StopError, match="Xvfb"):
        install.require_test_display()


@pytest.mark.parametrize("option", install.EXTRA_PACKAGES)
def test_an_option_installs_the_packages_of_its_extra(option: str) -> None:
    project = tomllib.loads((places.CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extra = project["optional-dependencies"][option.removeprefix("--")]
    assert {Requirement(text).name.replace(".", "-") for text in extra} == set(install.EXTRA_PACKAGES[option])
    selected = select_packages(places.TEST_LOCK.read_text(encoding="utf-8"), install.EXTRA_PACKAGES[option])
    assert all(re.search(rf"^{name}==", selected, re.MULTILINE) for name in install.EXTRA_PACKAGES[option])


def test_the_packages_of_ros_2_are_selected_with_those_they_need() -> None:
    lock = places.TEST_LOCK.read_text(encoding="utf-8")
    selected = select_packages(lock, install.EXTRA_PACKAGES["--ros2"])
    names = {line.partition("==")[0] for line in selected.splitlines() if line[:1].isalnum()}
    assert {"cyclonedds", "rich-click", "rich", "rosbags", "apsw", "lz4", "ruamel-yaml"} <= names
    assert not names & {"mujoco", "pytest", "ruff", "pyside6-essentials"}
    assert select_packages(lock, ()) == ""
