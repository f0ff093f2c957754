"""Calibration files in and out, their lint, and recordings of other programs."""
