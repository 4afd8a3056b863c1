"""Path states and path classes."""
