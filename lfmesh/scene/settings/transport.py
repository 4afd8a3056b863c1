"""Transport settings: method, accuracy and effort."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import Field

from lfmesh.optics.curve import LONGEST_NM, SHORTEST_NM
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import Count, Flag, Positive, Whole

PRIMARY_NM = 587.6
"""Wavelength of a scene that gives none: the d line of helium."""

MOST_EVENTS = 2**15 - 1
"""Largest count of a packet, in 16 bits."""
MOST_THREADS = 1024
MOST_REPLICATES = 10_000
"""Each replicate is a pass over all pixels, of at least one sample."""

REPLICATES, REPLICATES_OF_IMAGE_PATH = 8, 4
"""Replicates of a scene that gives none; with split = "transmit" few of many samples, because a replicate's points are
one Sobol' set."""


def _usual_replicates(before: dict[str, Any]) -> int:
    """Return the replicates of a scene that gives none, by the fields before."""
    return REPLICATES_OF_IMAGE_PATH if before["split"] == "transmit" else REPLICATES


class Tessellation(Model):
    """Tessellation of the lens's surfaces.

    Without a tolerance the meshes follow the scene. With `exact` they are as coarse as the smallest gap between two
    surfaces allows. With the other levels their estimated error at the sensor is below a tenth of a pixel.
    """

    sag_mm: Positive | None = None
    """Largest distance between surface and mesh along the axis, in mm."""
    normal_mrad: Positive | None = None
    """Largest rms error of the normals that bend the rays, in mrad."""


class Transport(Model):
    """The settings of a render."""

    method: Literal["adjoint", "forward"] = "adjoint"
    """Direction of the tracing: "adjoint" from the sensor to the lights, "forward" from the lights to the sensor."""
    engine: Literal["auto", "mesh", "sequential"] = "auto"
    """Tracer: "mesh" (Embree) takes everything, "sequential" the image path only, "auto" the fastest that supports the
    scene. "auto" may take the image path with the one and the reflections with the other."""
    surface: Literal["flat", "smooth", "patch", "exact"] = "exact"
    """Surface behind a facet: flat, flat with smooth normals, a curved patch, or the analytic surface. Opaque spheres,
    cylinders and disks of `[[targets]]` are exact with "exact", else fine meshes."""
    tessellation: Tessellation = Field(default_factory=Tessellation)
    """Fineness of the lens's meshes."""
    split: Literal["both", "roulette", "transmit"] = "both"
    """At an interface follow both children, one of them by chance, or the refracted one alone."""
    samples: Count = 64
    """Samples per pixel, in all replicates; forward traces samples · pixels packets in all. Rounded up to a multiple of
    `replicates`."""
    replicates: Annotated[Count, Field(le=MOST_REPLICATES)] = Field(default_factory=_usual_replicates)
    """Independent randomisations that share the samples; their spread is the standard error. With `camera.sensor.bands`
    more than 8 form 8 independent groups, whose spread it is. Omitted: 8, or 4 with `split = "transmit"`."""
    target_error: Annotated[Positive, Field(lt=1)] | None = None
    """Relative standard error (no unit) as the goal of a second stage, which adds samples to noisy pixels. Needs
    `method = "adjoint"`."""
    max_samples: Count = 4096
    """Largest number of samples per pixel, in all, with `target_error`."""
    max_events: Annotated[Count, Field(le=MOST_EVENTS)] = 64
    """Largest number of surfaces that a packet meets before it is cut."""
    polarisation: Flag = False
    """Stokes vectors through lens, array and glass; coatings are layers. Targets depolarise. Traced by the mesh
    engine."""
    diffraction: Literal["none", "lenslets", "stop"] = "none"
    """Diffraction at each lenslet, or at the stop of a camera without array. "lenslets": light that passes a lenslet
    turns by chance, by the Fraunhofer pattern of its aperture. Right to some per cent for extended light; not for
    points, whose waves interfere between lenslets. "stop": at the lens's stop, of cameras without an array, along the
    image path (split = "transmit"). With either, particles are not traced but pictured by point spreads. Rays that are
    given are traced without it."""
    weight_cutoff: Annotated[float, Field(strict=True, ge=0, le=1)] = 0.3
    """Share of its starting weight below which a child plays Russian roulette (no unit). A ray that is not aimed at a
    lenslet weighs far more than one that is; the latter's weight counts."""
    wavelengths_nm: tuple[Annotated[float, Field(strict=True, ge=SHORTEST_NM, le=LONGEST_NM)], ...] = Field(
        default=(PRIMARY_NM,), min_length=1
    )
    """Wavelength of each channel, in nm; the middle one is the primary. Not used with `camera.sensor.bands`."""
    seed: Whole = 0
    """Seed of the random numbers."""
    threads: Annotated[Whole, Field(le=MOST_THREADS)] = 0
    """Threads; 0: all there are. The result is the same for any number."""

    @property
    def samples_each(self) -> int:
        """Samples of a pixel in each replicate."""
        return -(-self.samples // self.replicates)

    def faults(self) -> Iterator[Fault]:
        """Yield what keeps pixels from being refined, and wavelengths given twice."""
        if self.target_error is not None:
            yield from self._unfit_for_refinement(self.target_error)
        if len(set(self.wavelengths_nm)) < len(self.wavelengths_nm):
            yield Fault(("wavelengths_nm",), list(self.wavelengths_nm), "must not hold a wavelength twice")

    def _unfit_for_refinement(self, target_error: float) -> Iterator[Fault]:
        """Yield what keeps pixels from being sampled to a target error."""
        if self.method == "forward":
            yield Fault(
                ("target_error",),
                target_error,
                'needs method = "adjoint": forward, no pixel can be given samples of its own',
            )
        if self.replicates < 2:
            yield Fault(
                ("replicates",), self.replicates, "must be 2 or more with target_error: their spread is the error"
            )
        every = self.samples_each * self.replicates
        if self.max_samples < every:
            rounded = "" if every == self.samples else f", rounded up to {every}"
            yield Fault(
                ("max_samples",),
                self.max_samples,
                f"must not be below samples = {self.samples}{rounded}, which all pixels get",
            )
