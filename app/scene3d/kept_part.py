"""The drawn part is kept while the camera stands still: a picture draws only the region where something changed in it.

While a tool presses, only its force axis and its contact move. On software OpenGL the part costs two thirds of a picture, and
the labels a fifth. So two pictures are kept: of renderer `PART` with its depth, and of `PART` and `WITHIN`. The window's
framebuffer keeps the whole picture: VTK does not clear it if `PART` is not drawn. In the region where something changed, a
later picture copies one of the kept ones, and draws the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from vtkmodules.vtkCommonCore import vtkCommand, vtkFloatArray
from vtkmodules.vtkCommonDataModel import vtkRecti
from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLFramebufferObject, vtkOpenGLRenderWindow

from app.scene3d.camera import Viewpoint
from app.scene3d.mesh_actors import FRONT, PART, WITHIN
from skincal.geometry import FloatArray

if TYPE_CHECKING:
    import pyvista as pv
    from vtkmodules.vtkRenderingCore import vtkProp, vtkRenderWindow

    from app.scene3d.mesh_actors import MeshActor

Region: TypeAlias = tuple[int, int, int, int]
"""Device pixels from the lower left: left, bottom, right, top; the last two are outside."""
EMPTY_REGION: Region = (0, 0, 0, 0)
GL_COLOR_BUFFER_BIT, GL_DEPTH_BUFFER_BIT, GL_NEAREST = 0x4000, 0x100, 0x2600
GL_READ_FRAMEBUFFER, GL_DRAW_FRAMEBUFFER = 0x8CA8, 0x8CA9
VTK_UNSIGNED_CHAR, DEPTH_BITS = 3, 32  # As in VTK's own buffer: depth is only copied between equal formats
REGION_MARGIN_PX = 2  # Around what changed, for the rounding of lines to pixels
MAX_REGION_SHARE = 0.7  # Of the picture: a larger region is drawn as a whole picture
PROBE_DEPTH, PROBE_TOLERANCE = 0.375, 1e-3  # Copied once to see if copies work; nothing else leaves this depth


class KeptPart:
    """Pixels of the renderers of one window without multisampling: of `PART`, and with `WITHIN`."""

    def __init__(self, window: vtkRenderWindow, part: pv.Renderer, within: pv.Renderer, front: pv.Renderer) -> None:
        assert isinstance(window, vtkOpenGLRenderWindow), "every window that VTK makes here"
        self.window, self.part, self.within = window, part, within
        self._camera = part.GetActiveCamera()
        self.drawn_parts = self.drawn_fronts = self.drawn_labels = 0
        """Pictures for which the whole part, all before it, and the labels were drawn."""
        self._size = (0, 0)
        self._are_buffers_made = False
        """The buffers have size `_size`, and a copy from them works."""
        self._is_copy_proven = False
        self._opaque, self._whole = vtkOpenGLFramebufferObject(), vtkOpenGLFramebufferObject()
        self._viewpoint: Viewpoint | None = None
        self._key: object = None
        self._labels_key: object = None
        self._is_kept = False
        """The kept pixels are those of `_viewpoint` and `_key`."""
        self._moving: dict[MeshActor, tuple[tuple[bool, int], Region]] = {}
        self._region, self._front_region = EMPTY_REGION, EMPTY_REGION
        """Where `WITHIN` is drawn again, and where `FRONT` is."""
        self._is_new = self._is_front_new = True
        """The whole part, or all before it, is drawn in this picture."""
        self._observers = [
            (renderer, renderer.AddObserver(event, react))
            for renderer, event, react in (
                (part, vtkCommand.StartEvent, self._before_part),
                (part, vtkCommand.EndEvent, self._after_part),
                (within, vtkCommand.StartEvent, self._before_within),
                (within, vtkCommand.EndEvent, self._after_within),
                (front, vtkCommand.StartEvent, self._before_front),
                (front, vtkCommand.EndEvent, self._after_front),
            )
        ]

    def prepare(
        self, viewpoint: Viewpoint, actors: Sequence[MeshActor], labels_key: object, depth_range: tuple[float, float]
    ) -> None:
        """Decide what the next picture draws; `labels_key` changes with the look of the labels."""
        moving = [actor for actor in actors if actor.renderer != PART]
        own = {actor.actor for actor in moving}
        still = (prop for renderer in (self.part, self.within) for prop in renderer.actors.values() if prop not in own)
        key = depth_range, self.part.GetBackground(), tuple(_key_of(prop) for prop in still)
        is_same = viewpoint.is_same(self._viewpoint) and key == self._key
        self._region, front = self._changed(moving, viewpoint)
        self._front_region = _union(self._region, front)
        room = MAX_REGION_SHARE * viewpoint.size[0] * viewpoint.size[1]
        self._is_new = not (is_same and self._is_kept and _area(self._region) <= room)
        self._is_front_new = self._is_new or labels_key != self._labels_key or _area(self._front_region) > room
        # A moving camera would only make each picture pay for the copies.
        self._is_kept = is_same and self._make_buffers(viewpoint.size)
        self._viewpoint, self._key, self._labels_key = viewpoint, key, labels_key
        self.part.SetDraw(self._is_new)
        self.within.SetDraw(self._is_new or self._region != EMPTY_REGION)
        self.drawn_parts += self._is_new
        self.drawn_fronts += self._is_front_new

    def has_labels_to_draw(self, boxes: FloatArray) -> bool:
        """Return whether the next picture draws labels in boxes, (n, 4) float: left, bottom, right, top in device pixels."""
        left, bottom, right, top = self._front_region
        is_hit = (boxes[:, 0] < right) & (boxes[:, 2] > left) & (boxes[:, 1] < top) & (boxes[:, 3] > bottom)
        is_drawn = self._is_front_new or (self._front_region != EMPTY_REGION and bool(is_hit.any()))
        self.drawn_labels += is_drawn
        return is_drawn

    def close(self) -> None:
        for renderer, observer in self._observers:
            renderer.RemoveObserver(observer)
        if self._size != (0, 0):
            self.window.MakeCurrent()
            for buffer in (self._opaque, self._whole):
                buffer.ReleaseGraphicsResources(self.window)

    def _changed(self, moving: Sequence[MeshActor], viewpoint: Viewpoint) -> tuple[Region, Region]:
        """Return the pixels where actors of `WITHIN` changed since the last picture, and where those of `FRONT` did."""
        regions = {WITHIN: EMPTY_REGION, FRONT: EMPTY_REGION}
        if not viewpoint.is_same(self._viewpoint):
            self._moving.clear()
            return EMPTY_REGION, EMPTY_REGION
        for actor in moving:
            key = _key_of(actor.actor)
            before_key, before = self._moving.get(actor, (None, EMPTY_REGION))
            if key != before_key:
                now = _region_of(actor, viewpoint)
                self._moving[actor] = key, now
                regions[actor.renderer] = _union(regions[actor.renderer], _union(now, before))
        return regions[WITHIN], regions[FRONT]

    def _make_buffers(self, size: tuple[int, int]) -> bool:
        if size == self._size:
            return self._are_buffers_made
        self._size, self._is_copy_proven = size, False
        made = True
        for buffer in (self._opaque, self._whole):
            buffer.SetContext(self.window)
            self.window.GetState().PushFramebufferBindings()
            has_depth = buffer is self._opaque
            made = buffer.PopulateFramebuffer(*size, True, 1, VTK_UNSIGNED_CHAR, has_depth, DEPTH_BITS, 0) and made
            self.window.GetState().PopFramebufferBindings()
        self._are_buffers_made = made
        return made

    def _before_part(self, *_: object) -> None:
        # The first picture with these buffers: all of it is drawn.
        if self._is_kept and not self._is_copy_proven:
            self._are_buffers_made = self._is_kept = self._is_copy_proven = self._can_copy()

    def _can_copy(self) -> bool:
        """Return whether a copy of colours and depth arrives in the picture: OpenGL refuses one between other formats."""
        state, depth = self.window.GetState(), vtkFloatArray()
        state.PushFramebufferBindings()
        self._opaque.Bind(GL_DRAW_FRAMEBUFFER)
        self._opaque.ActivateDrawBuffer(0)
        state.vtkglViewport(0, 0, *self._size)
        state.vtkglScissor(0, 0, *self._size)
        state.vtkglDepthMask(True)
        state.vtkglClearDepth(PROBE_DEPTH)
        state.vtkglClear(GL_DEPTH_BUFFER_BIT)
        state.vtkglClearDepth(1.0)
        state.PopFramebufferBindings()
        frame = self.window.GetRenderFramebuffer()
        self._copy(self._opaque, frame, self._full(), GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT)
        is_read = self.window.GetZbufferData(0, 0, 0, 0, depth)
        return bool(is_read) and abs(depth.GetValue(0) - PROBE_DEPTH) < PROBE_TOLERANCE

    def _after_part(self, *_: object) -> None:
        if self._is_kept:
            self._copy(
                self.window.GetRenderFramebuffer(), self._opaque, self._full(), GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT
            )

    def _before_within(self, *_: object) -> None:
        if self._is_new:
            return
        planes = GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT
        self._copy(self._opaque, self.window.GetRenderFramebuffer(), self._region, planes)
        self._draw_only(self._region)

    def _after_within(self, *_: object) -> None:
        self._camera.SetUseScissor(False)
        if self._is_kept:
            region = self._full() if self._is_new else self._region
            self._copy(self.window.GetRenderFramebuffer(), self._whole, region, GL_COLOR_BUFFER_BIT)

    def _before_front(self, *_: object) -> None:
        if self._is_new:
            return
        region = self._full() if self._is_front_new else self._front_region
        self._copy(self._whole, self.window.GetRenderFramebuffer(), region, GL_COLOR_BUFFER_BIT)
        if not self._is_front_new:
            self._draw_only(region)

    def _after_front(self, *_: object) -> None:
        self._camera.SetUseScissor(False)

    def _draw_only(self, region: Region) -> None:
        left, bottom, right, top = region
        self._camera.SetScissorRect(vtkRecti(left, bottom, right - left, top - bottom))
        self._camera.SetUseScissor(True)

    def _full(self) -> Region:
        return 0, 0, self._size[0], self._size[1]

    def _copy(self, source: vtkOpenGLFramebufferObject, to: vtkOpenGLFramebufferObject, region: Region, planes: int) -> None:
        if region == EMPTY_REGION:
            return
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
        return EMPTY_REGION
    points: FloatArray = np.asarray(actor.mesh.points, float)
    width, height = viewpoint.size
    if not (viewpoint.pixel_at(points) > 0.0).all():
        return 0, 0, width, height
    places = viewpoint.on_screen(points) * viewpoint.ratio + (width / 2.0, height / 2.0)
    reach = actor.pixels * viewpoint.ratio / 2.0 + REGION_MARGIN_PX
    low, high = np.clip(np.floor(places.min(axis=0) - reach), 0, None), np.ceil(places.max(axis=0) + reach)
    region = int(low[0]), int(low[1]), int(min(high[0], width)), int(min(high[1], height))
    return region if _area(region) else EMPTY_REGION


def _area(region: Region) -> int:
    return max(0, region[2] - region[0]) * max(0, region[3] - region[1])


def _union(first: Region, second: Region) -> Region:
    if EMPTY_REGION in (first, second):
        return second if first == EMPTY_REGION else first
    return min(first[0], second[0]), min(first[1], second[1]), max(first[2], second[2]), max(first[3], second[3])
