"""Scenes with media that bend light, and rays through them by `lf.trace`, in the frame of a medium."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

import lfmesh as lf

Array = NDArray[np.float64]
Tables = dict[str, Any]

NM = 587.6
POSE: Tables = {"position_mm": (300.0, -200.0, -4000.0), "rotation_deg": (20.0, -35.0, 50.0)}
"""Pose of a medium that is in no way aligned with the camera."""

PIXEL_MM = 0.02
FOCAL_MM, FOCUS_MM = 50.0, 4000.0


def camera(semi_mm: float = 1.0, pixels: int = 4, pixel_mm: float = PIXEL_MM) -> Tables:
    """Return a camera with an ideal lens, which is its own stop."""
    lens = {"paraxial": True, "focal_length_mm": FOCAL_MM, "semi_diameter_mm": semi_mm, "stop": True}
    sensor = {"pixels": (pixels, pixels), "pixel_mm": pixel_mm}
    return {"focus_mm": FOCUS_MM, "lens": {"surfaces": [lens]}, "sensor": sensor}


def box_of(size_mm: ArrayLike, **keys: Any) -> Tables:
    """Return a medium in a box about its own origin."""
    size = np.broadcast_to(np.asarray(size_mm, np.float64), (3,)).tolist()
    return {"bounds": {"kind": "box", "size_mm": size}, **POSE, **keys}


def grid_of(folder: Path, spacing_mm: ArrayLike, **arrays: Array) -> Tables:
    """Write a grid that is centred on the origin, and return its medium."""
    name = f"grid{len(list(folder.glob('grid*.npz')))}.npz"
    np.savez(folder / name, spacing_mm=np.broadcast_to(spacing_mm, (3,)), **arrays)
    return {"grid": name, **POSE}


def nodes(shape: ArrayLike, spacing_mm: ArrayLike = 1.0) -> Array:
    """Return the centres of the voxels of a grid about the origin, (nx, ny, nz, 3)."""
    counts = np.broadcast_to(shape, (3,))
    at = np.moveaxis(np.indices(counts.tolist()), 0, -1) - 0.5 * (counts - 1)
    return np.asarray(at * np.broadcast_to(spacing_mm, (3,)), np.float64)


def ball_of(folder: Path, delta: float, width: float, count: int, spacing_mm: float = 1.0) -> Tables:
    """Return a Gaussian ball, n = 1 + δ exp(−r²/w²), on a cubic grid."""
    r2 = (nodes(count, spacing_mm) ** 2).sum(axis=-1)
    return grid_of(folder, spacing_mm, index=1.0 + delta * np.exp(-r2 / width**2))


def scene_of(*media: Tables, folder: Path = Path(), **changes: Any) -> lf.Scene:
    """Return a camera in front of media."""
    scene = lf.Scene(camera=camera(), media=list(media), transport={"wavelengths_nm": [NM], "threads": 1})  # type: ignore[arg-type]
    return scene.in_folder(folder).changed(changes)


def turn() -> Array:
    """Return the matrix from the frame of a medium to the world's."""
    return np.asarray(Rotation.from_euler("xyz", POSE["rotation_deg"], degrees=True).as_matrix(), np.float64)


def in_world(points: ArrayLike) -> Array:
    """Return points in the frame of a medium as points of the world."""
    return np.asarray(np.asarray(points, np.float64) @ turn().T + POSE["position_mm"], np.float64)


@dataclass(frozen=True)
class Sent:
    """Ends of rays, one for each ray, in the frame of a medium.

    Attributes
    ----------
    at, along : (n, 3) float64
        Points, mm, and unit directions.
    weight : (n,) float64
    paths : Paths
    """

    at: Array
    along: Array
    weight: Array
    paths: lf.Paths


def sent(world: lf.World, points: ArrayLike, directions: ArrayLike, **settings: Any) -> Sent:
    """Trace rays that are given in the frame of a medium; each must have one end.

    Parameters
    ----------
    world : World
    points, directions : (n, 3) array_like
    settings
        Of `lf.trace`.
    """
    along = np.atleast_2d(np.asarray(directions, np.float64)) @ turn().T
    paths = lf.trace(world, np.atleast_2d(in_world(points)), along, **{"split": "transmit", **settings})
    np.testing.assert_array_equal(paths.source, np.arange(len(along)))
    assert not paths.ledger.lost_share
    assert abs(paths.ledger.imbalance) < 1e-12
    at = (paths.position - POSE["position_mm"]) @ turn()
    return Sent(at, paths.direction @ turn(), paths.weight, paths)


def assert_on_lines(ends: Sent, points: ArrayLike, directions: ArrayLike, within_mm: float, within: float) -> None:
    """Compare the lines behind a field with closed forms.

    Parameters
    ----------
    ends : Sent
    points, directions : (n, 3) array_like
        A point of each true line, mm, and its unit direction.
    within_mm, within : float
        Largest distance between the lines at the points, and largest error of a direction.
    """
    along = np.asarray(directions, np.float64)
    np.testing.assert_allclose(ends.along, along, rtol=0.0, atol=within)
    apart = np.linalg.norm(np.cross(np.asarray(points) - ends.at, along), axis=1)
    assert apart.max() < within_mm, apart


def from_sines(sines: ArrayLike) -> Array:
    """Return unit directions along +z with given components along x and y, (n, 3)."""
    across = np.asarray(sines, np.float64).reshape(-1, 2)
    return np.column_stack([across, np.sqrt(1.0 - (across**2).sum(axis=1))])


def entered(points: ArrayLike, directions: ArrayLike, square: Any) -> Array:
    """Return position and T behind a face across z, (n, 6): the components of T along the face are those in air.

    Parameters
    ----------
    points, directions : (n, 3) array_like
        On the face, mm, and in air.
    square : callable
        From points (n, 3) to n².
    """
    at, along = (np.array(part, np.float64).reshape(-1, 3) for part in (points, directions))
    along[:, 2] = np.sqrt(square(at) - (along[:, :2] ** 2).sum(axis=1))
    return np.hstack([at, along])
