"""First-order optics of a scene, and what a scene leaves open, solved by them."""
