"""Targets, bodies of glass and tanks before the camera."""
