"""The scene and its rays in 3D."""
