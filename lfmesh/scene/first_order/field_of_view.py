"""The field of view at any distance, as lines along the chief rays of the picture's edges."""

import math
from typing import NamedTuple

from lfmesh.scene.camera.camera import Camera
from lfmesh.scene.first_order.paraxial import Paraxial
from lfmesh.scene.first_order.relay import Relay, seen_size_mm

UNBOUNDED = math.inf, math.inf
"""Size at the vertex and slope of a field, or beam, that the stop does not limit."""


class FieldOfView(NamedTuple):
    """Width and height of the field at a plane z before the lens, and the beam there: |at_vertex + slope z|.

    Attributes
    ----------
    at_vertex_mm : (width, height)
        At z = 0, in mm; inf if the centre of the stop is imaged onto the array or sensor.
    slope : (width, height)
        Change per mm of z; inf likewise.
    beam_at_vertex_mm, beam_slope : float
        The same for the diameter of the beam to a point of the array or sensor.
    """

    at_vertex_mm: tuple[float, float]
    slope: tuple[float, float]
    beam_at_vertex_mm: float
    beam_slope: float

    @classmethod
    def of(
        cls,
        camera: Camera,
        sections: tuple[Paraxial, Paraxial],
        planes_mm: tuple[float, float],
        stop_radius_mm: float,
        relay: Relay | None = None,
    ) -> "FieldOfView":
        """Compute the field of a solved camera.

        Parameters
        ----------
        camera : Camera
        sections : (Paraxial, Paraxial)
            The lens in the x–z and y–z sections.
        planes_mm : (float, float)
            Distances behind the last vertex of the array or sensor, and of the image of the plane in focus.
        stop_radius_mm : float
        relay : Relay, optional
            Of the camera. If its rods limit the cone of light rather than the stop, that cone is along the axis behind
            the lens, and so are the lines of the edges.
        """
        plane_mm, image_mm = planes_mm
        edges = []
        for size, lens in zip(seen_size_mm(camera, relay), sections, strict=True):
            height, before, index = lens.chief_height_mm(plane_mm), lens.to_stop, lens.indices[0]
            if relay is not None and 2.0 * stop_radius_mm * relay.f_number > abs(height):
                edge = size * lens.whole.d, -size * lens.whole.c / index
            else:
                edge = (-size * before.b / height, size * before.a / (height * index)) if height else UNBOUNDED
            edges.append(edge)
        (width, width_slope), (height, height_slope) = edges
        lens = sections[1]
        diameter, cone, reduced = 2.0 * stop_radius_mm, lens.chief_height_mm(image_mm), image_mm / lens.image_index
        if relay is not None:
            cone = max(abs(cone), diameter * relay.f_number)
        beam = UNBOUNDED
        if cone:
            beam = (
                diameter * (lens.whole.b + lens.whole.d * reduced) / cone,
                -diameter * lens.magnification_onto(image_mm) / (cone * lens.indices[0]),
            )
        return cls((width, height), (width_slope, height_slope), *beam)

    def size_mm(self, z_mm: float) -> tuple[float, float]:
        """Return width and height at a plane z; inf at infinity, unless the entrance pupil is there too."""
        width, height = (_on(*edge, z_mm) for edge in zip(self.at_vertex_mm, self.slope, strict=True))
        return width, height

    def beam_mm(self, z_mm: float) -> float:
        """Return the diameter at a plane z of the beam to a point of the array or sensor."""
        return _on(self.beam_at_vertex_mm, self.beam_slope, z_mm)

    @property
    def angles_deg(self) -> tuple[float, float]:
        """Full angles of view for distant objects, horizontal and vertical, in degrees."""
        width, height = (math.degrees(2.0 * math.atan(0.5 * abs(slope))) for slope in self.slope)
        return width, height


def _on(at_vertex: float, slope: float, z_mm: float) -> float:
    if slope == 0.0:
        return abs(at_vertex)
    if not math.isfinite(slope) or not math.isfinite(at_vertex) or not math.isfinite(z_mm):
        return math.inf
    return abs(at_vertex + slope * z_mm)
