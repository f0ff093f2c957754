"""Taxel positions from contacts: evidence per taxel, the free and the surface method, uncertainty."""
