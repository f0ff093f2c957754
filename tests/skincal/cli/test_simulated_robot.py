"""`simulate --physics --out`: a session that the robot's fault ends."""

import numpy as np
import pytest

from skincal.cli import main, simulated_robot
from skincal.part.part import load_scene_surface
from skincal.physics.effects import Effects
from skincal.physics.robots import make_robot


def test_a_robot_that_stops_ends_its_session_with_the_reason(tmp_path, monkeypatch, capsys):
    """Its base is 40 mm farther away than it knows: it feels nothing at three places."""
    pytest.importorskip("mujoco")

    def displaced(scene, seed, effects):
        surface = load_scene_surface(scene)[0]
        robot = make_robot(scene, surface, Effects.named(effects), seed)
        robot.engine.displace_base(np.array([-0.04, 0.0, 0.0]), np.eye(3))
        return robot, surface

    monkeypatch.setattr(simulated_robot, "_make_robot", displaced)
    out = tmp_path / "session"
    assert main(["simulate", "--physics", "mujoco", "--scene", "icub-forearm", "--effects", "none", "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert "skincal: the robot has stopped: 3 targets in a row failed" in said
    assert "measure the tip and the pose of the part again" in said
    assert (out / "truth.json").is_file()


@pytest.mark.parametrize(
    ("scene", "effect", "sentence"),
    [
        ("icub-forearm", "bend", "--effects bend is of a cobot, and icub-right-forearm-v1 has no [tool]"),
        ("cobot-wrist", "sag", "--effects sag does nothing with [tool]"),
    ],
)
def test_an_effect_that_the_robot_does_not_have_is_refused(tmp_path, capsys, scene, effect, sentence):
    out = tmp_path / "session"
    asked = ["simulate", "--physics", "mujoco", "--scene", scene, "--effects", f"noise, {effect}", "--out", str(out)]
    assert main(asked) == 2
    assert sentence in capsys.readouterr().err
    assert not out.exists()
