"""The simulated rig of a skin whose taxels measure a force vector (`vector_skin.py`).

The taxels of a module have the axes of its housing: x along the layout's x, as the module is glued, and z out of the skin. So
they share one turn on a flat module, and on a bent one each taxel has its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from skincal.axes.axis_results import fit_plan
from skincal.files.reference import truth_as_json
from skincal.geometry import FloatArray, IntArray, rotations
from skincal.model.scene import Scene
from skincal.model.skin_axes import SkinAxes
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import PressedPlaces, Rig
from skincal.simulation.vector_skin import VectorErrors, VectorSkin

RAW_PER_NEWTON = 100.0
"""Raw units of a skin without a unit: a press of 4 N gives 160, and the default threshold is 10."""
MODULE_GLUE_SD = float(np.radians(3.0))
"""rad, turn of a module from its plan about each axis. Assumed: modules are glued by hand."""


def vector_errors(errors: RigErrors) -> VectorErrors:
    """Choose the errors of the skin that belong to those of a rig.

    A rig with noise has noise and steps of 0.1 N. One whose pressure scatters below the tip also has unequal ratios of shear,
    soft material that bulges, and crosstalk.
    """
    usual, none = VectorErrors(), VectorErrors.none()
    is_noisy, is_soft = errors.skin_noise > 0, errors.scatter > 0
    return VectorErrors(
        gain_spread=errors.gain_spread,
        ratio_spread=usual.ratio_spread if is_soft else none.ratio_spread,
        bulge=usual.bulge if is_soft else none.bulge,
        neighbour_crosstalk=usual.neighbour_crosstalk if is_soft else none.neighbour_crosstalk,
        noise=usual.noise if is_noisy else none.noise,
        step=usual.step if is_noisy else none.step,
    )


class VectorRig(Rig):
    """A simulated rig with taxels of three axes."""

    values_shape = (3,)

    @classmethod
    def require_skin(cls, scene: Scene) -> SkinAxes:
        """Return the axes of the scene's skin."""
        axes = scene.skin.axes
        assert axes is not None
        return axes

    def _set_up_skin(self, rng: np.random.Generator) -> None:
        axes = self._axes = self.require_skin(self.scene)
        self._scale = 1.0 if axes.unit == "N" else RAW_PER_NEWTON
        low, high = self.scene.skin.range or (-np.inf, np.inf)
        self.range, self.polarity, self.counts = (low, high), self.scene.skin.polarity, 1.0
        self._rest = 0.5 * (low + high) if np.isfinite(low) and np.isfinite(high) else 0.0
        glue, skin = rng.spawn(2)
        turned = _axes_of_housing(self.scene, self.channels, self.places, self.normals, glue)
        self.skin = VectorSkin(self.places, self.normals, vector_errors(self.errors), skin, turned)

    def answers(self, pokes: PressedPlaces, loads: FloatArray, at_once: int | None = None) -> tuple[IntArray, FloatArray]:
        """Return the readings (n, k, 3) of nearby taxels, N, in their axes; see `Rig.answers`."""
        rows = self.taxels_near(pokes.points.reshape(-1, at_once or max(len(pokes), 1), 3))
        rows = rows.reshape(len(pokes), rows.shape[-1])
        return rows, self.skin.readings(pokes, loads[:, None] * pokes.directions, rows)

    def skin_frame(self, answers: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return frames (n, 3 channels) in the device's order for readings (n, taxels, 3), N, with noise and steps."""
        vectors = np.zeros((len(answers), self.scene.skin.channels, 3))
        vectors[:, self.channels] = self.skin.measured(answers, rng)
        return np.clip(self._rest + self._scale * self._axes.as_frames(vectors), *self.range)

    def truth(self) -> dict[str, Any]:
        return truth_as_json(self.scene.link, self.channels, self.places, self.normals, self.skin.axes)


def _axes_of_housing(
    scene: Scene, channels: IntArray, places: FloatArray, normals: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Compute the axes (n, 3, 3) of taxels at `places` (n, 3) with `normals` (n, 3) from their modules."""
    assert scene.skin.layout is not None
    where = dict(zip(channels.tolist(), zip(places, normals, strict=True), strict=True))
    x_axes = dict[int, FloatArray]()
    leans = np.zeros((len(channels), 3))
    row_of = {channel: row for row, channel in enumerate(channels.tolist())}
    for module in scene.skin.layout.modules:
        plan = fit_plan(module, where)
        glue = MODULE_GLUE_SD * rng.standard_normal(3)
        for channel in (channel for channel in module.channels.tolist() if channel in where):
            x_axes[channel] = np.array([1.0, 0.0, 0.0]) if plan is None else plan[0][:, 0]
            leans[row_of[channel]] = glue
    along = np.array([x_axes[channel] for channel in channels.tolist()])
    x = along - np.sum(along * normals, axis=1, keepdims=True) * normals
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.asarray(np.cross(normals, x), dtype=np.float64)
    return np.stack([x, y, normals], axis=2) @ rotations(leans)
