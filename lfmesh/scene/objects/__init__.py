"""Targets, glass bodies and tanks in front of the camera."""
