"""The wheel and the source archive hold the whole program: it runs from them, without the checkout."""

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Folder with the wheel and the source archive."""
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-d", str(folder)], cwd=CHECKOUT, check=True, capture_output=True
    )
    return folder


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory):
    """The unpacked wheel, which has no other files than an installation."""
    (wheel,) = built.glob("skincal-*-py3-none-any.whl")
    folder = tmp_path_factory.mktemp("installed")
    zipfile.ZipFile(wheel).extractall(folder)
    return folder


def run(installed, folder, *words, code="import sys; from app.__main__ import main; sys.exit(main())"):
    """Run a command of the unpacked wheel in an empty folder."""
    environment = {**os.environ, "PYTHONPATH": str(installed), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-c", code, *words]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def test_the_program_runs_from_the_wheel(installed, tmp_path):
    from_where = "import app, skincal.cli; from skincal.model.scene import resource; print(app.__path__[0], resource('scenes'))"
    found = run(installed, tmp_path, code=from_where).stdout.split()
    assert len(found) == 2
    assert all(path.startswith(str(installed)) for path in found)
    assert "record" in run(installed, tmp_path, "--help").stdout
    made = run(installed, tmp_path, "simulate", "--scene", "flat-patch", "--pokes", "3", "--careful", "--out", "s")
    assert made.returncode == 0, made.stderr
    report = run(installed, tmp_path, "report", str(CHECKOUT / "resources/sessions/sample"), "--out", "report.html")
    assert report.returncode == 0, report.stderr
    assert "<h2" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_the_wheel_has_scenes_and_examples_but_not_the_sample_session(installed):
    """The session is two thirds of the size, and no command opens it by itself."""
    assert {path.name for path in (installed / "skincal/resources").iterdir()} == {"examples", "scenes"}


def test_nothing_is_left_out(built, installed):
    tracked = subprocess.run(
        ["git", "ls-files", "-z", "app", "skincal"], cwd=CHECKOUT, capture_output=True, text=True, check=False
    )
    if tracked.returncode:
        pytest.skip("no git here: which files belong to the program is not known")
    files = {name for name in tracked.stdout.split("\0") if name and (CHECKOUT / name).is_file()}
    packed = {path.relative_to(installed).as_posix() for path in installed.rglob("*") if path.is_file()}
    assert files - packed == set()
    (archive,) = built.glob("skincal-*.tar.gz")
    with tarfile.open(archive) as source:
        assert files - {name.partition("/")[2] for name in source.getnames()} == set()
