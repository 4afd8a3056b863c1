"""The layout drawing of a camera."""
