"""kill -9 many times, with a second opener all the while: no accepted poke is lost. `python3 -m pytest tests/long`."""

import random
import re
import signal
import time

import pytest

from skincal.session.replay import resume
from tests.skincal.journal.kill_support import assert_kept, killed_in_a_row, second_opener
from tests.skincal.record_support import recorder, write_devices

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no kill -9")
AT_ONCE, ROUNDS = 6, 5
LONGEST_S = 8.0
"""s until a recording is killed: seven pokes."""


def killed_recordings(folder, rng):
    """Kill recordings at random instants; return for each its folder and the pokes that it said were accepted."""
    options = write_devices(folder, 12, seed=rng.randrange(1000))
    sessions = [folder / f"s{k}" for k in range(AT_ONCE)]
    processes = [recorder(options, session) for session in sessions]
    for process in processes:
        assert process.stderr.readline()  # a link is open: the session is made
    begun_s, told = time.monotonic(), {}
    with second_opener(*sessions):
        moments = sorted((rng.uniform(0, LONGEST_S), k) for k in range(AT_ONCE))
        for at_s, k in moments:
            time.sleep(max(0.0, begun_s + at_s - time.monotonic()))
            process, session = processes[k], sessions[k]
            process.kill()
            said = process.communicate()[1]
            assert process.returncode == -signal.SIGKILL, said
            told[session] = [int(poke) for poke in re.findall(r"^poke (\d+): accepted.*\n", said, re.MULTILINE)]
    return told


@pytest.mark.timeout(600)
def test_thirty_recordings_killed_at_random_instants_lose_no_accepted_poke(tmp_path):
    rng, accepted = random.Random(30), 0
    for turn in range(ROUNDS):
        for session, told in killed_recordings(tmp_path / str(turn), rng).items():
            kept = assert_kept(session, [])
            assert {contact.poke for contact in kept.session.contacts} >= set(told)
            resume(session).close()
            accepted += len(told)
    assert accepted > ROUNDS * AT_ONCE


@pytest.mark.timeout(600)
def test_twenty_kills_in_a_row_lose_no_accepted_poke(tmp_path):
    assert killed_in_a_row(tmp_path, 20, seed=20) > 20
