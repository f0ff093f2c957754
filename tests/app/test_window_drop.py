"""Files that are dropped onto the window: what can be opened is, and of anything else a sentence says what to do."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from PySide6.QtCore import QMimeData, QPointF, Qt, QUrl
from PySide6.QtGui import QDragEnterEvent, QDropEvent
from PySide6.QtWidgets import QApplication

from app.__main__ import main
from app.session.dropping import request_of
from app.session.opening import MESH_FILE_ENDINGS, OpenRequest
from app.state.running import Running
from skincal.mesh.load import read_mesh
from skincal.model.errors import InputError
from skincal.model.scene import resource
from tests.app.whole_window import OPEN_MS
from tests.approved import approved


def drop(window, *urls: str) -> bool:
    """Drag over a window and let go; return whether it takes that."""
    mime = QMimeData()
    mime.setUrls([QUrl(url) for url in urls]) if urls else mime.setText("words")
    given = (Qt.DropAction.CopyAction, mime, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier)
    enter = QDragEnterEvent(window.rect().center(), *given)
    enter.ignore()
    QApplication.sendEvent(window, enter)
    if enter.isAccepted():
        QApplication.sendEvent(window, QDropEvent(QPointF(window.rect().center()), *given))
    return enter.isAccepted()


def of(path: Path) -> str:
    return QUrl.fromLocalFile(str(path)).toString()


def test_what_is_dropped_is_opened_in_place_of_what_is_open_or_refused(bench, tmp_path, recorded):
    assert not drop(bench.window), "only files are taken"
    other = shutil.copytree(recorded, tmp_path / "other session")
    bench.open(OpenRequest(session=recorded))
    with bench.qtbot.waitSignal(bench.controller.session_opened, timeout=OPEN_MS):
        assert drop(bench.window, of(other))
    assert bench.controller.folder == other
    drawing = tmp_path / "elbow.step"
    drawing.write_bytes(b"")
    for refused in (of(drawing), "https://example.org/session"):
        bench.window.messages.dismiss()
        assert drop(bench.window, refused)
        assert bench.window.messages.isVisible()
    assert bench.controller.folder == other

    # A scene, with a simulated rig.
    scene = resource("scenes/flat-patch/scene.toml")
    with bench.qtbot.waitSignal(bench.controller.session_opened, timeout=OPEN_MS):
        assert drop(bench.window, of(scene))
    assert bench.window.session_view.workspace.part.scene.path == scene
    assert bench.controller.running is Running.STREAMING
    assert bench.controller.simulated


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        *((name, approved("dropping.nothing")) for name in ("places.json", "without")),
        ("photographs/me.png", approved("dropping.no_session")),
    ],
)
def test_each_kind_has_its_sentence(tmp_path, name, sentence):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_text("")
    dropped = tmp_path / Path(name).parts[0]
    with pytest.raises(InputError) as refusal:
        request_of([dropped])
    assert str(refusal.value) == f"{dropped}: {sentence}"


@pytest.mark.parametrize(
    "name",
    [
        "wrench.CSV",
        "data.log",
        "log/data.log",
        "log/arm/data.log",
        "log/robot/arm/data.log",
        "tables/b.csv",
        "wrench.txt",
        "tables/b.txt",
    ],
)
def test_a_recording_is_to_be_imported(tmp_path, name):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_text("")
    dropped = tmp_path / Path(name).parts[0]
    assert request_of([path, path]) == (path, path)
    assert request_of([dropped]) == (dropped,)


def test_one_thing_at_a_time_that_is_there(tmp_path, recorded):
    for paths in ((), (recorded, recorded)):
        with pytest.raises(InputError) as refusal:
            request_of(paths)
        assert str(refusal.value) == approved("dropping.several", count=len(paths))
    with pytest.raises(InputError, match="cannot be read"):
        request_of([recorded / ("n" * 300)])
    with pytest.raises(InputError) as refusal:
        request_of([tmp_path / "gone.toml"])
    assert str(refusal.value).endswith(approved("dropping.gone"))


@pytest.mark.parametrize("kind", MESH_FILE_ENDINGS)
def test_the_meshes_are_those_that_are_read(kind):
    with pytest.raises(InputError, match="export the mesh again"):
        read_mesh(Path(f"part{kind}"), b"?")


FOREARM = resource("scenes/icub-forearm/forearm.obj")


def test_a_mesh_that_is_dropped_begins_a_new_part_and_another_one_replaces_it(bench, tmp_path):
    for name in ("elbow.OBJ", "wrist.obj"):
        mesh = shutil.copy(FOREARM, tmp_path / name)
        assert drop(bench.window, of(mesh))
        page = bench.window.builder
        bench.until(lambda page=page: page.is_settled, OPEN_MS)
        assert page.preview.surface is not None
        assert page.history.now.mesh == mesh
    page.undo()
    assert page.history.now.mesh.name == "elbow.OBJ"


@pytest.mark.parametrize("data", [b"", b"?"])
def test_a_mesh_that_is_not_one_leaves_no_page(bench, tmp_path, data):
    mesh = tmp_path / "elbow.stl"
    mesh.write_bytes(data)
    assert drop(bench.window, of(mesh))
    assert bench.window.messages.isVisible()
    assert bench.window.builder is None
    assert not (bench.documents / "scenes").exists()


def test_a_mesh_is_named_on_the_command_line_like_a_scene(capsys, monkeypatch):
    asked = []
    monkeypatch.setattr("app.run.run_window", lambda request: asked.append(request) or 0)
    monkeypatch.setattr("app.__main__.objection", lambda: "")
    monkeypatch.setattr("app.__main__.no_display", lambda: "")
    assert [main(words) for words in ([str(FOREARM)], ["--scene", str(FOREARM)])] == [0, 0]
    assert asked == [OpenRequest(part=FOREARM)] * 2
    assert main([str(FOREARM), "--wrench", "a", "--skin", "b"]) == 2
    assert approved("dropping.mesh_with_devices", mesh=FOREARM) in capsys.readouterr().err.replace(" and --skin", "")
    assert main([str(FOREARM), "--headless"]) == 2
    assert approved("dropping.mesh_without_window", mesh=FOREARM) in capsys.readouterr().err
