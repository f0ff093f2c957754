import json
import os
from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.journal.reader import SessionLog
from skincal.model.errors import InputError
from skincal.model.readings import Chunk
from skincal.simulation.device import DeviceSettings
from skincal.simulation.operator import Habits
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.virtual_session import simulate_session
from skincal.taxels.result import Method
from tests.skincal.sim_support import scene_and_surface

QUICK = DeviceSettings(wrench_hz=500.0)


def record(folder, pokes=4, seed=3, name="icub-forearm", habits=None, **options):
    scene, surface = scene_and_surface(name)
    habits = habits or Habits.careful()
    return simulate_session(scene, surface, folder, pokes, seed, RigErrors.noise(), habits=habits, settings=QUICK, **options)


def recorded_bytes(folder):
    return [(item.link, item.host_ns, item.data) for item in SessionLog(folder).items() if isinstance(item, Chunk)]


def test_pokes_become_contacts_near_the_taxels_that_answer(tmp_path):
    begun = []
    pipeline = record(tmp_path / "s", poses=("1", "2"), progress=begun.append)
    assert begun == [1, 2, 3, 4]
    outcomes = [poke.outcome for poke in pipeline.snapshot().pokes]
    assert len(outcomes) == 4
    assert all(isinstance(outcome, Contact) and outcome.final for outcome in outcomes)
    assert len({outcome.pose for outcome in outcomes}) == 2
    truth = json.loads((tmp_path / "s" / "truth.json").read_text())
    assert truth["link"] == "r_forearm_dh_frame"
    places = {taxel["channel"]: np.array(taxel["position_m"]) for taxel in truth["taxels"]}
    assert len(places) == 84
    for outcome in outcomes:
        turn, shift = outcome.link_from_sensor[:3, :3], outcome.link_from_sensor[:3, 3]
        axis = turn @ outcome.force / np.linalg.norm(outcome.force)
        start = turn @ (np.cross(outcome.force, outcome.moment) / (outcome.force @ outcome.force)) + shift
        strongest = places[int(outcome.channels[np.argmax(outcome.responses)])]
        # Aim error, response and noise: the axis passes within a centimetre of the taxel that answers most.
        assert np.linalg.norm(np.cross(strongest - start, axis)) < 0.010
        assert 5.0 < np.linalg.norm(outcome.force) < 13.0
    health = {link.link: link for link in pipeline.live(0).links}
    assert set(health) == {"wrench", "skin", "joints"}
    assert not any(sum(link.losses.values()) for link in health.values())


def test_same_seed_same_recording(tmp_path):
    for folder, seed in (("a", 5), ("b", 5), ("c", 6)):
        record(tmp_path / folder, pokes=1, seed=seed, name="flat-patch")
    one, two, other = (recorded_bytes(tmp_path / folder) for folder in "abc")
    assert one == two
    assert one != other
    assert (tmp_path / "a" / "truth.json").read_bytes() == (tmp_path / "b" / "truth.json").read_bytes()


def test_estimates_approach_the_truth(tmp_path):
    # Two taxels of the flat patch, poked eight times each.
    scene, _ = scene_and_surface("flat-patch")
    module = scene.skin.layout.modules[0]
    channels = [int(c) for c in module.channels[[5, 6]]]
    pipeline = record(tmp_path / "s", pokes=16, name="flat-patch", channels=channels)
    truth = {t["channel"]: np.array(t["position_m"]) for t in json.loads((tmp_path / "s" / "truth.json").read_text())["taxels"]}
    estimates = {e.channel: e for e in pipeline.snapshot().estimates[Method.FREE]}
    for channel in channels:
        assert estimates[channel].position is not None
        assert np.linalg.norm(estimates[channel].position - truth[channel]) < 0.004


def test_accidents_are_rejected(tmp_path):
    # 7 mm or more within the still window of 0.3 s: beyond the limit of 1.5 mm, and beyond what noise excuses.
    habits = replace(Habits.careful(), slide_rate=1.0, slide=(0.012, 0.015), hold_s=(0.4, 0.5))
    pipeline = record(tmp_path / "s", pokes=3, name="flat-patch", habits=habits)
    outcomes = [poke.outcome for poke in pipeline.snapshot().pokes]
    assert len(outcomes) == 3
    assert not any(isinstance(outcome, Contact) for outcome in outcomes)


def test_rates_are_those_of_the_settings(tmp_path):
    record(tmp_path / "s", pokes=1, name="flat-patch")
    counts = {"wrench": 0, "skin": 0}
    for link, _, data in recorded_bytes(tmp_path / "s"):
        counts[link] += data.count(b"\x00")
    assert counts["wrench"] / counts["skin"] == pytest.approx(10.0, rel=0.02)


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
def test_the_truth_is_written_through_no_link(tmp_path):
    """The folder may be a stranger's."""
    letter, folder = tmp_path / "letter", tmp_path / "s"
    letter.write_text("dear", encoding="utf-8")
    folder.mkdir()
    (folder / "truth.json").symlink_to(letter)
    with pytest.raises(InputError, match="is a link"):
        record(folder, 1, name="flat-patch")
    assert letter.read_text(encoding="utf-8") == "dear"
