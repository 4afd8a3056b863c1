"""The program examined: speed against error, and hard cases."""
