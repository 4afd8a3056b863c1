"""Viewer as a web page: 3D view, path table, filter and light field, served by trame on loopback."""

from lfmesh.view.browser.server import refuse_to_serve, serve

__all__ = ["refuse_to_serve", "serve"]
