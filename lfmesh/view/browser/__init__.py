"""The viewer as a page in a web browser: 3D view, path table, filter and light field, served by trame on loopback."""

from lfmesh.view.browser.server import serve

__all__ = ["serve"]
