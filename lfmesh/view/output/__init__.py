"""Outputs of a 3D scene: window, HTML page, glTF model."""
