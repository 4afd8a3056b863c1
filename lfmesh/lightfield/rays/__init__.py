"""Object-space rays of pixels and views."""
