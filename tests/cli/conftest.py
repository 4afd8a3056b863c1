"""The camera of the scenes that commands are given: a biconvex lens, an array of 4 × 4 lenslets."""

CAMERA = """
schema_version = 1
[camera]
focus_mm = 500.0
[camera.lens]
surfaces = [
  { stop = true, thickness_mm = 1.0, semi_diameter_mm = 5.0 },
  { radius_mm = 50.0, thickness_mm = 4.0, index = 1.5, semi_diameter_mm = 8.0 },
  { radius_mm = -50.0, thickness_mm = 0.0, semi_diameter_mm = 8.0 },
]
[camera.mla]
count = [4, 4]
pitch_mm = 0.125
focal_length_mm = 0.7
index = 1.5
thickness_mm = 0.3
[camera.sensor]
pixels = [40, 40]
pixel_mm = 0.0125
"""
