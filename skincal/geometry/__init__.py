"""Rotations and poses, the wrench and its force axis, the arm."""
