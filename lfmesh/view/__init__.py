"""Seeing a scene and its rays."""
