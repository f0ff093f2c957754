"""Optical trackers in the dialog for a new session: searched for a part that a tool pokes, and only once."""

from app.dialogs.new_session import NewSessionDialog
from app.session.opening import OpenRequest
from skincal.model.readings import Stream
from skincal.model.scene import resource

TRACKER = ("qtm://192.0.2.7", "Qualisys QTM: lab")
WAIT_MS = 60_000


def test_trackers_are_listed_for_the_tool_once_a_scene_has_one(qtbot, tmp_path, monkeypatch):
    searches = list[int]()

    def search():
        searches.append(1)
        return [TRACKER]

    monkeypatch.setattr("app.dialogs.new_session.list_trackers", search)
    monkeypatch.setattr("app.dialogs.new_session.list_ports", lambda: [("/dev/ttyUSB7", "USB")])
    dialog = NewSessionDialog(OpenRequest(scene=resource("scenes/flat-patch/scene.toml"), folder=tmp_path / "new"))
    qtbot.addWidget(dialog)
    qtbot.waitUntil(lambda: dialog.has_scene, timeout=WAIT_MS)
    assert searches == [], "a broadcast that a sensor below the part has no use for"
    box = {stream: row.box for stream, row in dialog.rows.items()}
    for name in ("cobot-tip", "cobot-wrist"):
        dialog.scene.setEditText(str(resource(f"scenes/{name}/scene.toml")))
        qtbot.waitUntil(lambda: box[Stream.TOOL].itemData(0) == TRACKER[0], timeout=WAIT_MS)
    assert searches == [1]
    assert all(box[Stream.SKIN].itemData(row) != TRACKER[0] for row in range(box[Stream.SKIN].count()))
    dialog.reject()
