"""kill -9 again and again on one session, while a second program tries to open it all the while."""

from __future__ import annotations

import contextlib
import os
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from skincal.contacts.outcome import Contact
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from tests.skincal.poke_script import outcome_key, same_estimates

ROOT = Path(__file__).resolve().parents[3]
RECORDER = """
import sys, time
from dataclasses import replace
from pathlib import Path
from skincal.journal.writer import create_session
from skincal.model.errors import InputError
from skincal.session.pipeline import Pipeline
from skincal.session.replay import resume
from tests.skincal.journal.kill_support import key_of
from tests.skincal.poke_script import LINKS, as_chunks, some_pokes, write_scene
folder, turn = Path(sys.argv[1]), int(sys.argv[2])
scene = write_scene(folder / "source")
script = some_pokes(scene, 40, seed=turn)
items = as_chunks([replace(sample, host_s=sample.host_s + 1000.0 * turn) for sample in script.samples])
print("begin", flush=True)
while True:
    try:
        if turn:
            pipeline = resume(folder / "s")
        else:
            pipeline = Pipeline(scene, LINKS, None, create_session(folder / "s", scene, LINKS))
        break
    except InputError as error:
        if "is being recorded" not in str(error):
            raise
        time.sleep(0.01)
print("open", flush=True)
told = len(pipeline.session.contacts)
for item in items:
    pipeline.feed(item)
    while told < len(pipeline.session.contacts) and pipeline.session.contacts[told].final:
        print(key_of(pipeline.session.contacts[told]), flush=True)
        told += 1
"""
OPENER = """
import sys, time
from pathlib import Path
from skincal.model.errors import InputError
from skincal.session.replay import resume
print("begin", flush=True)
while True:
    for folder in sys.argv[1:]:
        try:
            resume(Path(folder)).close()
        except InputError:
            continue
    time.sleep(0.01)
"""


def key_of(contact: Contact) -> str:
    """A word that no other contact has."""
    return repr(outcome_key(contact)).encode().hex()


def script_process(code: str, *words: object) -> subprocess.Popen[str]:
    """Start a script that says "begin" when it has imported what it needs."""
    process = subprocess.Popen(
        [sys.executable, "-c", code, *map(str, words)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "begin\n"
    return process


@contextlib.contextmanager
def second_opener(*sessions: Path) -> Iterator[None]:
    """Try to go on with sessions, in another process, until the end; it must live till then."""
    process = script_process(OPENER, *sessions)
    try:
        yield
        assert process.poll() is None
    finally:
        end(process)


def end(process: subprocess.Popen[str]) -> str:
    """Kill a process; return what it had said."""
    process.kill()
    said = process.communicate()[0] or ""
    assert process.returncode != 1, "it was alive until it was killed"
    return said


def killed_in_a_row(folder: Path, kills: int, seed: int) -> int:
    """Record, kill, go on, kill, ..., at random instants; return the accepted pokes, all of which must be kept."""
    rng, told = random.Random(seed), []
    with second_opener(folder / "s"):
        for turn in range(kills):
            process = script_process(RECORDER, folder, turn)
            if turn == 0:
                assert process.stdout is not None
                assert process.stdout.readline() == "open\n"
            time.sleep(rng.uniform(0.0, 0.8))
            lines = end(process).splitlines(keepends=True)
            # A torn line is of a poke that nobody was told of.
            told += [line.rstrip("\n") for line in lines if line.endswith("\n") and line != "open\n"]
    assert_kept(folder / "s", told)
    return len(told)


def assert_kept(session: Path, told: list[str]) -> Pipeline:
    """Every poke that was told is there, in order, and the bytes give the same session to the last bit."""
    loaded, played = load(session), replay(session)
    ours, theirs = ([key_of(contact) for contact in each.session.contacts] for each in (loaded, played))
    assert ours == theirs
    assert same_estimates(loaded.snapshot(), played.snapshot())
    found = iter(ours)
    assert all(key in found for key in told), "a poke that was accepted is lost"
    return loaded
