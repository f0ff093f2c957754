"""The part's surface: meshes read and checked, nearest points in a metric, a flat layout laid on it."""
