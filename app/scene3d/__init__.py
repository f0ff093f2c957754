"""The 3D view: the only code that draws in 3D, and the only place that imports VTK, pyvista and pyvistaqt.

The window uses `view`; importing it loads none of these libraries. The headless commands use `session_picture`. A
`SceneRenderer` holds the layers of one scene, `camera` computes where the camera is, `scene_state` holds the values that layers
draw.
"""
