"""`python -P -m skincal.cli`: the commands without the window. Without `-P` a `typer.py` of the working folder would run."""

import sys

from skincal.cli import main

sys.exit(main())
