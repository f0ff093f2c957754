"""The calibrated part as a scene describes it: mesh, placed layout, and places where taxels may be.

Imports are inside the functions, so that a window can load a part while it starts.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skincal.geometry import IntArray
from skincal.model.scene import Scene, load_scene

if TYPE_CHECKING:
    from skincal.files.reference import TaxelPositions
    from skincal.guide.surface_search import SurfaceSearch
    from skincal.mesh.lay import PlacedLayout
    from skincal.mesh.surface import Surface


@dataclass(frozen=True, eq=False)
class Part:
    """The calibrated part as the scene describes it."""

    scene: Scene
    surface: Surface | None
    laid: PlacedLayout | None
    channels: IntArray
    """(n,) channels that can be taxels: those of the layout, or all."""
    findings: tuple[str, ...]
    """Sentences about the mesh and the anchors on it."""

    @cached_property
    def plan(self) -> TaxelPositions | None:
        """Planned positions of the taxels; `None` if the layout is not laid."""
        from skincal.files.reference import plan_reference

        return None if self.laid is None else plan_reference(self.scene.name, self.laid.places)

    @cached_property
    def cover(self) -> SurfaceSearch | None:
        """Places to search for taxels that no layout places; `None` without a surface or with a laid layout.

        Making it takes half a second.
        """
        from skincal.guide.surface_search import SurfaceSearch

        return None if self.surface is None or self.laid is not None else SurfaceSearch(self.surface)


def why_not_simulated(scene: Scene) -> str:
    """Give the reason why no simulated hand can poke a scene's part, with the remedy; empty if one can."""
    layout = scene.skin.layout
    if layout is None:
        return "A simulated hand needs a layout, and this scene has none: name one by layout of [skin]."
    if scene.skin.anchor is None and all(module.anchor is None for module in layout.modules):
        return "A simulated hand needs the place of the layout, and this scene has none: change the part, step Place."
    return ""


def load_part(path: Path) -> Part:
    """Load a scene with its mesh and its layout; `InputError` if they cannot be used."""
    scene = load_scene(path)
    return lay_part(scene, *load_scene_surface(scene))


def load_scene_surface(scene: Scene) -> tuple[Surface | None, tuple[str, ...]]:
    """Load a scene's mesh, `None` without one, and the loader's findings; `InputError` if it cannot be used."""
    if scene.surface is None:
        return None, ()
    from skincal.mesh.load import load_surface

    surface, findings = load_surface(scene.surface)
    return surface, tuple(finding.sentence for finding in findings)


def anchor_findings(scene: Scene, surface: Surface | None) -> tuple[str, ...]:
    """Check the anchors of a scene's layout on its mesh; see `anchor_remarks`."""
    from skincal.mesh.lay import anchor_remarks

    return () if scene.skin.layout is None else anchor_remarks(scene.skin.layout, scene.skin.anchor, surface)


def lay_part(scene: Scene, surface: Surface | None, findings: tuple[str, ...]) -> Part:
    """Lay the scene's layout on its mesh: up to a second. `InputError` if the layout does not fit the surface.

    `findings` are those of the mesh loader.
    """
    layout = scene.skin.layout
    if layout is None:
        return Part(scene, surface, None, np.arange(scene.skin.channels), findings)
    from skincal.mesh.lay import place_layout

    # The layout computes these lazily: better here than in the window's thread.
    _ = layout.places, layout.module_of, layout.spacing
    laid = place_layout(layout, scene.skin.anchor, surface)
    findings = (*findings, *anchor_findings(scene, surface))
    return Part(scene, surface, laid, layout.channels, findings)
