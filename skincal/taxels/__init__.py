"""Where each taxel is by its own contacts alone: the contact table, the free and the surface method, the result."""
