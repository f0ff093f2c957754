"""What the window asks before a tip that was found is written."""

from __future__ import annotations

from pathlib import Path

from app.text.message import tip_words


def test_every_line_that_is_written_is_named():
    asked = tip_words({"tip_mm": (1.0, -2.5, 130.0), "rotation": "rpy", "degrees": True}, [Path("a/scene.toml")])
    assert asked.startswith('tip_mm = [1, -2.5, 130] and rotation = "rpy" and degrees = true will be written into')
    assert "a/scene.toml" in asked
    left_out = tip_words({"tip_mm": (1.0, 2.0, 3.0), "rotation": "xyzw", "degrees": None}, [Path("a/scene.toml")])
    assert left_out.startswith('tip_mm = [1, 2, 3] and rotation = "xyzw" will be written')
