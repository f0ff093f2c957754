"""Where every taxel of a robot skin is, from pokes measured by a force/torque sensor.

    >>> import skincal
    >>> scene = skincal.Scene.load("icub-forearm")
    >>> session = skincal.simulate(scene, pokes=60, seed=1)
    >>> taxels = session.taxels("surface")
    >>> taxels.channel, taxels.position, taxels.covariance
    >>> taxels.compare(session.truth)
    >>> session.export("r_forearm.txt", format="icub")

Begin with a part and its pokes:

    Scene            a part: mesh, layout, sensor. `Scene.load`, `Scene.from_mesh`, `Scene.from_urdf`
    Session          pokes and their estimates. `Session.load` opens a recording
    solve            a session from your own arrays: wrenches, responses of the skin, poses
    read_bag         a session from a recording of ROS; `read_csv`, from tables
    simulate         a session on a simulated rig, whose taxels are known (`Session.truth`)

and go on with the results:

    Session.taxels   `Taxels`: a table of positions, normals and covariances; `to_pandas`, `plot`, `plot_3d`
    Session.verdict  `Judgement`: whether the positions may be used, in a sentence
    Session.export   a calibration file: iCub, URDF, SDF, MJCF, JSON and others (`ExportOptions`, `Inertia`)
    Session.report   a page with pictures and tables
    Taxels.compare   `Comparison`: distances to other positions. `Taxels.load` reads them from a file

Wrong input raises `InputError`, whose text says what was expected. Lengths are metres, forces newtons, moments newton metres,
angles radians. Positions are in the frame of the link, wrenches in that of the sensor. The tutorial is `docs/python.md`, the
method `docs/method.md` (Del Prete et al., IROS 2011). This package draws no window.

Linear algebra runs in one thread, in this process and those it starts, unless the environment says otherwise or numpy was
imported before: the matrices are small, and beside a busy process threads that wait for one another take ten times as long.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

from skincal.version import __version__ as __version__

if TYPE_CHECKING:
    from skincal.files.formats import ExportOptions, Inertia
    from skincal.files.reference import Comparison
    from skincal.interface.scene import Scene
    from skincal.interface.session import Judgement, Session, read_bag, read_csv, simulate, solve
    from skincal.interface.taxels import Taxels
    from skincal.model.errors import InputError

__all__ = [
    "Comparison", "ExportOptions", "Inertia", "InputError", "Judgement", "Scene", "Session", "Taxels", "read_bag", "read_csv",
    "simulate", "solve",
]  # fmt: skip

# OpenBLAS, MKL and Accelerate read these once, when numpy or scipy is imported.
for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_variable, "1")

_PUBLIC_NAMES = {
    "skincal.files.formats": ("ExportOptions", "Inertia"),
    "skincal.files.reference": ("Comparison",),
    "skincal.interface.scene": ("Scene",),
    "skincal.interface.session": ("Judgement", "Session", "read_bag", "read_csv", "simulate", "solve"),
    "skincal.interface.taxels": ("Taxels",),
    "skincal.model.errors": ("InputError",),
}


def __getattr__(name: str) -> Any:
    """Import a public name at its first use: commands need none of them, and numpy takes a quarter of a second."""
    for module, names in _PUBLIC_NAMES.items():
        if name in names:
            return getattr(import_module(module), name)
    raise AttributeError(f"module 'skincal' has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names."""
    return [*__all__, "__version__"]
