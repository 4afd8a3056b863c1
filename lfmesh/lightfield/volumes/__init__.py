"""Emitting volumes: the projection matrix of a camera, and reconstruction by it."""
