"""Paraxial optics of a lens by the y-nu trace.

Heights are in mm. Angles are in rad and reduced (times the index), so that each surface and gap is a matrix of
determinant 1. Distances before and behind the lens are in mm of the medium there, and reduced (over its index) in the
formulas, which are those of W. J. Smith, Modern Optical Engineering.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

from lfmesh.optics.glass import AIR, refractive_index
from lfmesh.optics.gradient_paraxial import gap_and_sizes
from lfmesh.optics.gradient_range import OnAxis
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.camera.lens import Lens


class Ray(NamedTuple):
    """A paraxial ray at a plane, with its reduced angle."""

    height_mm: float
    angle: float


class Matrix(NamedTuple):
    """Ray transfer matrix on (height, reduced angle): y' = A y + B u, u' = C y + D u."""

    a: float
    b: float
    c: float
    d: float

    def __call__(self, ray: Ray) -> Ray:
        """Return a ray after this matrix."""
        return Ray(self.a * ray.height_mm + self.b * ray.angle, self.c * ray.height_mm + self.d * ray.angle)

    def then(self, after: "Matrix") -> "Matrix":
        """Return the matrix of this followed by `after`."""
        return Matrix(
            after.a * self.a + after.b * self.c,
            after.a * self.b + after.b * self.d,
            after.c * self.a + after.d * self.c,
            after.c * self.b + after.d * self.d,
        )

    @property
    def reversed(self) -> "Matrix":
        """The matrix for light that returns; its angles count along its own direction."""
        return Matrix(self.d, self.b, self.c, self.a)


NOTHING = Matrix(1.0, 0.0, 0.0, 1.0)

ROUNDED = 2.0**-47
"""Rounding limit of a sum, relative to the sum of its terms' magnitudes: 64 times that of one addition."""


def gap(length_mm: float, index: float = AIR) -> Matrix:
    """Return the matrix of a distance in a homogeneous medium."""
    return Matrix(1.0, length_mm / index, 0.0, 1.0)


class GradientGap(NamedTuple):
    """A gap of gradient-index glass.

    Attributes
    ----------
    matrix, size : Matrix
        From vertex to vertex, and the magnitudes to which rounding of its elements is relative.
    end_index : float
        Index on the axis at the second vertex.
    """

    matrix: Matrix
    size: Matrix
    end_index: float


@lru_cache(maxsize=256)
def gradient_gap(gradient: Gradient, wavelength_nm: float, length_mm: float, section_x: bool = False) -> GradientGap:
    """Return the paraxial optics of a gap of gradient-index glass.

    Parameters
    ----------
    gradient : Gradient
    wavelength_nm : float
    length_mm : float
        Distance between the vertices.
    section_x : bool
        Use the x–z section in place of y–z.

    Raises
    ------
    GlassError
        The index on the axis is not between 1 and 10, or changes too fast.
    """
    gradient.check_within(wavelength_nm, OnAxis(length_mm))
    end_index = gradient.index_on_axis(wavelength_nm, length_mm)
    matrix, size = gap_and_sizes(gradient.profile(wavelength_nm), length_mm, section_x=section_x)
    return GradientGap(Matrix(*matrix), Matrix(*size), end_index)


