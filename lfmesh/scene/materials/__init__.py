"""Glasses, coatings and finishes of surfaces and bodies."""
