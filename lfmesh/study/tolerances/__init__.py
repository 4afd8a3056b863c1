"""Ready-made studies of installation and manufacturing errors."""
