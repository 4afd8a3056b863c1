"""Media that bend light as a camera sees them: grids that are too coarse, and the size of a pixel at each field."""

import math
from collections.abc import Iterator, Sequence

from lfmesh.errors import CoarseFieldWarning
from lfmesh.geometry import frame
from lfmesh.scene import FirstOrder, Scene
from lfmesh.transport.tables.bending_fields import FieldMedium


def coarse_fields(media: Sequence[FieldMedium]) -> Iterator[CoarseFieldWarning]:
    """Yield a warning for each grid that is too coarse for its deflection.

    Parameters
    ----------
    media : sequence of FieldMedium
    """
    for each in media:
        if not each.medium.formulas and (why := each.probe.fault()) is not None:
            yield CoarseFieldWarning(f"{each.medium.name}: {why}")


def pixel_sizes(media: Sequence[FieldMedium], scene: Scene, facts: FirstOrder) -> list[float]:
    """Return the size of a pixel at the near end of each medium that bends light, mm.

    Parameters
    ----------
    media : sequence of FieldMedium
    scene : Scene
        Solved.
    facts : FirstOrder
    """
    sensor = scene.camera.sensor
    sizes = []
    for each in media:
        wide = facts.field.size_mm(-max(near_end_mm(each, scene), 0.0))
        own = [abs(wide[axis]) / sensor.size_mm[axis] for axis in range(2)]
        known = [size for size in own if 0.0 < size < math.inf]
        sizes.append(sensor.pixel_mm * min(known, default=1.0))
    return sizes


def near_end_mm(each: FieldMedium, scene: Scene) -> float:
    """Return the distance of the near end of a field before the first vertex.

    Parameters
    ----------
    each : FieldMedium
    scene : Scene
        Solved.
    """
    return float(-corners_in_camera(each, scene)[:, 2].max())


def corners_in_camera(each: FieldMedium, scene: Scene) -> frame.Frame:
    """Return the corners of the box of a field, (8, 3) mm, camera frame.

    Parameters
    ----------
    each : FieldMedium
    scene : Scene
        Solved.
    """
    return frame.points(from_world(scene), each.medium.corners_mm())


def from_world(scene: Scene) -> frame.Frame:
    """Return the world as seen from the camera, (3, 4)."""
    pose = scene.camera.pose
    return frame.inverse(frame.frame(pose.tilt_deg, pose.shift_mm))
