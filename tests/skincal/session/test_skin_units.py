"""A skin in newtons: its default threshold, also in replays; a scene's own number; the proposal from a first touch."""

import numpy as np
import pytest

from skincal.contacts.outcome import Contact, Reason
from skincal.model.actions import SetThresholds, Undo, UseSkinUnit, action_from_json, action_to_json
from skincal.model.readings import Chunk
from skincal.model.scene import ContactSettings, load_scene
from skincal.part.touch_watch import FRAMES_AT_REST_FIRST, TouchWatch, default_threshold
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay, resume
from tests.build import feed, recording
from tests.skincal.poke_script import LINKS, as_chunks, outcome_key, same_estimates, skt_line, some_pokes, write_scene

NEWTONS_PER_RAW = 0.015
POKES = 8


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path / "source")


def with_threshold(scene, response_min):
    scene.path.write_text(scene.path.read_text() + f"[contacts]\nresponse_min = {response_min}\n")
    return load_scene(scene.path)


def skin_in(scene, unit, factor):
    """Bytes of the pokes of a board whose header names a unit, with its values times `factor`."""
    items = []
    for item in as_chunks(some_pokes(scene, POKES).samples):
        if isinstance(item, Chunk) and item.link == "skin":
            kind, seq, t_us, *values = item.data.partition(b"*")[0].decode().split(",")
            scaled = ",".join(f"{float(value) * factor:.5f}" for value in values)
            line = skt_line(f"{kind},{seq},{t_us},{scaled}")
            header = skt_line(f"H,skt1,n=24,unit={unit},kind=taxel") if unit and seq == "0" else b""
            item = Chunk(item.link, item.host_ns, header + line)
        items.append(item)
    return items


def outcomes(pipeline):
    return [record.outcome for record in pipeline.snapshot().pokes]


@pytest.mark.parametrize(("unit", "factor", "threshold"), [("N", NEWTONS_PER_RAW, 0.15), ("mN", NEWTONS_PER_RAW * 1e3, 150.0)])
def test_pokes_of_a_skin_in_newtons_count_as_those_of_the_same_skin_in_raw_values(scene, unit, factor, threshold):
    raw = feed(Pipeline(scene, LINKS, None), skin_in(scene, "", 1.0))
    newtons = feed(Pipeline(scene, LINKS, None), skin_in(scene, unit, factor))
    assert newtons.session.decisions.thresholds == ContactSettings(response_min=threshold)
    assert raw.session.decisions.thresholds == ContactSettings()
    assert len(outcomes(raw)) == POKES
    for first, second in zip(outcomes(raw), outcomes(newtons), strict=True):
        assert isinstance(second, Contact)
        assert second.channels.tolist() == first.channels.tolist()
        assert second.responses == pytest.approx(first.responses * factor, rel=0.02)


def test_without_a_unit_no_poke_of_such_a_skin_counts(scene):
    silent = feed(Pipeline(scene, LINKS, None), skin_in(scene, "", NEWTONS_PER_RAW))
    assert {outcome.reason for outcome in outcomes(silent)} == {Reason.NO_TAXEL}


@pytest.mark.parametrize("response_min", [10.0, 0.3])
def test_a_number_in_the_scene_stays_to_the_last_bit(scene, response_min):
    stated = with_threshold(scene, response_min)
    pipeline = feed(Pipeline(stated, LINKS, None), skin_in(scene, "N", NEWTONS_PER_RAW))
    assert pipeline.session.decisions.thresholds == ContactSettings(response_min=response_min)
    assert isinstance(outcomes(pipeline)[0], Contact) == (response_min < 1.0)


def test_an_operator_who_chose_a_threshold_first_keeps_it(scene):
    pipeline = Pipeline(scene, LINKS, None)
    pipeline.act(SetThresholds(("response_min",), (0.5,)), 0)
    feed(pipeline, skin_in(scene, "N", NEWTONS_PER_RAW))
    assert pipeline.session.decisions.thresholds == ContactSettings(response_min=0.5)


