"""A session with taxels of three axes: replay, loading and a break give the same readings, to the last bit."""

import numpy as np
import pytest

from skincal.cli import main
from skincal.contacts.outcome import Contact
from skincal.journal.writer import create_session
from skincal.model.scene import load_scene
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay, resume
from tests.skincal.contacts.three_axis_support import VectorScript
from tests.skincal.journal.journal_support import assert_same, contacts_of
from tests.skincal.poke_script import LINKS, SPOTS, as_chunks, write_scene

READINGS = {0: {3: (9.0, -4.0, -80.0)}, 1: {2: (-6.0, 3.0, -70.0), 1: (1.0, 1.0, -50.0)}, 2: {7: (2.0, 12.0, -60.0)}}
FAR = 20


@pytest.fixture
def scene(tmp_path):
    path = write_scene(tmp_path / "source").path
    path.write_text(path.read_text() + 'axes = 3\norder = "xxyyzz"\nvalues = ["y", "x", "z"]\n')
    return load_scene(path)


def pokes(scene, count, beside=()):
    script = VectorScript(scene, rng=np.random.default_rng(4), force_noise=0.02, moment_noise=0.002, skin_noise=0.8).quiet()
    for k in range(count):
        readings = READINGS[k % 3] | dict.fromkeys(beside, (0.0, 0.0, -60.0))
        script.press(np.array([0.4, -0.3 * k, -8.0]), SPOTS[k % 3], readings, hold_s=0.4).quiet(0.6)
    return script


def feed(pipeline, script):
    for item in as_chunks(script.samples):
        pipeline.feed(item)
    return pipeline


def test_loading_replay_and_a_break_give_the_same_readings(scene, tmp_path):
    folder = tmp_path / "s"
    live = feed(Pipeline(scene, LINKS, None, create_session(folder, scene, LINKS)), pokes(scene, 3))
    live.close()
    contacts = live.session.contacts
    assert [contact.channels.tolist() for contact in contacts] == [[3], [1, 2], [7]]
    for contact, expected in zip(contacts, READINGS.values(), strict=True):
        for channel, vector in zip(contact.channels.tolist(), contact.vectors, strict=True):
            assert vector == pytest.approx(np.array(expected[channel]), abs=1.0)
    assert_same(live, load(folder), replay(folder))
    again = feed(resume(folder), pokes(scene, 2))
    again.close()
    assert len(contacts_of(again)) == 5
    assert_same(again, load(folder), replay(folder))


def test_a_poke_that_counts_later_has_its_readings(scene, tmp_path):
    """A far channel is found to be always on after a break: the earlier pokes are judged again from the journal."""
    folder = tmp_path / "s"
    first = feed(Pipeline(scene, LINKS, None, create_session(folder, scene, LINKS)), pokes(scene, 2, [FAR]))
    first.close()
    assert not first.session.contacts
    live = feed(resume(folder), pokes(scene, 12, [FAR]))
    live.close()
    found = live.session.outcome(1)
    assert isinstance(found, Contact)
    assert found.channels.tolist() == [3]
    assert found.vectors == pytest.approx(np.array([READINGS[0][3]]), abs=1.0)
    assert_same(live, load(folder), replay(folder))


@pytest.mark.parametrize("seed", [2, 3])
def test_three_pokes_on_a_pad_do_not_name_a_turned_module(seed, tmp_path, capsys):
    # Each poke presses six taxels or more: their readings share its errors, and odds of 30,000 to 1 were said.
    out = str(tmp_path / "s")
    assert main(["simulate", "--scene", "three-axis-pad", "--pokes", "6", "--seed", str(seed), "--out", out]) == 0
    assert "do not fit the pokes" not in capsys.readouterr().out
