"""Decoders: bytes in, readings out; one wire format a file.

A decoder knows no port, no clock and no thread, and how the bytes were cut never matters. It is made for a number of
channels and the streams that its link carries, and counts what it could not use.
"""
