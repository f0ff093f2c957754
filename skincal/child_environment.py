"""Environment variables of child processes: the program's own are protected, those that the operator names are not."""

from __future__ import annotations

import os

SAFE_PATH_VARIABLE = "PYTHONSAFEPATH"
"""Python's variable: modules of the working folder and of the script's folder are not imported."""
OPERATOR_VALUE_VARIABLE = "SKINCAL_OPERATOR_PYTHONSAFEPATH"
"""The operator's value of the variable above; empty if it is not set."""


def protect_children() -> None:
    """Keep Python processes that start later from importing files of the working folder; remember the operator's value."""
    os.environ.setdefault(OPERATOR_VALUE_VARIABLE, os.environ.get(SAFE_PATH_VARIABLE, ""))
    os.environ[SAFE_PATH_VARIABLE] = "1"


def operator_environment() -> dict[str, str]:
    """Return the environment for a command of the operator: as before `protect_children`.

    A script may import modules of its own folder.
    """
    environment = dict(os.environ)
    value = environment.pop(OPERATOR_VALUE_VARIABLE, None)
    if value is not None:
        environment[SAFE_PATH_VARIABLE] = value  # empty counts as not set
    return environment
