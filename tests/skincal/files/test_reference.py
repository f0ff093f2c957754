"""Places are read from every file that has some, and two sets of them are compared."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.files.export import write_calibration
from skincal.files.reference import TaxelPositions, compare_sets, load_reference, read_places
from skincal.model.errors import InputError
from skincal.taxels.result import Method
from tests.approved import approved_pattern
from tests.skincal.files.files_support import make_calibration


@pytest.fixture(scope="module")
def calibration(part):
    """The surface method predicts the smallest error, and lies 1 mm outside the others."""
    exact, raised = make_calibration(part, unseen=(5,)), make_calibration(part, unseen=(5,), shift=0.001)
    surface = tuple(
        each if each.rms is None else replace(each, rms=each.rms / 2, sd=each.sd / 2)
        for each in raised.estimates_by(Method.SURFACE)
    )
    return replace(exact, estimates={**exact.estimates, Method.SURFACE: surface})


@pytest.mark.parametrize("format_", ["json", "csv", "icub"])
def test_a_calibration_is_read_as_places(part, calibration, tmp_path, format_):
    path = tmp_path / f"c.{'txt' if format_ == 'icub' else format_}"
    write_calibration(calibration, format_, path, Method.SURFACE)
    found = read_places(path)
    assert sorted(found.places) == [channel for channel in calibration.channels.tolist() if channel != 5]
    expected = part.places + 0.001 * part.normals
    assert max(np.abs(place - expected[channel]).max() for channel, place in found.places.items()) < 1e-6
    assert found.link == ("r_forearm_dh_frame" if format_ == "json" else "")
    assert found.modules == ({} if format_ == "icub" else {c: calibration.module_id(c) for c in calibration.channels.tolist()})
    if format_ != "icub":
        assert found.method is Method.SURFACE
        assert read_places(path, Method.FREE).places[0].tolist() == part.places[0].tolist()
    # Any of them is a reference as well.
    assert load_reference(path, "r_forearm_dh_frame", [0, 1, 2]).places.keys() == found.places.keys()


def test_a_method_that_a_file_lacks_is_said_and_nonsense_is_refused(calibration, tmp_path):
    one = replace(calibration, estimates={Method.FREE: calibration.estimates_by(Method.FREE)})
    write_calibration(one, "json", tmp_path / "c.json", Method.FREE)
    with pytest.raises(InputError, match=approved_pattern("places.no_method", method="modules", known="free")):
        read_places(tmp_path / "c.json", Method.MODULES)
    for name, text in (
        ("a.json", "[]"), ("b.json", '{"estimates": {}}'), ("c.json", '{"estimates": {"psychic": [1]}}'), ("d.json", "{"),
        ("e.json", '{"estimates": "free"}'), ("a.csv", "x,y\n1,2\n"), ("b.csv", ""), ("c.csv", "\0"),
        ("d.csv", "channel,module,method,x_m,y_m,z_m,sd_mm\n0,,free,nan,0,0,1\n"),
    ):  # fmt: skip
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match=approved_pattern("export.no_reference")):
            read_places(tmp_path / name)
    with pytest.raises(InputError, match=approved_pattern("layout_file.no_such_file")):
        read_places(tmp_path / "none.json")


def test_a_known_motion_between_two_sets_is_found_again_module_by_module(calibration, tmp_path):
    write_calibration(calibration, "json", tmp_path / "c.json", Method.FREE)
    first = read_places(tmp_path / "c.json", Method.FREE)
    turn = Rotation.from_rotvec(np.radians([0.0, 0.0, 3.0]))
    moved = {channel: turn.apply(place) + np.array([0.0, 0.002, 0.0]) for channel, place in first.places.items() if channel > 1}
    found = compare_sets(first, TaxelPositions("moved", "", moved))
    assert found.channel.tolist() == sorted(moved)
    assert np.degrees(found.motion.turn) == pytest.approx(3.0, abs=1e-9)
    assert found.motion.largest < 1e-12
    assert {module: each.known for module, each in found.modules.items()} == {17: 9, 21: 10, 25: 12}
    assert max(each.shape for each in found.modules.values()) < 1e-12
    # The other way round it is the same motion back.
    back = compare_sets(TaxelPositions("moved", "", moved), first)
    assert (back.motion.turn, back.mean) == (pytest.approx(found.motion.turn), pytest.approx(found.mean))


def test_sets_of_other_frames_are_refused_and_sets_without_a_common_taxel_say_nothing():
    here, there = (TaxelPositions(name, name, {0: np.zeros(3)}) for name in ("one", "two"))
    with pytest.raises(InputError, match=approved_pattern("places.frames", first="one", second="two")):
        compare_sets(here, there)
    found = compare_sets(here, TaxelPositions("other", "one", {1: np.zeros(3)}))
    assert (len(found.channel), found.worst_channel, found.motion, found.modules) == (0, None, None, {})
    assert np.isnan([found.mean, found.rms, found.worst]).all()


def test_a_truth_is_read_as_before(tmp_path):
    path = tmp_path / "truth.json"
    path.write_text(json.dumps({"link": "plate", "taxels": [{"channel": 3, "position_m": [0, 0, 1]}]}))
    found = read_places(path)
    assert (found.link, found.name, found.method) == ("plate", "truth.json", None)
    assert found.places[3].tolist() == [0.0, 0.0, 1.0]
