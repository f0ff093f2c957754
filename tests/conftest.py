"""What all tests share: repeatable random data, and a folder of modules that must not be run.

Every run tries the same examples, so a red test is red again for anyone who repeats it. To search for new ones:
`.venv/bin/python -m pytest --hypothesis-profile=search`.
"""

from __future__ import annotations

import gc
import os
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

# No deadline: a shared machine pauses a process for longer than any test takes.
settings.register_profile(
    "repeatable",
    max_examples=60,
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("search", settings.get_profile("repeatable"), derandomize=False, max_examples=2000, print_blob=True)
settings.load_profile("repeatable")

# The graph of a ROS robot on this network is none of the tests' business.
os.environ["CYCLONEDDS_URI"] = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1" multicast="true"/></Interfaces></General>'
    "</Domain></CycloneDDS>"
)
# Nor are other tests on this machine.
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)

POISON = "open({mark!r}, 'a').write(__file__ + '\\n')\nraise SystemExit(99)\n"
NAMES = ("typer.py", "numpy.py", "pickle.py", "pip.py", "app/__init__.py", "skincal/__init__.py")


def pytest_collection_finish() -> None:
    """Look for cyclic garbage less often, and never at what the tests themselves are made of."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Give random numbers that are the same in every run of this test, in whatever order tests run and wherever it stands."""
    return np.random.default_rng(zlib.crc32(request.node.name.encode()))


@pytest.fixture
def poisoned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder of modules that must not be run; what was run all the same stands in the file `ran` beside it."""
    folder = tmp_path / "poisoned"
    for name in NAMES:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(POISON.format(mark=str(tmp_path / "ran")), encoding="utf-8")
    monkeypatch.chdir(folder)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    return folder


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give a report without pictures: they take most of its time, and the test is about its words."""
    monkeypatch.setattr("skincal.reporting.drawings.render", lambda *_: [b"a picture"])
