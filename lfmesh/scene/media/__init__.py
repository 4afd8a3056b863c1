"""Media that light passes through before the camera, and air."""
