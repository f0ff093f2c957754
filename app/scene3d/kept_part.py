"""The drawn part is kept while the camera stands still: a picture draws only the region where something changed in it.

While a tool presses, only its force axis moves inside the part. On software OpenGL the part costs two thirds of a picture. So
the pixels of renderer `PART` are kept with their depth, and those of `PART` and `WITHIN` together without it. A later picture
copies the second, in the changed region the first, and draws `WITHIN` in that region only.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from vtkmodules.vtkCommonCore import vtkCommand
from vtkmodules.vtkCommonDataModel import vtkRecti
from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLFramebufferObject, vtkOpenGLRenderWindow

from app.scene3d.camera import Viewpoint
from skincal.geometry import FloatArray

if TYPE_CHECKING:
    import pyvista as pv
    from vtkmodules.vtkRenderingCore import vtkProp, vtkRenderer, vtkRenderWindow

    from app.scene3d.mesh_actors import MeshActor

Region: TypeAlias = tuple[int, int, int, int]
"""Device pixels from the lower left: left, bottom, right, top; the last two are outside."""
NOTHING: Region = (0, 0, 0, 0)
GL_COLOR_BUFFER_BIT, GL_DEPTH_BUFFER_BIT, GL_NEAREST = 0x4000, 0x100, 0x2600
GL_READ_FRAMEBUFFER, GL_DRAW_FRAMEBUFFER = 0x8CA8, 0x8CA9
VTK_UNSIGNED_CHAR, DEPTH_BITS = 3, 32  # As in VTK's own buffer: depth is only copied between equal formats
REGION_MARGIN_PX = 2  # Around what changed, for the rounding of lines to pixels
MAX_REGION_SHARE = 0.7  # Of the picture: a larger region is drawn as a whole picture


class KeptPart:
    """Pixels of the renderers `part` and `within` of one window without multisampling."""

    def __init__(self, window: vtkRenderWindow, part: pv.Renderer, within: pv.Renderer, front: vtkRenderer) -> None:
        assert isinstance(window, vtkOpenGLRenderWindow), "every window that VTK makes here"
        self.window, self.part, self.within, self._camera = window, part, within, part.GetActiveCamera()
        self.drawn_parts = 0  # Pictures for which the whole part was drawn
        self._size = (0, 0)
        self._opaque, self._whole = vtkOpenGLFramebufferObject(), vtkOpenGLFramebufferObject()
        self._viewpoint: Viewpoint | None = None
        self._key: object = None
        self._is_kept = False
        """The kept pixels are those of `_viewpoint` and `_key`."""
        self._moving: dict[MeshActor, tuple[tuple[bool, int], Region]] = {}
        self._region = NOTHING
        self._is_new = True
        """The whole part is drawn in this picture, and kept afterwards."""
        self._observers = [
            (renderer, renderer.AddObserver(event, react))
            for renderer, event, react in (
                (part, vtkCommand.EndEvent, self._after_part),
                (within, vtkCommand.StartEvent, self._before_within),
                (within, vtkCommand.EndEvent, self._after_within),
                (front, vtkCommand.StartEvent, self._before_front),
            )
        ]

    def prepare(self, viewpoint: Viewpoint, moving: Sequence[MeshActor], depth_range: tuple[float, float]) -> None:
        """Decide what the next picture draws; `moving` are the actors of `WITHIN` that change while the camera stands still."""
        own = {actor.actor for actor in moving}
        still = (prop for renderer in (self.part, self.within) for prop in renderer.actors.values() if prop not in own)
        key = depth_range, self.part.GetBackground(), tuple(_key_of(prop) for prop in still)
        states = {actor: (_key_of(actor.actor), _region_of(actor, viewpoint)) for actor in moving}
        width, height = viewpoint.size
        is_same = viewpoint.is_same(self._viewpoint) and key == self._key
        region = NOTHING
        for actor, (actor_key, now) in states.items():
            before_key, before = self._moving.get(actor, ((False, 0), NOTHING))
            if actor_key != before_key:
                region = _union(region, _union(now, before))
        self._moving, self._viewpoint, self._key = states, viewpoint, key
        left, bottom, right, top = region
        self._region = max(left, 0), max(bottom, 0), min(right, width), min(top, height)
        area = max(0, self._region[2] - self._region[0]) * max(0, self._region[3] - self._region[1])
        if not area:
            self._region = NOTHING
        self._is_new = not (is_same and self._is_kept and area <= MAX_REGION_SHARE * width * height)
        # A moving camera would only make each picture pay for the copies.
        self._is_kept = is_same and self._make_buffers(viewpoint.size)
        self.part.SetDraw(self._is_new)
        self.within.SetDraw(self._is_new or area > 0)
        self.drawn_parts += self._is_new

    def close(self) -> None:
        for renderer, observer in self._observers:
            renderer.RemoveObserver(observer)
        if self._size != (0, 0):
            self.window.MakeCurrent()
            self._opaque.ReleaseGraphicsResources(self.window)
            self._whole.ReleaseGraphicsResources(self.window)

    def _make_buffers(self, size: tuple[int, int]) -> bool:
        if size == self._size:
            return True
        self._size = size
        made = True
        for buffer, has_depth in ((self._opaque, True), (self._whole, False)):
            buffer.SetContext(self.window)
            self.window.GetState().PushFramebufferBindings()
            made = buffer.PopulateFramebuffer(*size, True, 1, VTK_UNSIGNED_CHAR, has_depth, DEPTH_BITS, 0) and made
            self.window.GetState().PopFramebufferBindings()
        return made

    def _after_part(self, *_: object) -> None:
        if self._is_kept:
            self._copy(
                self.window.GetRenderFramebuffer(), self._opaque, self._full(), GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT
            )

    def _before_within(self, *_: object) -> None:
        if self._is_new:
            return
        frame = self.window.GetRenderFramebuffer()
        self._copy(self._whole, frame, self._full(), GL_COLOR_BUFFER_BIT)
        self._copy(self._opaque, frame, self._region, GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT)
        left, bottom, right, top = self._region
        self._camera.SetScissorRect(vtkRecti(left, bottom, right - left, top - bottom))
        self._camera.SetUseScissor(True)

    def _after_within(self, *_: object) -> None:
        self._camera.SetUseScissor(False)
        if self._is_kept:
            region = self._full() if self._is_new else self._region
            self._copy(self.window.GetRenderFramebuffer(), self._whole, region, GL_COLOR_BUFFER_BIT)

    def _before_front(self, *_: object) -> None:
        if not (self._is_new or self.within.GetDraw()):
            self._copy(self._whole, self.window.GetRenderFramebuffer(), self._full(), GL_COLOR_BUFFER_BIT)

    def _full(self) -> Region:
        return 0, 0, self._size[0], self._size[1]

    def _copy(self, source: vtkOpenGLFramebufferObject, to: vtkOpenGLFramebufferObject, region: Region, planes: int) -> None:
        state = self.window.GetState()
        state.PushFramebufferBindings()
        source.Bind(GL_READ_FRAMEBUFFER)
        source.ActivateReadBuffer(0)
        to.Bind(GL_DRAW_FRAMEBUFFER)
        to.ActivateDrawBuffer(0)
        left, bottom, right, top = region
        state.vtkglViewport(0, 0, *self._size)
        state.vtkglScissor(left, bottom, right - left, top - bottom)
        state.vtkglBlitFramebuffer(*region, *region, planes, GL_NEAREST)
        state.PopFramebufferBindings()


def _key_of(prop: vtkProp) -> tuple[bool, int]:
    """Return a key that changes with what a prop draws; the same for every hidden one."""
    return (True, prop.GetRedrawMTime()) if prop.GetVisibility() else (False, 0)


def _region_of(actor: MeshActor, viewpoint: Viewpoint) -> Region:
    """Return the pixels that an actor can cover."""
    if not actor.actor.visibility:
        return NOTHING
    points: FloatArray = np.asarray(actor.mesh.points, float)
    width, height = viewpoint.size
    if not (viewpoint.pixel_at(points) > 0.0).all():
        return 0, 0, width, height
    places = viewpoint.on_screen(points) * viewpoint.ratio + (width / 2.0, height / 2.0)
    reach = actor.pixels * viewpoint.ratio / 2.0 + REGION_MARGIN_PX
    low, high = np.clip(np.floor(places.min(axis=0) - reach), 0, None), np.ceil(places.max(axis=0) + reach)
    return int(low[0]), int(low[1]), int(min(high[0], width)), int(min(high[1], height))


def _union(first: Region, second: Region) -> Region:
    if NOTHING in (first, second):
        return second if first == NOTHING else first
    return min(first[0], second[0]), min(first[1], second[1]), max(first[2], second[2]), max(first[3], second[3])
