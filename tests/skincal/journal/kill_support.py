"""kill -9 again and again on one session, while a second program tries to open it all the while."""

from __future__ import annotations

import contextlib
import random
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

from skincal.contacts.outcome import Contact
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from tests.skincal.journal.journal_support import process
from tests.skincal.poke_script import outcome_key, same_estimates

RECORDER = """
import time
from dataclasses import replace
from tests.skincal.journal.kill_support import key_of
turn = int(sys.argv[2])
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
import time
print("begin", flush=True)
while True:
    for session in sys.argv[2:]:
        try:
            resume(Path(session)).close()
        except InputError:
            continue
    time.sleep(0.01)
"""


def key_of(contact: Contact) -> str:
    """A word that no other contact has."""
    return repr(outcome_key(contact)).encode().hex()


def script_process(code: str, *words: object) -> subprocess.Popen[str]:
    """Start a script that says "begin" when it has imported what it needs."""
    started = process(code, *words)
    assert started.stdout is not None
    assert started.stdout.readline() == "begin\n"
    return started


@contextlib.contextmanager
def second_opener(*sessions: Path) -> Iterator[None]:
    """Try to go on with sessions, in another process, until the end; it must live till then."""
    opener = script_process(OPENER, sessions[0].parent / "opener", *sessions)
    try:
        yield
        assert opener.poll() is None
    finally:
        end(opener)


def end(child: subprocess.Popen[str]) -> str:
    """Kill a process; return its output."""
    child.kill()
    said = child.communicate()[0] or ""
    assert child.returncode != 1, "it was alive until it was killed"
    return said


def killed_in_a_row(folder: Path, kills: int, seed: int) -> int:
    """Record, kill, go on, kill, ..., at random instants after the first poke; return the number of accepted pokes."""
    rng, told = random.Random(seed), []
    with second_opener(folder / "s"):
        for turn in range(kills):
            child = script_process(RECORDER, folder, turn)
            if turn == 0:
                assert child.stdout is not None
                assert child.stdout.readline() == "open\n"
                told.append(child.stdout.readline().rstrip("\n"))
            time.sleep(rng.uniform(0.0, 0.8))
            lines = end(child).splitlines(keepends=True)
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
