"""Every page and dialog of the window, one after the other, for tests of what all of them must keep."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from pathlib import Path

from PySide6.QtWidgets import QApplication, QDialog, QFileDialog, QWidget

import app.dialogs
from app.builder.fixed_point_dialog import FixedPointDialog
from app.dialogs.dialog import Dialog
from app.dialogs.task_dialog import TaskDialog
from app.session.opening import OpenRequest
from skincal.model.scene import resource
from skincal.part.tool_draft import ToolDraft
from tests.app.whole_window import OPEN_MS

DIALOG_COMMANDS = (
    "keys", "messages", "pedals", "history", "thresholds", "landmark", "verdict", "export", "apply", "import", "addresses",
    "new",
)  # fmt: skip
BASES = {Dialog, TaskDialog}


def dialog_classes() -> set[type[Dialog]]:
    """Every dialog of the program, also one that somebody adds tomorrow."""
    for module in pkgutil.iter_modules(app.dialogs.__path__, "app.dialogs."):
        importlib.import_module(module.name)

    def below(kind):
        return {kind}.union(*(below(each) for each in kind.__subclasses__()))

    return below(Dialog) - BASES


def open_dialogs() -> list[QDialog]:
    return [each for each in QApplication.topLevelWidgets() if isinstance(each, QDialog) and each.isVisible()]


def builder_steps(bench) -> Iterator[tuple[str, QWidget]]:
    """Every step of the page for parts, of the page that is open."""
    page = bench.window.builder
    bench.until(lambda: page.is_settled and page.view.list_layers() != (), OPEN_MS)
    for step in page.steps:
        page.show_step(step)
        bench.until(lambda: page.is_settled, OPEN_MS)
        bench.qtbot.wait(30)
        yield f"New part, {step.name}", bench.window
    page.show_step(page.steps[0])


def tabs(bench) -> Iterator[tuple[str, QWidget]]:
    """Every tab of the open session."""
    workspace = bench.window.session_view.workspace
    for title in workspace.panels:
        workspace.show_tab(title)
        bench.qtbot.wait(50)
        yield f"tab {title}", bench.window


def dialogs(bench, monkeypatch) -> Iterator[tuple[str, QWidget]]:
    """Every dialog of the open session, by its command."""
    for name in ("getOpenFileName", "getSaveFileName", "getExistingDirectory"):
        monkeypatch.setattr(QFileDialog, name, lambda *_, **__: ("", ""))
    # What the guide and the check of addresses ask the first time is no page.
    bench.window._remember(link.address for link in bench.controller.links)
    found = set()
    for name in DIALOG_COMMANDS:
        action = bench.window.commands.actions[name]
        for _ in range(2):
            # The key for a landmark asks for a click first, and for typed numbers the second time.
            if not open_dialogs():
                action.trigger()
                bench.qtbot.wait(60)
        for dialog in open_dialogs():
            found.add(type(dialog))
            yield f"dialog {type(dialog).__name__}", dialog
            dialog.reject()
        bench.until(lambda: not open_dialogs(), 5000)
    # Its command needs a part that a tool pokes.
    test = FixedPointDialog(ToolDraft(), parent=bench.window)
    test.open()
    bench.qtbot.wait(60)
    found.add(type(test))
    yield "dialog FixedPointDialog", test
    test.reject()
    bench.until(lambda: not open_dialogs(), 5000)
    missing = {each.__name__ for each in dialog_classes() - found}
    assert not missing, f"no command of this test opens {missing}"


def every_page(bench, recorded: Path, monkeypatch) -> Iterator[tuple[str, QWidget]]:
    """The start page, every step of two parts, every tab, and every dialog; each is on the screen as it comes."""
    window = bench.window
    window._show_opening()
    yield "start", window
    for scene in ("whole-body", "flat-patch"):
        window.change_part(resource(f"scenes/{scene}/scene.toml"))
        for name, page in builder_steps(bench):
            yield f"{name} of {scene}", page
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    bench.until(lambda: window.may is not None and window.may.verdict, 30_000)
    yield from tabs(bench)
    yield from dialogs(bench, monkeypatch)
