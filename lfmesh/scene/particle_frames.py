"""Frames of a scene with moving particles: the scene some frames later, and the truth of an image pair."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import FileError, SceneError
from lfmesh.scene.light.particles import PLACE, VECTOR, displacements, particle_places
from lfmesh.scene.model import format_path
from lfmesh.scene.motion import is_moving
from lfmesh.scene.scene import Scene

Array = NDArray[np.float64]


def displaced(scene: Scene, frames: int = 1) -> Scene:
    """Return the scene some frames later: particles with a displacement have moved once per frame.

    Parameters
    ----------
    scene : Scene
    frames : int
        0 or more.

    Returns
    -------
    Scene

    Raises
    ------
    SceneError
        No particle moves, or something else moves, too.
    """
    moving = [i for i, group in enumerate(scene.particles) if group.displacement is not None]
    if not moving:
        raise SceneError("none of the scene's particles moves: give [[particles]] a displacement")
    for where, thing in scene.things_with_motion():
        if is_moving(thing):
            raise SceneError(f"{format_path(where)}: frames move particles alone, all else stays as at t = 0; omit it")
    return scene.changed({f"particles[{i}].frame": scene.particles[i].frame + frames for i in moving})


def particle_vectors(scene: Scene) -> tuple[Array, Array]:
    """Return the positions of all particles and their displacements to the next frame.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    points, steps : (n, 3) float64, mm
        World frame, in the order of the scene, dark particles included.

    Raises
    ------
    FileError
        A file cannot be used.
    """
    points = [particle_places(group, scene)[0] for group in scene.particles]
    steps = [displacements(group, p, scene) for group, p in zip(scene.particles, points, strict=True)]
    return np.concatenate([np.zeros((0, 3)), *points]), np.concatenate([np.zeros((0, 3)), *steps])


def write_vectors(path: Path, points: Array, steps: Array) -> None:
    """Write positions and displacements as CSV, in the columns that `displacement = { kind = "file" }` reads.

    Parameters
    ----------
    path : Path
    points, steps : (n, 3) float64, mm
        World frame.

    Raises
    ------
    FileError
        The file cannot be written.
    """
    try:
        table = np.hstack([points, steps])
        np.savetxt(path, table, delimiter=",", fmt="%.9g", header=",".join((*PLACE, *VECTOR)), comments="")
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from None
