"""Paths and options that cannot be right end in a sentence."""

import subprocess
import sys

import pytest

from skincal.cli import main


@pytest.mark.parametrize("option", ["--wrench", "--skin", "--joints"])
def test_headless_records_no_simulation_in_place_of_devices(option, tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "app", "--headless", option, "/dev/null", "--new", str(tmp_path / "s")],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert option in done.stderr
    assert "skincal record" in done.stderr
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize(
    "words",
    [
        ["solve", "x" * 300],
        ["solve", "s", "--reference", "x" * 300],
        ["export", "x" * 5000, "--format", "csv", "--out", "a"],
        ["record", "--wrench", "a", "--skin", "b", "--scene", "flat-patch", "--out", "x" * 300],
        ["simulate", "--scene", "y" * 300 + ".toml", "--out", "a"],
        ["import", "csv", "--wrench", "x" * 300, "--skin", "x" * 300, "--scene", "flat-patch", "--out", "a"],
        ["import", "yarp", "--wrench", "x" * 300, "--skin", "x" * 300, "--scene", "flat-patch", "--out", "a"],
    ],
)
def test_a_path_of_300_characters_is_a_sentence(words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert len(said.splitlines()[-1]) <= 320
    assert list(tmp_path.iterdir()) == []
