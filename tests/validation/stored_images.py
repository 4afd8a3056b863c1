"""Image sizes that OpticStudio stores in its files, and the rays that reach them."""

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import lfmesh as lf


class Sample(NamedTuple):
    """Prescription, and how its image was measured."""

    text: str
    image_mm: float
    """Distance of the image behind the last surface."""
    stored_mm: float
    pupil_mm: float
    """Radius of the entrance pupil."""
    pupil_at_mm: float
    """Distance of the entrance pupil behind the first surface."""
    object_mm: float
    fields: tuple[tuple[float, float], ...]
    """Heights x and y of the object in mm, or angles in degrees for one at infinity."""
    edges: tuple[tuple[float, float], ...] = ((0.0, 1.0), (0.0, -1.0))
    """Points x and y of the entrance pupil, over its radius."""


HEAD = "MODE SEQ\nUNIT MM\n{aperture}\nGCAT SCHOTT\nFTYP {kind} 0 1 {waves} 0 0 0\nYFLN 0\n"
OBJECT = "SURF 0\n  TYPE STANDARD\n  DISZ {distance}\n"


def text_of(aperture: float | str, waves: list[float], distance: str, *surfaces: str) -> str:
    """Return a Zemax file.

    Parameters
    ----------
    aperture : float or str
        Diameter of the entrance pupil, or a line that gives the aperture.
    waves : list of float
        Wavelengths, µm.
    distance : str
        Of the object: a number or "INFINITY".
    *surfaces : str
        Lines of each surface between the object and the image.

    Returns
    -------
    str
    """
    given = aperture if isinstance(aperture, str) else f"ENPD {aperture}"
    head = HEAD.format(aperture=given, kind=0 if distance == "INFINITY" else 1, waves=len(waves))
    lines = [f"WAVM {k} {um} 1" for k, um in enumerate(waves, 1)]
    numbered = [f"SURF {k}\n  {text}\n" for k, text in enumerate((*surfaces, "TYPE STANDARD\n  DISZ 0"), 1)]
    return head + "\n".join([*lines, "PWAV 1\n"]) + OBJECT.format(distance=distance) + "".join(numbered)


def rays(sample: Sample) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the marginal rays of a sample, 10 mm or more before the first surface."""
    starts, directions = [], []
    for field, edge in itertools.product(sample.fields, sample.edges):
        target = np.array([*(sample.pupil_mm * np.array(edge)), sample.pupil_at_mm])
        if math.isinf(sample.object_mm):
            direction = np.array([*np.tan(np.radians(field)), 1.0])
        else:
            direction = target - [*field, -sample.object_mm]
        direction /= np.linalg.norm(direction)
        starts.append(target - (10.0 + sample.pupil_at_mm) / direction[2] * direction)
        directions.append(direction)
    return np.array(starts), np.array(directions)


def largest_height(world: lf.World, sample: Sample, wavelength_nm: float, **options: Any) -> float:
    """Return the largest height on the sensor of the marginal rays, all of which must arrive.

    Parameters
    ----------
    world : World
    sample : Sample
    wavelength_nm : float
    **options
        For `lf.trace`.

    Returns
    -------
    float
        mm.
    """
    starts, directions = rays(sample)
    paths = lf.trace(world, starts, directions, wavelength_nm=wavelength_nm, split="transmit", **options)
    landed = paths.status == lf.Status.SENSOR
    assert sorted(paths.source[landed]) == list(range(len(starts)))
    return float(np.hypot(*paths.position[landed, :2].T).max())
