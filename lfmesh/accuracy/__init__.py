"""Accuracy studies: speed against error, and hard cases."""
