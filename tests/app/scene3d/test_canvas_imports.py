"""The first picture of a session waits for no module of a draft."""

from __future__ import annotations

import sys

import numpy as np

from app.scene3d import canvas
from app.scene3d.draft_state import DraftStatic
from app.scene3d.scene_state import StaticScene
from skincal.part.part import Part
from tests.app.scene3d_support import box, laid, layout, scene

OF_DRAFTS = ("app.scene3d.draft_renderer", "app.scene3d.draft_state", "skincal.part.draft_preview")


def test_a_session_draws_without_the_modules_of_a_draft(monkeypatch):
    plan = layout()
    session, draft = StaticScene(Part(scene(plan), box(), laid(plan), np.arange(24), ())), DraftStatic()
    for name in OF_DRAFTS:
        monkeypatch.delitem(sys.modules, name, raising=False)
    assert canvas._renderer_class(session).__name__ == "SceneRenderer"
    assert not [name for name in OF_DRAFTS if name in sys.modules]
    assert canvas._renderer_class(draft).__name__ == "DraftRenderer"
    assert OF_DRAFTS[0] in sys.modules
