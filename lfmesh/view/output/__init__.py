"""Where a 3D scene goes: a window, an HTML page, a glTF model."""
