"""The folder in which the program is started is not the program's: modules that lie there are never run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest

from app.session.opening import server_command
from skincal.model.scene import resource
from skincal.robot.target_server import LOOPBACK_ADDRESS, TargetServer, open_port
from tools import checkout, install

CHECKOUT = Path(__file__).resolve().parent.parent
SAMPLE = resource("sessions/sample")
LIMIT_S = 60
CONSOLE = f"import sys\nsys.path.append({str(CHECKOUT)!r})\nfrom app.__main__ import main\nsys.exit(main())\n"
"""What pip writes for `skincal`."""
installed = pytest.mark.skipif(not install.is_ready(checkout.RUN_LOCK), reason="needs what start.py installs")


def run_there(folder: Path, *command: str | Path) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert not (folder.parent / "ran").exists(), (folder.parent / "ran").read_text()
    return done


def test_the_poison_works(poisoned):
    done = subprocess.run([sys.executable, "-m", "app"], cwd=poisoned, check=False)
    assert done.returncode == 99
    assert (poisoned.parent / "ran").read_text() == f"{poisoned / 'app/__init__.py'}\n"


@installed
def test_who_asks_for_a_safe_path_gets_one(poisoned, monkeypatch):
    monkeypatch.setenv("PYTHONSAFEPATH", "1")
    outside = Path(sys.base_prefix) / ("python.exe" if os.name == "nt" else "bin/python3")
    done = run_there(poisoned, outside, CHECKOUT / "start.py", "--version")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("way", ["start.py", "skincal", "console script", "-P -m app", "-P -m skincal.cli"])
def test_a_command_runs_nothing_of_the_working_folder(poisoned, way):
    if way in ("start.py", "skincal") and not install.is_ready(checkout.RUN_LOCK):
        pytest.skip("needs what start.py installs")
    script = poisoned.parent / "bin" / "skincal"
    script.parent.mkdir()
    script.write_text(CONSOLE, encoding="utf-8")
    command = {
        "start.py": (sys.executable, CHECKOUT / "start.py"),
        "skincal": (checkout.interpreter().with_name("skincal.cmd" if os.name == "nt" else "skincal"),),
        "console script": (sys.executable, script),
    }.get(way, (sys.executable, *way.split()))
    done = run_there(poisoned, *command, "solve", str(SAMPLE), "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["accepted"] == 84


def test_without_a_safe_path_only_a_package_of_the_program_s_name_is_run(poisoned):
    """Python itself imports the package that `-m` names, and what it needs for that, before the program can say anything."""
    for package in ("app", "skincal"):
        (poisoned / package / "__init__.py").unlink()
        (poisoned / package).rmdir()
    (poisoned / "pickle.py").unlink()
    done = run_there(poisoned, sys.executable, "-m", "app", "solve", str(SAMPLE))
    assert done.returncode == 0, done.stderr


def test_processes_of_a_study_run_nothing_of_the_working_folder(poisoned):
    script = poisoned.parent / "study.py"
    script.write_text(
        f"import sys\nsys.path.append({str(CHECKOUT)!r})\n"
        "from skincal.cli import main\n"
        "def cube(x):\n    return x ** 3\n"
        "if __name__ == '__main__':\n"
        "    main(['--version'])\n"
        "    from concurrent.futures import ProcessPoolExecutor\n"
        "    from multiprocessing import get_context\n"
        "    with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as pool:\n"
        "        print(*pool.map(cube, [2, 3]))\n",
        encoding="utf-8",
    )
    done = run_there(poisoned, sys.executable, script)
    assert done.stdout.endswith("8 27\n"), done.stderr


def test_the_simulated_devices_run_nothing_of_the_working_folder(poisoned):
    with closing(TargetServer(open_port(LOOPBACK_ADDRESS, 0))) as asking:
        command = (*server_command(resource("scenes/flat-patch/scene.toml")), "--targets", f"{asking.port}")
        links = links_served(poisoned, command)
    assert {link["name"] for link in links} >= {"wrench", "skin"}
    assert not (poisoned.parent / "ran").exists()


def links_served(folder: Path, command: tuple[str, ...]) -> list[dict[str, str]]:
    with subprocess.Popen(command, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        links = json.loads(process.stdout.readline())["links"]
        process.stdin.close()
    return links


@pytest.mark.skipif(not hasattr(os, "fork"), reason="signals as on Linux and macOS")
@installed
def test_the_window_and_what_it_starts_run_nothing_of_the_working_folder(poisoned, tmp_path):
    if not os.environ.get("DISPLAY"):
        pytest.skip("there is no display here")
    own = tmp_path / "own"
    own.mkdir()
    env = os.environ | {"HOME": str(own), "XDG_CONFIG_HOME": str(own), "TMPDIR": str(own)}
    command = (sys.executable, CHECKOUT / "start.py", "--scene", "flat-patch")
    window = subprocess.Popen(command, cwd=poisoned, env=env, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + LIMIT_S
    while not list(own.rglob("segment-*.mcap")) and window.poll() is None and time.monotonic() < end:
        time.sleep(0.1)
    recorded = list(own.rglob("segment-*.mcap"))
    window.terminate()
    _, said = window.communicate(timeout=LIMIT_S)
    assert recorded, said
    assert window.returncode == 0, said
    assert not (tmp_path / "ran").exists()
