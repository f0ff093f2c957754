"""Decoders of formats that belong to no device, one file each; `auto_detect.py` finds the format of a link."""
