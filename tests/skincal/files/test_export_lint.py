"""Remarks on a calibration before it is written: what is odd is named with its channels, and what is right is not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from skincal.files.export import lint, usual_format, write_calibration
from skincal.model.scene import load_scene, resource
from skincal.taxels.result import Method
from tests.approved import approved
from tests.skincal.files.files_support import CHANNELS, make_calibration


def changed(calibration, edits):
    """Replace fields of single estimates of the free method: channel to new fields."""
    items = tuple(replace(e, **edits.get(e.channel, {})) for e in calibration.estimates[Method.FREE])
    return replace(calibration, estimates={**calibration.estimates, Method.FREE: items})


def moved(calibration, move):
    """Apply `move` to every position of the free method."""
    return changed(calibration, {e.channel: {"position": move(e.position)} for e in calibration.estimates[Method.FREE]})


def exported(calibration, tmp_path):
    return write_calibration(calibration, "ply", tmp_path / "out.ply", Method.FREE)


def test_true_positions_have_no_fault(part, tmp_path):
    calibration = make_calibration(part)
    assert exported(calibration, tmp_path) == ()
    assert lint(calibration, Method.FREE) == lint(calibration, Method.SURFACE) == ()


def test_noise_of_a_good_calibration_is_no_fault(part, tmp_path):
    rng = np.random.default_rng(5)
    assert exported(moved(make_calibration(part), lambda p: p + rng.normal(scale=0.001, size=3)), tmp_path) == ()


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        ({"position": np.array([np.nan, 0, 0])}, approved("lint.not_finite", channels=4)),
        ({"normal": np.array([0, 0, np.inf])}, approved("lint.not_finite", channels=4)),
        ({"position": np.array([1e-7, 0, -1e-7])}, approved("lint.at_origin", channels=4)),
        ({"normal": np.array([0, 0, 0.75])}, approved("lint.not_unit", channels=4)),
        ({"normal": None}, approved("lint.no_normal", channels=4)),
        ({"normal": np.array([0, 0, -1.0])}, approved("lint.inward", channels=4)),
    ],
)
def test_a_faulty_taxel_is_named(part, tmp_path, edit, said):
    found = exported(changed(make_calibration(part), {4: edit}), tmp_path)
    assert any(sentence.startswith(said) for sentence in found), found


def test_copies_typos_and_a_wrong_unit_are_named(part, tmp_path):
    made = make_calibration(part)
    assert "channels 3, 7." in lint(changed(made, {7: {"position": part.places[3] + 1e-8}}), Method.FREE)[0]
    found = exported(changed(made, {9: {"position": part.places[9] + [0, 0.15, 0]}}), tmp_path)
    assert any(approved("lint.outside_surface") in sentence and "channels 9;" in sentence for sentence in found)
    found = exported(moved(made, lambda p: p * 1000), tmp_path)
    for said in (approved("lint.outside_surface"), approved("lint.too_far_apart")):
        assert any(said in sentence for sentence in found)


def test_without_a_surface_the_plan_is_the_reference(part, tmp_path):
    calibration = make_calibration(part)
    flat = replace(calibration, scene=replace(calibration.scene, surface=None), mesh_sha256=None)
    inside = {9: {"position": part.places[9] + [0, 0.15, 0], "normal": np.array([0, 0, -1.0])}}
    found = exported(changed(flat, inside), tmp_path)
    assert any(approved("lint.outside_plan") in sentence for sentence in found)
    assert any(approved("lint.inward_by_plan", channels=9) in sentence for sentence in found)


def test_a_mirrored_part_is_named_and_a_turned_one_is_not(part):
    """A left part written with the right one's positions; six taxels at least show that."""

    def turned(calibration, matrix, below=CHANNELS):
        return changed(
            calibration,
            {
                e.channel: {"position": matrix @ e.position, "normal": matrix @ e.normal}
                for e in calibration.estimates[Method.FREE]
                if e.channel < below
            },
        )

    mirror, made = np.diag([-1.0, 1.0, 1.0]), make_calibration(part)
    assert lint(turned(made, mirror), Method.FREE) == (approved("lint.mirrored", modules="17, 21, 25"),)
    turn, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))
    assert lint(turned(made, turn * np.linalg.det(turn)), Method.FREE) == ()
    five = turned(make_calibration(part, unseen=tuple(range(5, CHANNELS))), mirror, below=5)
    assert not any("mirrored" in sentence for sentence in lint(five, Method.FREE))


def test_a_module_without_its_centre_is_named(part):
    found = lint(make_calibration(part, unseen=(15,), blind=(39,)), Method.SURFACE)
    assert found == (approved("lint.no_centre", modules="21, 25"),)


def test_a_part_of_another_robot_that_a_cobot_pokes_needs_no_centre_taxel(part):
    made = make_calibration(part, unseen=(15,), blind=(39,))
    tool = load_scene(resource("scenes/cobot-forearm/scene.toml")).tool
    assert lint(replace(made, scene=replace(made.scene, link="plate", tool=tool)), Method.SURFACE) == ()


def test_a_position_on_a_thermal_pad_is_named(part):
    calibration = make_calibration(part)
    first = calibration.estimates[Method.FREE][0]
    extra = replace(first, channel=18, position=np.array([0.0, 0.14, 0.041]))
    with_pad = replace(calibration, estimates={Method.FREE: (*calibration.estimates[Method.FREE], extra)})
    assert approved("lint.pad_placed", channels=18) in lint(with_pad, Method.FREE)


def test_no_position_at_all_is_said(part):
    found = lint(make_calibration(part, unseen=tuple(range(48))), Method.FREE)
    assert found == (approved("lint.nothing_placed"),)


@pytest.mark.parametrize(
    ("link", "robot", "usual"),
    [("r_forearm_dh_frame", None, "icub"), ("patch", None, "csv"), ("plate", object(), "urdf"), ("forearm", object(), "urdf")],
)
def test_the_proposed_format_fits_the_part(link, robot, usual):
    assert usual_format(SimpleNamespace(link=link, robot=robot)).value == usual
