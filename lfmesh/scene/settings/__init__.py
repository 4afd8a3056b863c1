"""Settings of a render."""
