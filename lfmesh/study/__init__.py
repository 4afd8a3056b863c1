"""Studies: many cameras against a reference, and kinds of camera side by side."""
