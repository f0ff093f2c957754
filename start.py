"""Open skincal from a checkout, on a machine that has nothing but Python: `python3 start.py [OPTIONS | COMMAND ...]`.

Opens the skincal window on a simulated forearm that is being poked. Missing packages are installed first: some hundred
megabytes into .venv of this folder, and on Debian and Ubuntu missing system libraries. Without a display, it runs
the same session without a window, and writes a calibration file and a picture.

It has the options and commands of `skincal`:

  start.py --scene NAME | FILE.toml       open the window on another part
  start.py --session DIR                  go on with a recorded session
  start.py --headless                     run the simulated session without a window
  start.py --ros2 ...                     install the packages that read ROS 2, then the same as without it;
                                          so do --rosbag, --robometry, --hdf5, --parquet,
                                          --excel, --physics and --study
  start.py COMMAND ...                    a command: solve, export, apply, compare, report, devices, watch,
                                          landmarks, tool, record, simulate, scene, import or study
  start.py --physics demo robot           a simulated robot calibrates a part
  start.py --help                         this text; once it is installed, every option and command
  start.py COMMAND --help                 installs what is missing, and lists the options of a command

README.md describes a calibration, docs/manual.md everything else.
"""

import os
import sys
from functools import partial

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))  # noqa: PTH100, PTH120 - missing where PYTHONSAFEPATH is set
from tools.checkout import require_python

if __name__ == "__main__":
    require_python()
    from tools import launch  # an older Python could not read it

    sys.exit(launch.run(partial(launch.start, __doc__)))
