"""The field for the tool's poses in the dialog for a new session: only scenes with a sensor on the tool have it."""

import pytest

from app.dialogs.new_session import NewSessionDialog
from app.session.opening import Addresses, OpenRequest
from skincal.model.errors import InputError
from skincal.model.readings import Stream
from skincal.model.scene import resource

SCENE = """name = "plate"
link = "base"
[skin]
channels = 9
[tool]
sensor = "tool"
rotation = "xyzw"
unit = "m"
"""


def shown_rows(dialog):
    return {stream for stream, row in dialog.rows.items() if row.box.isVisibleTo(dialog)}


def dialog_of(qtbot, scene, folder):
    dialog = NewSessionDialog(OpenRequest(scene=scene, folder=folder / "new"))
    qtbot.addWidget(dialog)
    qtbot.waitUntil(lambda: dialog._scene is not None)
    return dialog


def test_a_scene_with_a_tool_asks_for_its_poses_in_place_of_joints_and_tip(qtbot, tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    dialog = dialog_of(qtbot, tmp_path / "scene.toml", tmp_path)
    assert shown_rows(dialog) == {Stream.WRENCH, Stream.SKIN, Stream.TOOL}
    for stream in (Stream.WRENCH, Stream.SKIN, Stream.JOINTS):
        dialog.rows[stream].set_address(f"file:{stream.value}", agreed=False)
    with pytest.raises(InputError, match="the link of the tool's poses"):
        dialog.addresses()
    dialog.rows[Stream.TOOL].set_address("file:poses", agreed=False)
    assert dialog.addresses() == Addresses("file:wrench", "file:skin", tool="file:poses")
    dialog.reject()


def test_a_rig_without_a_sensor_asks_for_tool_and_skin_and_names_what_is_missing(qtbot, tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE.replace('sensor = "tool"', 'sensor = "none"\ntip_mm = [0, 0, 99]'))
    dialog = dialog_of(qtbot, tmp_path / "scene.toml", tmp_path)
    assert shown_rows(dialog) == {Stream.SKIN, Stream.TOOL}
    dialog.rows[Stream.SKIN].set_address("file:skin", agreed=False)
    assert not dialog.swap.isVisibleTo(dialog), "there is no sensor to exchange the skin with"
    dialog.swap_addresses()
    assert dialog.rows[Stream.SKIN].address == "file:skin"
    with pytest.raises(InputError, match="no force/torque sensor; expected the link of the tool's poses"):
        dialog.addresses()
    dialog.rows[Stream.TOOL].set_address("file:poses", agreed=False)
    assert dialog.addresses() == Addresses(skin="file:skin", tool="file:poses")
    dialog.rows[Stream.SKIN].set_address("", agreed=False)
    with pytest.raises(InputError, match="No address for the skin"):
        dialog.addresses()
    dialog.reject()


def test_other_scenes_have_no_field_for_a_tool(qtbot, tmp_path):
    dialog = dialog_of(qtbot, resource("scenes/flat-patch/scene.toml"), tmp_path)
    assert shown_rows(dialog) == {Stream.WRENCH, Stream.SKIN, Stream.JOINTS, Stream.TIP}
    dialog.reject()
