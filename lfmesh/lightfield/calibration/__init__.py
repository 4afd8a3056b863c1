"""White images, and the places of micro-images."""
