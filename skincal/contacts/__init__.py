"""Pokes: tare, detection, and the gates that end each poke as a contact or as a rejection with its reason."""
