"""The 3D view: the only drawing code, and the only place that imports VTK and pyvistaqt.

`view` is what the window uses, and importing it loads neither library; `offscreen` is what the headless commands use. A `stage`
holds the layers of a scene and `camera` says from where they are seen; what they draw from is in `scene_state`.
"""
