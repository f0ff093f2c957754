"""Families of devices, one file each: addresses, handshake, decoder, wiring, test vectors. `registry.py` lists them."""
