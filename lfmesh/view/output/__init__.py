"""Outputs of a 3D scene: a window, an HTML page, a glTF model."""
