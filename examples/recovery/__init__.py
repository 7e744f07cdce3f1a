"""The parts of `recover_material.py`: the built-in scene, scene files, the fit, and the sheet of pictures."""