def test_played_loaded_and_resumed_sessions_are_the_live_one(scene, tmp_path):
    items = skin_in(scene, "N", NEWTONS_PER_RAW)
    live = recording(scene, tmp_path / "s", items, [(0.5, SetThresholds(("still_s",), (0.2,))), (0.7, SetThresholds())])
    live.close()
    assert live.session.decisions.thresholds == ContactSettings(response_min=0.15), "the scene's thresholds, in this unit"
    assert all(isinstance(outcome, Contact) for outcome in outcomes(live))
    for other in (replay(tmp_path / "s"), load(tmp_path / "s"), resume(tmp_path / "s")):
        assert (other.findings, list(map(outcome_key, outcomes(other)))) == ((), list(map(outcome_key, outcomes(live))))
        assert same_estimates(other.snapshot(), live.snapshot())
        assert other.session.decisions == live.session.decisions or (
            other.session.decisions.thresholds == live.session.decisions.thresholds
        )
        other.close()


def test_a_session_from_before_is_played_with_the_threshold_of_its_time(scene, tmp_path, monkeypatch):
    items = skin_in(scene, "N", NEWTONS_PER_RAW)
    with monkeypatch.context() as earlier:
        earlier.setattr(Pipeline, "_use_skin_unit", lambda *_: None)
        recording(scene, tmp_path / "s", items).close()
    old = replay(tmp_path / "s")
    assert old.session.decisions.thresholds == ContactSettings()
    assert {outcome.reason for outcome in outcomes(old)} == {Reason.NO_TAXEL}


def test_undo_passes_over_it_and_a_journal_keeps_it(scene):
    action = UseSkinUnit("N", 0.15)
    assert action_from_json(action_to_json(action)) == action
    pipeline = feed(Pipeline(scene, LINKS, None), skin_in(scene, "N", NEWTONS_PER_RAW)[:200])
    pipeline.act(SetThresholds(("force_min",), (5.0,)), 10**9)
    pipeline.act(Undo(), 10**9)
    assert pipeline.session.decisions.thresholds == ContactSettings(response_min=0.15)


# ------------------------------------------------------------------ a first touch


def touched(unit, noise, answer, step=0.0, seed=2):
    """A watch of 16 channels whose channel 3 was pressed."""
    rng = np.random.default_rng(seed)
    watch = TouchWatch(16, unit)
    for frame in range(100):
        values = 1.0 + noise * rng.standard_normal(16)
        values[3] += answer * min(max(frame - FRAMES_AT_REST_FIRST - 20, 0) / 30.0, 1.0)
        watch.feed(np.round(values / step) * step if step else values)
    return watch


def test_a_touch_of_a_skin_in_newtons_is_seen_and_its_threshold_proposed():
    watch = touched("N", 0.02, 1.2)
    assert watch.touch().channels.tolist() == [3]
    found = watch.threshold()
    assert found.noise == pytest.approx(0.02, rel=0.6)  # the noisiest of 16, from 25 frames
    assert found.proposed == float(f"{7.5 * found.noise:.2g}")
    assert found.fits(default_threshold("N"))
    assert found.sentence(0.15, "N").endswith("the threshold of 0.15 N fits.")
    assert "no taxel would answer: use" in found.sentence(10.0, "N")


def test_a_skin_without_noise_gets_one_and_a_half_of_its_steps():
    found = touched("N", 0.0, 0.8, step=0.1).threshold()
    assert (found.noise, found.proposed, found.is_clear) == (0.0, 0.15, True)


def test_raw_values_that_are_small_get_a_threshold_and_usual_ones_keep_theirs():
    assert touched("", 0.5, 90.0).threshold().fits(default_threshold(""))
    small = touched("", 0.1, 9.0).threshold()
    assert not small.fits(10.0)
    assert small.is_clear
    assert "no taxel would answer" in small.sentence(10.0, "")


def test_noise_as_large_as_the_touch_is_said_and_nothing_is_proposed():
    found = touched("N", 0.1, 1.0).threshold()
    assert not found.is_clear
    assert "not clear of the noise" in found.sentence(0.15, "N")


def test_no_touch_no_threshold():
    watch = TouchWatch(4, "N")
    for _ in range(60):
        watch.feed(np.zeros(4))
    assert watch.threshold() is None
