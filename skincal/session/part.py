"""What is calibrated, as a scene describes it: the mesh, the layout laid on it, and where taxels may be before any poke.

The imports stand inside the functions, so that a window can do this beside its own start.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skincal.geometry import IntArray
from skincal.model.scene import Scene, load_scene

if TYPE_CHECKING:
    from skincal.files.reference import Reference
    from skincal.guide.candidates import Cover
    from skincal.mesh.lay import LaidSkin
    from skincal.mesh.surface import Surface


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """What is calibrated, as the scene describes it."""

    scene: Scene
    surface: Surface | None
    laid: LaidSkin | None
    channels: IntArray
    """(n,) channels that can be taxels: those of the layout, or all."""
    findings: tuple[str, ...]
    """What the mesh loader has to say."""
    plan: Reference | None = None
    """Where the layout places the taxels; None where it does not."""
    cover: Cover | None = None
    """Where to look for taxels that no layout places; None where there is nothing to look for, or no surface."""


def load_part(path: Path) -> Part:
    """Load a scene with its mesh and its layout; InputError where they cannot be used."""
    scene = load_scene(path)
    return lay_part(scene, *load_scene_surface(scene))


def load_scene_surface(scene: Scene) -> tuple[Surface | None, tuple[str, ...]]:
    """Return a scene's mesh, None where it has none, and what the loader has to say; InputError where it cannot be used."""
    if scene.surface is None:
        return None, ()
    from skincal.mesh.load import load_surface

    surface, findings = load_surface(scene.surface)
    return surface, tuple(finding.sentence for finding in findings)


def lay_part(scene: Scene, surface: Surface | None, findings: tuple[str, ...]) -> Part:
    """Lay the scene's layout on its mesh, which takes a second where the mesh is large.

    `findings` is what the mesh loader has to say. InputError where the layout does not lie on the surface.
    """
    layout = scene.skin.layout
    if layout is None:
        return Part(scene, surface, None, np.arange(scene.skin.channels), findings, cover=_cover(surface))
    from skincal.files.reference import plan_reference
    from skincal.mesh.lay import lay

    # The layout works these out when they are first asked for: better here than in the window's thread.
    _ = layout.places, layout.module_of, layout.spacing
    laid = lay(layout, scene.skin.anchor, surface)
    plan = None if laid is None else plan_reference(scene.name, laid.places)
    return Part(scene, surface, laid, layout.channels, findings, plan, cover=_cover(surface) if laid is None else None)


def _cover(surface: Surface | None) -> Cover | None:
    """Spread places over a surface; only where they are needed, since it takes half a second."""
    if surface is None:
        return None
    from skincal.guide.candidates import Cover

    return Cover(surface)
