"""A small part with skin on it, and sessions on it, for the tests of the 3D view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from app.state.view_state import ViewState, state_at_rest
from skincal.contacts.outcome import Contact, Outcome, PressPhase, Progress
from skincal.guide.guidance import Guidance, GuidePhase, Target
from skincal.mesh.lay import PlacedLayout
from skincal.mesh.surface import Surface, make_surface
from skincal.model.scene import ContactSettings, NoiseSettings, Scene, SkinSpec
from skincal.model.skin import MODULE_KINDS, Layout, Module
from skincal.session.snapshot import LiveView, PokeRecord, Snapshot
from skincal.taxels.result import Estimate, Method, State

HALF = 0.04  # m. The part is a box whose top face, at z = 0, carries the skin.


def box() -> Surface:
    """A closed box, 80 x 80 x 20 mm, outward wound, its top at z = 0."""
    vertices = np.array([(x, y, z) for z in (-0.02, 0.0) for y in (-HALF, HALF) for x in (-HALF, HALF)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return make_surface(vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))


def project(renderer: Any, points: np.ndarray) -> np.ndarray:
    """The positions of (n, 3) points, metres, in the picture, (n, 3) float.

    x and y are device pixels from the lower left; depth is from -1 (near) to 1 in the picture.
    """
    camera = renderer.GetActiveCamera()
    matrix = camera.GetCompositeProjectionTransformMatrix(renderer.GetTiledAspectRatio(), -1, 1)
    transform = np.array([[matrix.GetElement(row, column) for column in range(4)] for row in range(4)])
    clip = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ transform.T
    # Behind the camera the division would bring a point into the picture, upside down.
    normal = clip[:, :3] / np.where(clip[:, 3:] > 0, clip[:, 3:], np.nan)
    width, height = renderer.GetSize()
    return np.stack([(normal[:, 0] + 1) * width / 2, (normal[:, 1] + 1) * height / 2, normal[:, 2]], axis=1)


def layout(modules: int = 2) -> Layout:
    """Triangles of 12 taxels in a row; module i starts at channel 12 i."""
    kind = MODULE_KINDS["triangle_12"]
    places = [np.array([-0.018 + 0.036 * i, 0.0]) for i in range(modules)]
    return Layout(tuple(Module(10 + i, kind, 12 * i, place, 0.0, False) for i, place in enumerate(places)), 12 * modules)


def laid(plan: Layout) -> PlacedLayout:
    """The layout on the plane z = 0."""

    def lift(flat: np.ndarray) -> np.ndarray:
        return np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)

    up = np.tile([0.0, 0.0, 1.0], (plan.width, 1))
    return PlacedLayout(lift(plan.places), up, tuple(lift(m.outline) for m in plan.modules))


def scene(plan: Layout | None) -> Scene:
    channels = 24 if plan is None else plan.width
    skin = SkinSpec(channels, 1, plan, None, None)
    return Scene("test", "link", skin, None, None, np.eye(4), 1, ContactSettings(), NoiseSettings(), Path())


def estimate(channel: int, at: Sequence[float], method: Method = Method.FREE, sd: float = 1e-3) -> Estimate:
    return Estimate(
        channel, method, State.TOUCHED, 4, np.array(at, dtype=float), np.array([0.0, 0.0, 1.0]), sd**2 * np.eye(3),
        np.array([1.0, 0.0, 0.0]), sd, sd * 3**0.5,
    )  # fmt: skip


def snapshot(
    generation: int,
    free: Mapping[int, Estimate],
    surface: Mapping[int, Estimate] | None = None,
    pokes: Sequence[Outcome] = (),
    channels: int = 24,
) -> Snapshot:
    """A session with these estimates; all other channels are unseen."""
    estimates = {
        method: tuple(known.get(c, Estimate(c, method, State.UNSEEN, 0)) for c in range(channels))
        for method, known in ((Method.FREE, free), (Method.SURFACE, free if surface is None else surface))
    }
    records = tuple(PokeRecord(poke, False) for poke in pokes)
    return Snapshot(generation, records, estimates, np.empty(0, dtype=np.int64))


def decided(at: Snapshot, **fields: Any) -> Snapshot:
    """The session after decisions of the operator."""
    return replace(at, decisions=replace(at.decisions, **fields))


def contact(poke: int, channel: int, at: Sequence[float], force: Sequence[float] = (0.0, 0.0, -8.0)) -> Contact:
    pushed = np.array(force, dtype=float)
    return Contact(
        poke, 0.0, 0.3, pushed, np.cross(at, pushed), np.array([channel]), np.array([50.0]), np.eye(4), "", float("nan"), True
    )


def live(at: Sequence[float] | None = None, force: Sequence[float] = (0.0, 0.0, -8.0)) -> LiveView:
    """Nothing pressing, or a poke whose axis goes through `at`."""
    none = np.empty(0, dtype=np.int64)
    if at is None:
        progress = Progress(PressPhase.READY, np.zeros(3), np.zeros(3), none, np.empty(0), 0.0)
    else:
        progress = Progress(
            PressPhase.PRESSING, np.array(force, dtype=float), np.array(at, dtype=float), none, np.empty(0), 0.5
        )
    return LiveView(np.empty(0), np.empty((0, 6)), np.zeros(24), progress, (), 0, "low", np.eye(4))


def tick_of(
    at: Snapshot,
    view: LiveView | None = None,
    method: Method = Method.FREE,
    selected: int | None = None,
    target: Target | None = None,
    leeway: float = 0.0,
) -> ViewState:
    """A tick of a session as the 3D view reads it; `leeway`, rad, is the half angle of the target's cone, 0 for none."""
    made = state_at_rest(scene(layout()), at, method)
    return replace(made, live=view or made.live, selected=selected, guidance=target and guidance_to(target, leeway))


def guidance_to(target: Target, leeway: float = 0.0) -> Guidance:
    """A guide that asks for a target, whose push may be off by `leeway`, rad."""
    none, count = np.empty(0), np.empty(0, dtype=np.int64)
    return Guidance(
        method=Method.SURFACE, phase=GuidePhase.OWN, target=target, channels=count, places=np.empty((0, 3)), rms=none,
        diversity=none, own=count, needs=(), given_up={}, usable_tilt=leeway, pokes_left=1, seconds_left=None,
    )  # fmt: skip
