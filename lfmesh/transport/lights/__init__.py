"""Lights that a point asks: each draws a way to itself, with its density; combined with scattered rays."""
