"""Sizes of an ordinary rig's errors, SI units: prior of a correction, and errors of the simulated rig (`docs/noise.md`)."""

import math

MATRIX_ERROR_SD = 0.02
"""sd of each entry of E in measured = (I + E) true of the F/T sensor, cross-talk between force and moment included. 2 % is the
case measured on this project's synthetic rig."""
FORCE_TO_MOMENT_LENGTH_M = 0.35
"""The entries of E between force and moment count a moment in units of force x this length. The 2 % come without it; this one
brings out the paper's errors (its seven poses averaged: 7.2 mm free, 6.6 mm on the surface)."""
ARM_POSE_TURN_SD_RAD = math.radians(1.0)
"""sd of the turn of each arm pose about each axis through the sensor. The case measured on this project's synthetic rig; a
joint's error turns the part about the joint, nearer to the sensor than to the skin."""
ARM_POSE_SHIFT_SD_M = 0.002
"""sd of the shift of each arm pose along each axis. Same case."""
