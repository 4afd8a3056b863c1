"""Transport settings: method, accuracy and effort."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import Field

from lfmesh.optics.curve import LONGEST_NM, SHORTEST_NM
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import Count, Flag, Positive, Whole

PRIMARY_NM = 587.6
"""Default wavelength of a scene: the d line of helium."""

MOST_EVENTS = 2**15 - 1
"""Largest event count of a packet, in 16 bits."""
MOST_THREADS = 1024
MOST_REPLICATES = 10_000
"""Maximum number of replicates; each is a pass over all pixels with at least one sample."""

REPLICATES, REPLICATES_OF_IMAGE_PATH = 8, 4
"""Default number of replicates. With split = "transmit" there are fewer, with more samples each, because each replicate
is one Sobol' set."""


def _usual_replicates(before: dict[str, Any]) -> int:
    """Return the default number of replicates, given the preceding fields."""
    return REPLICATES_OF_IMAGE_PATH if before["split"] == "transmit" else REPLICATES


class Tessellation(Model):
    """Tessellation of the lens's surfaces.

    Without a tolerance the scene determines the meshes. With `exact` they are as coarse as the smallest gap between two
    surfaces allows; with other levels their estimated error at the sensor is below a tenth of a pixel.
    """

    sag_mm: Positive | None = None
    """Largest distance between surface and mesh along the axis, in mm."""
    normal_mrad: Positive | None = None
    """Largest rms error of the normals that refract the rays, in mrad."""


class Transport(Model):
    """The settings of a render."""

    method: Literal["adjoint", "forward"] = "adjoint"
    """Direction of the tracing: "adjoint" from the sensor to the lights, "forward" from the lights to the sensor."""
    engine: Literal["auto", "mesh", "sequential"] = "auto"
    """Tracer: "mesh" (Embree) takes everything, "sequential" the image path only, "auto" the fastest that supports the
    scene. "auto" may split the work: the image path in one, reflections in the other."""
    surface: Literal["flat", "smooth", "patch", "exact"] = "exact"
    """Surface behind a facet: flat, flat with smooth normals, a curved patch, or the analytic surface. With "exact",
    opaque spheres, cylinders and disks of `[[targets]]` are exact too; otherwise they are fine meshes."""
    tessellation: Tessellation = Field(default_factory=Tessellation)
    """Fineness of the lens's meshes."""
    split: Literal["both", "roulette", "transmit"] = "both"
    """Rays to follow at an interface: both children, one chosen at random, or only the refracted one."""
    samples: Count = 64
    """Samples per pixel over all replicates; the forward method traces samples · pixels packets. Rounded up to a
    multiple of `replicates`."""
    replicates: Annotated[Count, Field(le=MOST_REPLICATES)] = Field(default_factory=_usual_replicates)
    """Independent randomisations that share the samples; their spread is the standard error. With
    `camera.sensor.bands`, more than 8 are combined into 8 independent groups for this. Omitted: 8, or 4 with
    `split = "transmit"`."""
    target_error: Annotated[Positive, Field(lt=1)] | None = None
    """Target of the relative standard error (no unit) for a second stage, which adds samples to noisy pixels. Needs
    `method = "adjoint"`."""
    max_samples: Count = 4096
    """Largest total number of samples per pixel with `target_error`."""
    max_events: Annotated[Count, Field(le=MOST_EVENTS)] = 64
    """Largest number of surfaces that a packet meets before it is terminated."""
    polarisation: Flag = False
    """Stokes vectors through lens, array and glass; coatings must be layers. Targets depolarise. Traced by the mesh
    engine."""
    diffraction: Literal["none", "lenslets", "stop"] = "none"
    """Diffraction at each lenslet, or at the stop of a camera without array. "lenslets": light that passes a lenslet is
    deflected at random, by the Fraunhofer pattern of its aperture. This is right to some per cent for extended light,
    but not for points, whose waves interfere between lenslets. "stop": at the lens's stop, for cameras without an
    array, along the image path (split = "transmit"). With either, particles are not traced but imaged by point spreads.
    Rays that you supply are traced without it."""
    weight_cutoff: Annotated[float, Field(strict=True, ge=0, le=1)] = 0.3
    """Share of its starting weight below which a child plays Russian roulette (no unit). The reference is the weight of
    a ray aimed at a lenslet; unaimed rays weigh far more."""
    wavelengths_nm: tuple[Annotated[float, Field(strict=True, ge=SHORTEST_NM, le=LONGEST_NM)], ...] = Field(
        default=(PRIMARY_NM,), min_length=1
    )
    """Wavelength of each channel, in nm; the middle one is the primary. Not used with `camera.sensor.bands`."""
    seed: Whole = 0
    """Seed of the random numbers."""
    threads: Annotated[Whole, Field(le=MOST_THREADS)] = 0
    """Number of threads; 0: all there are. The result does not depend on it."""

    @property
    def samples_each(self) -> int:
        """Samples per pixel in each replicate."""
        return -(-self.samples // self.replicates)

    def faults(self) -> Iterator[Fault]:
        """Yield faults that rule out refinement, and duplicate wavelengths."""
        if self.target_error is not None:
            yield from self._unfit_for_refinement(self.target_error)
        if len(set(self.wavelengths_nm)) < len(self.wavelengths_nm):
            yield Fault(("wavelengths_nm",), list(self.wavelengths_nm), "must not contain a wavelength twice")

    def _unfit_for_refinement(self, target_error: float) -> Iterator[Fault]:
        """Yield settings that rule out a target error."""
        if self.method == "forward":
            yield Fault(
                ("target_error",),
                target_error,
                'needs method = "adjoint": the forward method cannot give single pixels more samples',
            )
        if self.replicates < 2:
            yield Fault(
                ("replicates",), self.replicates, "must be 2 or more with target_error: their spread gives the error"
            )
        every = self.samples_each * self.replicates
        if self.max_samples < every:
            rounded = "" if every == self.samples else f", rounded up to {every}"
            yield Fault(
                ("max_samples",),
                self.max_samples,
                f"must be at least samples = {self.samples}{rounded}, which every pixel gets",
            )
