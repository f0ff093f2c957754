"""Record the shipped sample session again, with the same readings each time: `.venv/bin/python tools/sample.py`.

One careful poke for each taxel on the simulated forearm with sensor noise, in two arm poses, at 100 Hz of wrenches (the
iCub's rate) so that it stays small.
"""

import shutil
import sys
from pathlib import Path

CHECKOUT_FOLDER = Path(__file__).resolve().parent.parent
# Run as a file, Python finds only modules of its folder.
sys.path.insert(0, str(CHECKOUT_FOLDER))

SAMPLE_FOLDER = CHECKOUT_FOLDER / "resources" / "sessions" / "sample"


def main() -> None:
    """Write `resources/sessions/sample`."""
    from skincal.mesh.load import load_surface
    from skincal.model.scene import load_scene, resource
    from skincal.simulation.device import DeviceSettings
    from skincal.simulation.operator import Habits
    from skincal.simulation.rig_errors import RigErrors
    from skincal.simulation.virtual_session import simulate_session

    scene = load_scene(resource("scenes/icub-forearm/scene.toml"))
    assert scene.surface is not None
    shutil.rmtree(SAMPLE_FOLDER, ignore_errors=True)
    simulate_session(
        scene,
        load_surface(scene.surface)[0],
        SAMPLE_FOLDER,
        pokes=84,
        seed=11,
        errors=RigErrors.noise(),
        poses=("1", "6"),
        habits=Habits.careful(),
        settings=DeviceSettings(wrench_hz=100.0, joints_hz=10.0),
    )


if __name__ == "__main__":
    main()
