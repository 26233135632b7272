"""Other renderers on the same scene and camera (panel.py), each in a process of its own (*_process.py), which may be
that of another Python: those import nothing from this package that is not here, but for what they name."""
