"""The simulated rig of a scene: taxels of one axis, or of three."""

from __future__ import annotations

import numpy as np

from skincal.mesh.surface import Surface
from skincal.model.scene import Scene
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import Rig


def make_rig(scene: Scene, surface: Surface | None, errors: RigErrors, rng: np.random.Generator) -> Rig:
    """Make the rig. Raises InputError: the scene has no taxel positions."""
    if scene.skin.axes is None:
        return Rig(scene, surface, errors, rng)
    from skincal.simulation.vector_rig import VectorRig  # other scenes do without

    return VectorRig(scene, surface, errors, rng)
