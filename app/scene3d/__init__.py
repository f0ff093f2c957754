"""The 3D view: the only drawing code, and the only place that imports VTK and pyvistaqt.

`view` is what the window uses and `offscreen` what the headless commands use; importing them loads neither library.
A `stage` holds the layers of a scene, one a file: `surface`, `modules`, `estimates`, `axes`, `uncertainty`, `target`, `scale`.
"""
