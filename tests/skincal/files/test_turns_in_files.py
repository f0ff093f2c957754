"""Turns of taxels of three axes in files: CSV, JSON and NPZ read back, and the words on what is not known."""

import csv
import io
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.axes.module_axes import AxisFindings, AxisMistake, AxisMistakeKind
from skincal.axes.taxel_frames import FrameState
from skincal.files.export import CSV_COLUMNS, calibration_file, csv_text, json_text
from skincal.files.formats import ExportFormat
from skincal.files.frames import npz_bytes
from skincal.geometry import angles_of_rotation, quaternion_of_rotation, rotation_of_quaternion
from skincal.model.errors import InputError
from skincal.taxels.result import Method
from skincal.words.axis_words import axis_sentences, corrected_values, odds_words, shared_sentence
from tests.skincal.files.files_support import READ_AXES, make_calibration, with_turns

UNKNOWN = {0: FrameState.IN_PLANE_UNKNOWN, 13: FrameState.UNKNOWN}


@pytest.fixture(scope="module")
def turned(part):
    calibration, rotations = with_turns(make_calibration(part), UNKNOWN)
    return calibration, rotations


def matrix_of(quaternion):
    return Rotation.from_quat(np.array(quaternion, dtype=float), scalar_first=True).as_matrix()


def test_csv_has_a_quaternion_with_its_order_in_the_names(turned):
    calibration, rotations = turned
    rows = [row for row in csv.DictReader(io.StringIO(csv_text(calibration))) if row["method"] == "surface"]
    for row in rows:
        channel = int(row["channel"])
        found = [row[f"turn_q{axis}"] for axis in "wxyz"]
        assert row["turn_state"] == UNKNOWN.get(channel, FrameState.KNOWN).value
        if channel in UNKNOWN:
            assert {*found, row["turn_normal_sd_deg"]} == {""}
        else:
            np.testing.assert_allclose(matrix_of(found), rotations[channel], atol=1e-12)


def test_json_and_npz_have_the_turn_with_covariance_and_state(turned):
    calibration, rotations = turned
    document = json.loads(json_text(calibration))
    archive = np.load(io.BytesIO(npz_bytes(calibration, Method.SURFACE)))
    by_channel = {each["channel"]: each["turn"] for each in document["estimates"]["surface"]}
    for row, channel in enumerate(archive["channel"].tolist()):
        turn = by_channel[channel]
        assert turn["state"] == archive["turn_state"][row]
        if channel in UNKNOWN:
            assert turn["quaternion_wxyz"] is turn["covariance_rad2"] is None
            assert np.isnan(archive["turn_covariance"][row]).all()
            continue
        np.testing.assert_allclose(matrix_of(turn["quaternion_wxyz"]), rotations[channel], atol=1e-12)
        np.testing.assert_allclose(matrix_of(archive["quaternion_wxyz"][row]), rotations[channel], atol=1e-12)
        np.testing.assert_array_equal(archive["turn_covariance"][row], turn["covariance_rad2"])
    assert (document["axes"]["quaternion_order"], document["axes"]["unit"]) == ("wxyz", "N")
    # A skin in newtons has no raw threshold.
    assert "response_min_N" in document["contact_settings"]
    assert {"responses_N", "readings_N"} <= document["contacts"][0].keys()
    gains = [each["gain"] for each in document["estimates"]["surface"]]
    rows = [row for row in csv.DictReader(io.StringIO(csv_text(calibration))) if row["method"] == "surface"]
    assert any(gain["pokes"] > 2 for gain in gains)
    for gain, row in zip(gains, rows, strict=True):
        assert gain.keys() == {"pokes", "N_per_N", "sd_N_per_N"}
        written = "" if gain["N_per_N"] is None else repr(gain["N_per_N"])
        assert (row["gain_N_per_N"], row["gain_pokes"]) == (written, str(gain["pokes"]))


