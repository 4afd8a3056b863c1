"""From a scene to an image: sources, classes of paths, adaptive sampling, both methods."""
