"""Turns of the taxels of a session that is solved from arrays, from the scene's file to the answer."""

import numpy as np
import pytest

import skincal
from skincal.axes.module_axes import AxisMistakeKind
from skincal.axes.taxel_frames import FrameState
from skincal.geometry import rotation_by
from skincal.model.errors import InputError
from tests.skincal.axes.axis_support import random_rotation, turn_between

PADS_MM = [(x, y) for y in (-4, 0, 4) for x in (-4, 0, 4)]
PLAN = f"""[kinds.pad]
pads_mm = {[list(pad) for pad in PADS_MM]}
outline_mm = [[-6, -6], [6, -6], [6, 6], [-6, 6]]
centre_pad = 4
[[modules]]
id = 3
kind = "pad"
first_channel = 0
"""


def make_scene(folder, axes="axes = 3\nunit = 'N'\n"):
    (folder / "m.toml").write_text(PLAN)
    path = folder / "scene.toml"
    path.write_text(f"name = 'tip'\nlink = 'tip'\n[skin]\nchannels = 9\nmodules = 'm.toml'\n{axes}[contacts]\ntaxels_max = 9\n")
    return skincal.Scene.load(path)


def poke_arrays(change=None, seed=1):
    """Six pokes on each taxel of a module that lies anywhere: wrenches, values of frames, and the module's axes."""
    rng = np.random.default_rng(seed)
    plan = random_rotation(rng)
    axes = plan @ rotation_by(np.radians(2.0) * rng.normal(size=3))
    at = np.array([0.02, -0.03, 0.05])
    wrenches, frames = [], []
    for taxel, pad in enumerate(PADS_MM * 6):
        tilt, azimuth = np.radians(rng.uniform(4, 20)), rng.uniform(0, 2 * np.pi)
        towards = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt)])
        force = rng.uniform(5, 8) * plan @ towards
        place = at + plan @ np.array([*pad, 0.0]) * 1e-3
        wrenches.append(np.concatenate([force, np.cross(place, force)]) + 1e-4 * rng.normal(size=6))
        vectors = np.zeros((9, 3))
        vectors[taxel % 9] = 0.4 * (axes.T @ force) * [0.6, 0.6, 1.0] + 0.005 * rng.normal(size=3)
        if change is not None:
            vectors = vectors @ change.T
        # The device's z rises under a push.
        frames.append((vectors * [1, 1, -1]).ravel())
    return np.array(wrenches), np.array(frames), axes


def test_turns_of_arrays_are_the_true_ones(tmp_path):
    wrenches, frames, axes = poke_arrays()
    turns, found = skincal.solve(make_scene(tmp_path), wrenches, frames).turns()
    assert len(turns.taxels) == 9
    for turn in turns.taxels.values():
        assert np.degrees(np.linalg.norm(turn_between(turn.fit.rotation, axes))) < 3.0
        assert turn.fit.is_in_plane_known
    (module,) = found.modules
    assert (module.id, module.is_shared) == (3, True)
    assert np.degrees(np.linalg.norm(turn_between(module.turn.fit.rotation, axes))) < 1.0
    assert found.mistakes == ()


def test_exchanged_axes_are_named_against_the_estimated_module(tmp_path):
    wrenches, frames, _ = poke_arrays(EXCHANGED)
    _, found = skincal.solve(make_scene(tmp_path), wrenches, frames).turns()
    (mistake,) = found.mistakes
    assert (mistake.kind, mistake.axes) == (AxisMistakeKind.EXCHANGED, ("x", "y"))


EXCHANGED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def test_mistakes_of_the_axes_are_in_the_verdict_the_skin_and_the_report(tmp_path):
    wrenches, frames, _ = poke_arrays(EXCHANGED)
    session = skincal.solve(make_scene(tmp_path), wrenches, frames)
    assert "but the axes of the readings do not fit the scene" in session.verdict().sentence
    # Positions do not depend on x and y.
    assert not session.results.verdict(session.results.choose_method(None)).is_value_order_wrong
    (sentence,) = session.results.skin
    assert "x and y are exchanged (odds " in sentence
    assert 'Write values = ["y", "x", "z"]' in sentence
    session.report(tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "Turns of the taxels" in page
    assert "x and y are exchanged" in page
    assert "mirrored axes: no rotation" in page


def test_a_right_scene_has_no_doubt(tmp_path):
    wrenches, frames, _ = poke_arrays()
    session = skincal.solve(make_scene(tmp_path), wrenches, frames)
    assert session.results.skin == ()
    assert "axes" not in session.verdict().sentence


def test_values_of_another_order_are_named_and_give_no_frame(tmp_path):
    wrenches, frames, _ = poke_arrays()
    by_axis = frames.reshape(-1, 9, 3).transpose(0, 2, 1).reshape(len(frames), 27)
    session = skincal.solve(make_scene(tmp_path), wrenches, by_axis)
    _, found = session.turns()
    assert [mistake.kind for mistake in found.mistakes] == [AxisMistakeKind.ORDER]
    frames_ = session.results.session.axis_results().frames(session.results.choose_method(None))
    assert {frame.state for frame in frames_.values()} == {FrameState.WRONG_ORDER}
    assert not any(frame.is_known for frame in frames_.values())
    assert np.isnan(session.taxels().axes).all(), "they would be those of other taxels"
    assert session.verdict().doubted
    assert "the values of a frame have another order than the scene" in session.verdict().sentence
    assert 'Write order = "xxyyzz"' in session.results.skin[-1]


def test_a_skin_of_one_axis_or_without_pokes_has_no_turns(tmp_path):
    wrenches, frames, _ = poke_arrays()
    with pytest.raises(InputError, match="set axes = 3"):
        skincal.solve(make_scene(tmp_path, ""), wrenches, frames[:, 2::3]).turns()
    with pytest.raises(InputError, match="no accepted poke"):
        skincal.solve(make_scene(tmp_path), wrenches, 0.0 * frames).turns()


def test_the_table_of_taxels_has_the_axes_and_their_errors(tmp_path):
    wrenches, frames, axes = poke_arrays()
    table = skincal.solve(make_scene(tmp_path), wrenches, frames).taxels()
    assert table.axes.shape == (9, 3, 3)
    assert np.abs(table.axes - axes).max() < 0.05
    assert (np.degrees(table.axes_error) < 2.0).all()
    assert table.places().axes.keys() == table.places().places.keys()
    assert "turn, deg" in table.html()
    plain = skincal.solve(make_scene(tmp_path, ""), wrenches, frames[:, 2::3]).taxels()
    assert plain.axes is plain.axes_error is None
    assert "turn" not in plain.html()
    assert plain._columns().keys() < table._columns().keys()


def test_a_dead_z_is_named_and_its_taxel_has_no_frame(tmp_path):
    """No poke counts on the taxel, but its x and y answer."""
    wrenches, frames, _ = poke_arrays()
    frames[:, 3 * 4 + 2] = 0.0
    frames[4::9, 3 * 4] = 0.4
    session = skincal.solve(make_scene(tmp_path), wrenches, frames)
    (sentence,) = session.results.skin
    assert "z of taxel 4 answers none of 6 pokes that its x and y answer" in sentence
    found = session.results.session.axis_results().frames(session.results.choose_method(None))
    assert [channel for channel, frame in found.items() if frame.state is FrameState.DEAD_AXIS] == [4]
    assert found[4].rotation is None
