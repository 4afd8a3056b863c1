"""Tanks as nested bodies of glass: a box of liquid inside a box of glass."""

import numpy as np

from lfmesh.geometry.frame import rotation
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import Refractor, Scene, Tank, Target
from lfmesh.scene.materials.glass_in_air import in_its_air
from lfmesh.scene.objects.tank import OPEN_AXIS


def with_tanks(scene: Scene) -> Scene:
    """Return the scene with each tank replaced by two bodies of glass, after its targets."""
    if not scene.tanks:
        return scene
    bodies = [body for i, tank in enumerate(scene.tanks) for body in tank_bodies(tank, tank.called(i))]
    return scene.model_copy(update={"targets": (*scene.targets, *bodies), "tanks": ()})


def tank_bodies(tank: Tank, name: str) -> tuple[Target, Target]:
    """Return the walls, a solid box, and the liquid, a box inside it that displaces the glass."""
    size, wall = np.array(tank.size_mm), tank.wall_mm
    inner, centre = size - 2.0 * wall, np.zeros(3)
    axis = OPEN_AXIS.get(tank.open)
    if axis is not None:
        inner[axis] += wall
        centre[axis] = 0.5 * wall
    placed = np.array(tank.position_mm) + rotation(tank.rotation_deg) @ centre
    pieces = ((tank.wall, "wall", size, np.array(tank.position_mm)), (tank.liquid, "liquid", inner, placed))
    wall_body, liquid = (
        Target(
            name=f"{name} {part}",
            position_mm=tuple(position.tolist()),
            rotation_deg=tank.rotation_deg,
            motion=tank.motion and tank.motion.about(tank.position_mm),
            refractor=Refractor(
                box_mm=tuple(edges.tolist()),
                index=matter.index,
                glass=matter.glass,
                absorption_per_mm=matter.absorption_per_mm,
            ),
        )
        for matter, part, edges, position in pieces
    )
    return wall_body, liquid


def tank_lines(scene: Scene, object_index: float) -> list[str]:
    """Describe each tank in a line: size, media, and the apparent depth of its middle.

    The middle is halfway between the windows on the tank's own z axis; its apparent depth is first-order.
    `object_index` is the refractive index of the medium round the tanks at the primary wavelength.
    """
    lines = []
    for i, tank in enumerate(in_its_air(scene).tanks):
        n_wall, n_liquid = (refractive_index(matter.medium, scene.primary_nm) for matter in (tank.wall, tank.liquid))
        window = 0.0 if tank.open == "front" else tank.wall_mm
        depth = 0.5 * tank.size_mm[2]
        seen = object_index * (window / n_wall + (depth - window) / n_liquid)
        size = " × ".join(f"{length:g}" for length in tank.size_mm)
        state = f"open at the {tank.open}" if tank.open is not None else "closed"
        lines.append(
            f"{tank.called(i):<23}{size} mm, {state}, walls of {tank.wall_mm:g} mm (n = {n_wall:.6g}), liquid n = "
            f"{n_liquid:.6g}; its middle, {depth:g} mm behind its front, appears {seen:.6g} mm behind it"
        )
    return lines
