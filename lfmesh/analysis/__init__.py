"""The main lens as a designer reads it: spots, ray fans, field curvature, colour, illumination, MTF."""
