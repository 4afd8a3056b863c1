"""White images, and centres of micro-images."""
