"""Views decoded or rendered from raw images."""
