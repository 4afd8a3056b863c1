"""Sources of packets: pixels, lights and emitting targets, and given rays."""
