"""Words in the picture: on a plate of the background's colour, so that they are read on any hue, and where least is in the way.

Places are pixels from the lower left; a box is left, low, right, top.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkTextActor

from app.scene3d.scene_state import Colour, ColourArray, Look, unit
from app.scene3d.shapes import Text, written
from skincal.geometry import FloatArray

PLATE = 0.85
"""Opacity of a plate: words on it have 4.5:1 on whatever lies below, and what that is can be guessed."""
POINTS = 72.0
"""Points an inch."""
WIDTH, HEIGHT = 0.62, 1.5
"""A letter's width and a line's height, in sizes of the letters: of VTK's own font, at most."""


def name_actor(letters: int, *, bold: bool = False) -> vtkTextActor:
    """Return words that are put somewhere by `put`; not seen yet."""
    actor = written(vtkTextActor(), letters=letters)
    actor.GetTextProperty().SetBold(bold)
    actor.VisibilityOff()
    return actor


def make_readable(text: Text, look: Look, ink: Colour | ColourArray) -> None:
    """Write in a colour that is read on the background, upon a plate of that."""
    style = text.GetTextProperty()
    style.SetColor(*unit(ink))
    style.SetBackgroundColor(*unit(look.background))
    style.SetBackgroundOpacity(PLATE)


def put(actor: vtkTextActor, renderer: vtkRenderer, at: FloatArray, beside: float, taken: Sequence[FloatArray]) -> FloatArray:
    """Put words beside a place, right of it or wherever is room, and return their box, (4,) float.

    Parameters
    ----------
    at : (2,) float
    beside : from the place to the words
    taken : boxes, (4,) each, that the words had better not cover
    """
    boxes = [box_around(at + way, half) for way, half in _ways(actor, renderer, beside)]
    width, height = renderer.GetSize()
    whole = np.array([0.0, 0.0, width, height])
    costs = [sum(_shared(box, each) for each in taken) + (_area(box) - _shared(box, whole)) for box in boxes]
    # The first of those that are as free.
    box = boxes[int(np.argmin(np.round(costs)))]
    actor.SetPosition((box[0] + box[2]) / 2.0, (box[1] + box[3]) / 2.0)
    return box


def _ways(actor: vtkTextActor, renderer: vtkRenderer, beside: float) -> list[tuple[FloatArray, FloatArray]]:
    """Return the ways from a place to the middle of the words, and half their size, in the order in which they are tried."""
    letters = actor.GetTextProperty().GetFontSize() * renderer.GetRenderWindow().GetDPI() / POINTS
    half = np.array([WIDTH * len(actor.GetInput()), HEIGHT]) * letters / 2.0
    right, up = np.array([beside + half[0], 0.0]), np.array([0.0, beside + half[1]])
    return [(way, half) for way in (right, -right, up, -up, right + up, right - up, up - right, -up - right)]


def box_around(middle: FloatArray, half: FloatArray | float) -> FloatArray:
    """Return the box (4,) about a place, (2,), with half its size."""
    return np.concatenate([middle - half, middle + half])


def _shared(one: FloatArray, other: FloatArray) -> float:
    sides = np.minimum(one[2:], other[2:]) - np.maximum(one[:2], other[:2])
    return float(np.prod(np.maximum(sides, 0.0)))


def _area(box: FloatArray) -> float:
    return float(np.prod(box[2:] - box[:2]))
