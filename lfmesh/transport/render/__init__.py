"""From a scene to an image: sources, path classes, adaptive sampling, both methods."""
