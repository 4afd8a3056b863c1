"""Fits of a camera to its white image and to pictures of checkerboards."""