@dataclass(frozen=True)
class Paraxial:
    """A lens at one wavelength.

    Attributes
    ----------
    curvatures : tuple of float, 1/mm
        One per surface.
    gaps_mm : tuple of float
        Distances between successive vertices.
    indices : tuple of float
        Before the first surface and after each, at its vertex.
    stop : int
        Number of the stop surface.
    thin_powers : tuple of float, 1/mm
        Powers of thin lenses and of phases, 0 for other surfaces; empty if there are none.
    gradients : tuple of GradientGap or None
        Gaps of gradient-index glass, None for homogeneous ones; empty if there are none.
    """

    curvatures: tuple[float, ...]
    gaps_mm: tuple[float, ...]
    indices: tuple[float, ...]
    stop: int
    thin_powers: tuple[float, ...] = ()
    gradients: tuple[GradientGap | None, ...] = ()

    @classmethod
    def of(cls, lens: Lens, wavelength_nm: float, *, section_x: bool = False) -> "Paraxial":
        """Read a prescription; without a marked stop, the first surface is the stop.

        Parameters
        ----------
        lens : Lens
        wavelength_nm : float
        section_x : bool
            Use the x–z section in place of y–z; they differ only without rotational symmetry.
        """
        gaps = tuple(surface.thickness_mm or 0.0 for surface in lens.surfaces[:-1])
        gradients = tuple(
            None if surface.gradient is None else gradient_gap(surface.gradient, wavelength_nm, length, section_x)
            for surface, length in zip(lens.surfaces, gaps, strict=False)
        )
        return cls(
            curvatures=tuple(
                surface.curvature_x_per_mm if section_x else surface.curvature_per_mm for surface in lens.surfaces
            ),
            gaps_mm=gaps,
            indices=tuple(refractive_index(medium, wavelength_nm) for medium in lens.media),
            stop=lens.stop_index or 0,
            thin_powers=tuple(
                surface.added_power_per_mm(wavelength_nm, section_x=section_x) for surface in lens.surfaces
            ),
            gradients=gradients if any(gradients) else (),
        )

    def index_before(self, number: int) -> float:
        """Refractive index right before the vertex of surface `number`."""
        gradient = self.gradients[number - 1] if number and self.gradients else None
        return self.indices[number] if gradient is None else gradient.end_index

    def gap(self, number: int) -> Matrix:
        """Matrix from the vertex of surface `number` to the next."""
        gradient = self.gradients[number] if self.gradients else None
        return gap(self.gaps_mm[number], self.indices[number + 1]) if gradient is None else gradient.matrix

    def _gap_size(self, number: int) -> Matrix:
        """Matrix of a gap with the magnitude of every term."""
        gradient = self.gradients[number] if self.gradients else None
        return gap(abs(self.gaps_mm[number]), self.indices[number + 1]) if gradient is None else gradient.size

    def refraction(self, number: int) -> Matrix:
        """Matrix of surface `number` alone."""
        power = (self.indices[number + 1] - self.index_before(number)) * self.curvatures[number]
        if self.thin_powers:
            power += self.thin_powers[number]
        return Matrix(1.0, 0.0, -power, 1.0)

    def _refraction_size(self, number: int) -> Matrix:
        """Matrix of surface `number` with the magnitude of every term."""
        power = (self.indices[number + 1] + self.index_before(number)) * abs(self.curvatures[number])
        if self.thin_powers:
            power += abs(self.thin_powers[number])
        return Matrix(1.0, 0.0, power, 1.0)

    def heights_mm(self, ray: Ray) -> list[float]:
        """Return the heights at all surfaces of a ray given at the first vertex."""
        return [each.height_mm for each in self.rays_behind(ray)]

    def rays_behind(self, ray: Ray) -> list[Ray]:
        """Return a ray given at the first vertex as it is right behind each surface."""
        behind = []
        for number in range(len(self.curvatures)):
            if number:
                ray = self.gap(number - 1)(ray)
            ray = self.refraction(number)(ray)
            behind.append(ray)
        return behind

    def reflected_twice(self, first: int, second: int) -> Matrix:
        """Matrix from the first vertex to just behind the last, for light reflected at two surfaces.

        Parameters
        ----------
        first, second : int
            Numbers of the surfaces in the order of reflection: first > second.
        """
        matrix = self._run(0, first, last_refracts=False).then(self._reflection(first, from_front=True))
        for number in range(first - 1, second - 1, -1):
            matrix = matrix.then(self.gap(number).reversed)
            if number > second:
                # Returning light is refracted like forward light: sides and direction change sign together.
                matrix = matrix.then(self.refraction(number))
        matrix = matrix.then(self._reflection(second, from_front=False))
        if second + 1 < len(self.curvatures):
            on = self._run(second + 1, len(self.curvatures) - 1)
            matrix = matrix.then(self.gap(second)).then(on)
        return matrix

    def _reflection(self, number: int, *, from_front: bool) -> Matrix:
        """Matrix of a reflection at surface `number`; angles are counted along the direction of the light."""
        index = self.index_before(number) if from_front else -self.indices[number + 1]
        return Matrix(1.0, 0.0, 2.0 * index * self.curvatures[number], 1.0)

    @cached_property
    def to_stop(self) -> Matrix:
        """Matrix from the first vertex to just before the stop surface."""
        return self._run(0, self.stop, last_refracts=False)

    @cached_property
    def from_stop(self) -> Matrix:
        """Matrix from just before the stop surface to just behind the last vertex."""
        return self._run(self.stop, len(self.curvatures) - 1)

    @cached_property
    def whole(self) -> Matrix:
        """Matrix from the first vertex to just behind the last."""
        return self.to_stop.then(self.from_stop)

    @cached_property
    def _sizes(self) -> tuple[Matrix, Matrix]:
        """`to_stop` and `from_stop` with the magnitudes of all terms added; rounding is proportional to these."""
        return self._run(0, self.stop, last_refracts=False, size=True), self._run(
            self.stop, len(self.curvatures) - 1, size=True
        )

    @cached_property
    def _whole_size(self) -> Matrix:
        return self._sizes[0].then(self._sizes[1])

    def _run(self, first: int, last: int, last_refracts: bool = True, size: bool = False) -> Matrix:
        refraction, between = (self._refraction_size, self._gap_size) if size else (self.refraction, self.gap)
        matrix = NOTHING
        for number in range(first, last):
            matrix = matrix.then(refraction(number)).then(between(number))
        return matrix.then(refraction(last)) if last_refracts else matrix

    @property
    def image_index(self) -> float:
        """Refractive index behind the last surface."""
        return self.indices[-1]

    @property
    def length_mm(self) -> float:
        """Distance from the first vertex to the last."""
        return sum(self.gaps_mm)

    @property
    def efl_mm(self) -> float:
        """Effective focal length, 1 over the power; inf for an afocal lens.

        Times the index of a medium, it is the focal length on that medium's side.
        """
        return _ratio(-1.0, self.whole.c, self._whole_size.c)

    @property
    def bfl_mm(self) -> float:
        """Distance from the last vertex to the rear focal point; inf for an afocal lens."""
        return self.image_index * _ratio(-self.whole.a, self.whole.c, self._whole_size.c)

    @property
    def ffl_mm(self) -> float:
        """Distance from the first vertex to the front focal point; negative before the lens."""
        return self.indices[0] * _ratio(self.whole.d, self.whole.c, self._whole_size.c)

    @property
    def front_principal_mm(self) -> float:
        """Distance from the first vertex to the front principal plane; inf for an afocal lens."""
        return self.indices[0] * _ratio(self.whole.d - 1.0, self.whole.c, self._whole_size.c)

    @property
    def rear_principal_mm(self) -> float:
        """Distance from the first vertex to the rear principal plane; inf for an afocal lens."""
        return self.length_mm + self.image_index * _ratio(1.0 - self.whole.a, self.whole.c, self._whole_size.c)

    def image_mm(self, object_mm: float) -> float:
        """Return the image distance behind the last vertex, given the object distance before the first."""
        if math.isinf(object_mm):
            return self.bfl_mm
        m, reduced, size = self.whole, object_mm / self.indices[0], self._whole_size
        image = _ratio(-(m.a * reduced + m.b), m.c * reduced + m.d, size.c * abs(reduced) + size.d)
        return self.image_index * image

    def object_mm(self, image_mm: float) -> float:
        """Return the object distance before the first vertex, given the image distance behind the last.

        Negative for a virtual object, with its image between the lens and its rear focal point.
        """
        m, reduced = self.whole, image_mm / self.image_index
        return self.indices[0] * quotient(-(m.b + m.d * reduced), self.magnification_onto(image_mm))

    def magnification(self, object_mm: float) -> float:
        """Return the transverse magnification for an object distance; negative for an inverted image."""
        if math.isinf(object_mm):
            return 0.0
        reduced, size = object_mm / self.indices[0], self._whole_size
        return _ratio(1.0, self.whole.c * reduced + self.whole.d, size.c * abs(reduced) + size.d)

    def magnification_onto(self, image_mm: float) -> float:
        """Return the transverse magnification for an image distance behind the last vertex; 0 at the focus."""
        size, reduced = self._whole_size, image_mm / self.image_index
        value = self.whole.a + self.whole.c * reduced
        return 0.0 if abs(value) <= ROUNDED * (size.a + size.c * abs(reduced)) else value

    def chief_height_mm(self, image_mm: float) -> float:
        """Return the height at a plane behind the last vertex of the ray through the stop's centre with slope 1 there.

        The slope is reduced. By the optical invariant, this is also twice the stop's radius times the f-number of the
        light cone to the axis at this plane, 1 / (2 n' u'); 0 in the exit pupil.
        """
        size, reduced = self._sizes[1], image_mm / self.image_index
        value = self.from_stop.b + self.from_stop.d * reduced
        return 0.0 if abs(value) <= ROUNDED * (size.b + size.d * abs(reduced)) else value

    def chief_scale_mm(self, object_mm: float, image_mm: float) -> float:
        """Return the height at a plane of an object point's chief ray with slope 1.

        Parameters
        ----------
        object_mm : float
            Distance before the first vertex; may be inf. The slope is the object height over this.
        image_mm : float
            Distance of the plane behind the last vertex.
        """
        # Before the lens, the ray of `chief_height_mm` has the height −b at the first vertex, and the angle a.
        before = self.to_stop
        slope = quotient(before.b, object_mm) + before.a / self.indices[0]
        return quotient(-self.chief_height_mm(image_mm), slope)

    def axial_ray(self, object_mm: float) -> Ray:
        """Return a ray from the axial object point, at the first vertex."""
        return Ray(1.0, 0.0) if math.isinf(object_mm) else Ray(object_mm / self.indices[0], 1.0)

    def marginal_ray(self, object_mm: float, stop_radius_mm: float) -> Ray:
        """Return the ray from the axial object point through the edge of the stop, at the first vertex.

        Both are inf if the stop lies in an image of the object.
        """
        ray = self.axial_ray(object_mm)
        size = self._sizes[0](Ray(abs(ray.height_mm), abs(ray.angle))).height_mm
        scale = _ratio(stop_radius_mm, self.to_stop(ray).height_mm, size)
        return Ray(math.inf, math.inf) if math.isinf(scale) else Ray(ray.height_mm * scale, ray.angle * scale)

    def entrance_pupil(self, stop_radius_mm: float) -> tuple[float, float]:
        """Return z and diameter of the stop's image in object space, in mm; both inf if telecentric."""
        m, size = self.to_stop, self._sizes[0]
        return self.indices[0] * _ratio(m.b, m.a, size.a), abs(_ratio(2 * stop_radius_mm, m.a, size.a))

    def exit_pupil(self, stop_radius_mm: float) -> tuple[float, float]:
        """Return z and diameter of the stop's image in image space, in mm; both inf if telecentric."""
        m, size = self.from_stop, self._sizes[1]
        z = -self.image_index * _ratio(m.b, m.d, size.d)
        return self.length_mm + z if math.isfinite(z) else math.inf, abs(_ratio(2 * stop_radius_mm, m.d, size.d))


def quotient(numerator: float, denominator: float) -> float:
    """Divide. An unbounded result is inf without a sign; 0/0 is nan."""
    if denominator == 0:
        return math.inf if numerator else math.nan
    return numerator / denominator


def _ratio(numerator: float, denominator: float, size: float) -> float:
    """Divide, with inf for a sum as denominator that vanishes within rounding; `size` adds its terms' magnitudes."""
    return math.inf if abs(denominator) <= ROUNDED * size else numerator / denominator
