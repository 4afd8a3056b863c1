"""Volumes that emit: the projection matrix of a camera, and reconstruction by it."""
