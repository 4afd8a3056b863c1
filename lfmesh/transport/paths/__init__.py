"""Paths: their states and classes."""
