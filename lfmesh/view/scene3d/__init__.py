"""Scene and rays in 3D."""
