"""Media in front of the camera, and air."""
