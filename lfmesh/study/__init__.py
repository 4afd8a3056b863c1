"""Studies of many cameras against a reference, and comparisons of camera types."""
