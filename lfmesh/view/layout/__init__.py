"""Layout drawings of cameras."""
