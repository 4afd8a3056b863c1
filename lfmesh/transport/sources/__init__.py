"""Packet sources: pixels, lights and emitting targets, particles, and given rays."""
