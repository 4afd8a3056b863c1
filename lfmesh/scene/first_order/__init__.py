"""First-order optics of a scene, and the solution of its open parameters."""