def test_a_skin_of_one_axis_has_nothing_of_it(part):
    calibration = make_calibration(part)
    document = json.loads(json_text(calibration))
    assert "axes" not in document
    assert "turn" not in document["estimates"]["surface"][0]
    assert "response_min_raw" in document["contact_settings"]
    assert csv_text(calibration).splitlines()[0] == ",".join(CSV_COLUMNS)
    assert "turn_state" not in np.load(io.BytesIO(npz_bytes(calibration, Method.SURFACE)))
    with pytest.raises(InputError, match="expected axes = 3 in"):
        calibration_file(calibration, ExportFormat.TAXEL_GEOMETRY, Method.SURFACE)


def test_angles_and_quaternions_are_those_of_scipy_also_at_the_gimbal():
    turns = [*Rotation.random(40, rng=3), *(Rotation.from_euler("ZYX", [0.7, pitch, 0.2]) for pitch in (np.pi / 2, -np.pi / 2))]
    for turn in turns:
        matrix = turn.as_matrix()
        np.testing.assert_allclose(Rotation.from_euler("xyz", angles_of_rotation(matrix)).as_matrix(), matrix, atol=1e-12)
        np.testing.assert_allclose(matrix_of(quaternion_of_rotation(matrix)), matrix, atol=1e-12)
        np.testing.assert_allclose(rotation_of_quaternion(turn.as_quat(scalar_first=True)), matrix, atol=1e-12)


def mistake(kind, axes, directions, module=None, turn_deg=float("nan")):
    return AxisMistake(kind, module, axes, turn_deg, 30.0, directions)


@pytest.mark.parametrize(
    ("found", "words"),
    [
        # The scene has y, -x, z with values of z that rise: x = value 2, y = -value 1.
        (mistake(AxisMistakeKind.OPPOSITE, ("x",), ("-x", "y", "z")), 'values = ["-y", "-x", "z"] and polarity = "up"'),
        (mistake(AxisMistakeKind.OPPOSITE, ("z",), ("x", "y", "-z")), 'values = ["-y", "x", "z"] and polarity = "down"'),
        (mistake(AxisMistakeKind.EXCHANGED, ("x", "y"), ("y", "x", "z")), 'values = ["-x", "y", "z"] and polarity = "up"'),
        (mistake(AxisMistakeKind.ORDER, (), ()), 'Write order = "xxyyzz" in [skin]'),
        (mistake(AxisMistakeKind.TURNED, (), ("y", "-x", "z"), 4, 90.0), "add 90 to its angle_deg"),
        (mistake(AxisMistakeKind.OPPOSITE, ("y",), ("x", "-y", "z"), 4), "look whether module 4 is of another kind"),
    ],
)
def test_a_mistake_is_named_with_its_remedy(found, words):
    (sentence,) = axis_sentences(READ_AXES, AxisFindings((), 0.0, (found,)))
    assert words in sentence
    assert "odds more than a million to 1" in sentence


@pytest.mark.parametrize("directions", [("-x", "y", "z"), ("y", "x", "z"), ("z", "-x", "y"), ("-y", "x", "-z")])
def test_corrected_values_read_the_same_numbers_along_the_axes_of_the_module(directions):
    """Another route: a reading of the wrong scene, turned into the module, is that of the right scene."""
    polarity, names = corrected_values(READ_AXES, directions)
    values = np.array([3.0, 5.0, 7.0])
    in_module = np.zeros(3)
    for axis, direction in enumerate(directions):
        reading = READ_AXES.signs[axis] * values[READ_AXES.places[axis]]
        in_module["xyz".index(direction.lstrip("-"))] = -reading if direction.startswith("-") else reading
    found = np.zeros(3)
    for value, name in zip(values, names, strict=True):
        sign = (-1 if polarity == "up" else 1) if name == "z" else (-1 if name.startswith("-") else 1)
        found["xyz".index(name.lstrip("-"))] = sign * value
    np.testing.assert_array_equal(found, in_module)


def test_odds_and_an_open_question_in_words():
    assert odds_words(np.log(120.0)) == odds_words(-np.log(120.0)) == "odds 120 to 1"
    assert shared_sentence(AxisFindings((), 0.0, ())) == ""
