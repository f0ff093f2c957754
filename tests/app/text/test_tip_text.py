"""What the window asks before a tip that was found is written."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import pytest

from app.text.message import tip_words
from app.window import Window
from skincal.part.part_draft import PartDraft, open_draft, save_draft
from skincal.part.tool_draft import Rig


def test_every_line_that_is_written_is_named():
    asked = tip_words({"tip_mm": (1.0, -2.5, 130.0), "rotation": "rpy", "degrees": True}, [Path("a/scene.toml")])
    assert asked.startswith('tip_mm = [1, -2.5, 130] and rotation = "rpy" and degrees = true will be written into')
    assert "a/scene.toml" in asked
    left_out = tip_words({"tip_mm": (1.0, 2.0, 3.0), "rotation": "xyzw", "degrees": None}, [Path("a/scene.toml")])
    assert left_out.startswith('tip_mm = [1, 2, 3] and rotation = "xyzw" will be written')


@pytest.mark.parametrize("refused", ["part", "copy"])
def test_a_tip_that_only_one_of_two_files_takes_is_said_and_the_session_is_opened_with_its_own(tmp_path, refused):
    files = [tmp_path / name / "scene.toml" for name in ("copy", "part")]
    for path in files:
        save_draft(PartDraft(name="arm", link="base", channels=9, rig=Rig.ON_TOOL), path)
    (tmp_path / refused / "scene.toml").write_text("[tool")
    window = Mock(controller=Mock(folder=tmp_path, simulated=False, links=()))
    Window._use_tip(window, {"tip_mm": (1.0, 2.0, 3.0)}, files, paused=True)
    (said,) = window.tell_failure.call_args.args
    assert said.startswith(str(tmp_path / refused / "scene.toml"))
    if refused == "part":
        assert open_draft(files[0]).tool.tip_mm == (1.0, 2.0, 3.0)
        assert f"The tip is written into {files[0]}. The pokes of this session are found again with it." in said
    assert window._open.called == (refused == "part")
    assert window.controller.resume.called == (refused == "copy")
