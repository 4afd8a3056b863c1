"""Proof that the aim holds all light, by rays that start in the stop and are traced both ways.

Aiming decides where samples go, never how much light there is. Light outside the aim is found only by the few samples
that go anywhere, with large weights. Rays drawn uniformly in the stop, over all directions, are independent of the
search that made the aim. Each is traced to the sensor and to object space. The share that the aim misses is the
throughput of rays that it could not draw, over the total throughput. A build measures this share and widens the aim
until it is negligible. If that fails, rays go anywhere.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from lfmesh.scene import FirstOrder, Scene
from lfmesh.transport.aims.aim_table import Shapes, aim_table, has_glass
from lfmesh.transport.aims.fitting import ALLOWED, fitted, shown_by, widened
from lfmesh.transport.aims.kept import Kept, digest_of
from lfmesh.transport.aims.lenslet_view import unmeasured_light
from lfmesh.transport.aims.mixture import WIDE_SHARE_OF_FALLBACK, anywhere
from lfmesh.transport.aims.near_points import NearViewpoints
from lfmesh.transport.aims.pupil import Viewpoints
from lfmesh.transport.aims.support import beyond_object_aim, beyond_sensor_aim, seen_from_cells
from lfmesh.transport.sequences.stop_rays import CameraTables, Rays, rays_from_stop, reach_of
from lfmesh.transport.tables.tables import (
    AimTables,
    Camera,
    undiffracted,
)

Array = NDArray[np.float64]

CONFIDENCE = 0.95
"""Confidence of the bounds that decide whether a share is allowed."""

ROUNDS = 8
"""Most draws of rays to decide whether the share is allowed."""

ATTEMPTS = 5
"""Most attempts to fit the aim, each with its own rays."""

FEWEST = 3000
"""Fewest rays that measure the light over the views. Rings that none of them meets hold less than 1e-3 of the light
(with 95 % confidence), and main rays do not go there."""

FEW_CELLS = 6.5
"""Value of `LensletAim.search`, in pitches, above which the views are taken to be far too wide."""


GROWTH_OF_VIEWS = (1.0, 2.0, 3.0)
"""Factors on the radii of the lenslets' views, tried for the aim after diffraction."""


class Missed(NamedTuple):
    """Share of the throughput outside the aim of one side, and its standard error.

    If no ray was outside, `error` is the share of a single ray.
    """

    share: float
    error: float

    @property
    def most(self) -> float:
        """Upper bound of the share, from the number of rays outside (Poisson) and their mean weight."""
        number, weight = self._outside
        return float(weight * gammaincinv(number + 1.0, CONFIDENCE))

    @property
    def least(self) -> float:
        """Lower bound of the share, in the same way."""
        number, weight = self._outside
        return float(weight * gammaincinv(number, 1.0 - CONFIDENCE)) if number > 0.0 else 0.0

    @property
    def _outside(self) -> tuple[float, float]:
        """Number of equal rays that would give share and error, and the share of each."""
        return ((self.share / self.error) ** 2, self.error**2 / self.share) if self.share > 0.0 else (0.0, self.error)


class AimProof(NamedTuple):
    """Result of the proof of an aim by rays from the stop.

    Few rays measure a share poorly, so its upper bound decides whether the proof holds.

    Attributes
    ----------
    rays : int
        Number of rays that reached the sensor.
    sensor, objects : Missed
        Shares missed by the aims from the sensor and from the targets.
    fitted : int
        Number of fits of the aim to rays.
    diffracted : Missed, optional
        Share missed by the aim from the sensor after diffraction at the lenslets, without large changes of direction
        (see `kick_aim.MOST_GROWTH`).
    fallback : bool
        The fitted aim missed more than is allowed, so more rays, or all, go anywhere.
    """

    rays: int
    sensor: Missed
    objects: Missed
    fitted: int
    fallback: bool = False
    diffracted: Missed | None = None

    @property
    def holds(self) -> bool:
        """True if the share that the aim misses is allowed, with the `CONFIDENCE` of its bound."""
        return self.most <= ALLOWED and (self.diffracted is None or self.diffracted.share <= ALLOWED)

    @property
    def is_open(self) -> bool:
        """True if more rays might decide whether the share is allowed."""
        return max(self.sensor.least, self.objects.least) <= ALLOWED < self.most

    @property
    def most(self) -> float:
        """Upper bound of the throughput outside the aim, the larger of both sides."""
        return max(self.sensor.most, self.objects.most)

    @property
    def missed(self) -> float:
        """Share of the throughput outside the aim, the larger of both sides."""
        return max(self.sensor.share, self.objects.share)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "AimProof":
        """Return the proof from the JSON form of its `_asdict`."""
        sensor, objects = (Missed(*values[side]) for side in ("sensor", "objects"))
        diffracted = values.get("diffracted")
        return cls(
            values["rays"], sensor, objects, values["fitted"], values.get("fallback", False),
            None if diffracted is None else Missed(*diffracted),
        )  # fmt: skip


_kept: Kept[tuple[AimTables, AimProof | None]] = Kept()


def proven_aim(
    scene: Scene, report: FirstOrder, camera: Camera, shapes: Shapes, *, analytic: bool
) -> tuple[AimTables, AimProof | None]:
    """Return the aim tables of a scene, and their proof by rays from the stop.

    The proof is None if the lens is not exact, a surface scatters light or sends it into several orders, or no ray
    arrives at the sensor.

    Parameters
    ----------
    scene, report, camera, shapes, analytic
        As for `aim_table`.
    """
    key = digest_of(scene.camera, scene.transport.split, has_glass(scene), report, camera, shapes, analytic)
    return _kept.of(key, lambda: _proven_aim(scene, report, camera, shapes, analytic))


def _proven_aim(
    scene: Scene, report: FirstOrder, camera: Camera, shapes: Shapes, analytic: bool
) -> tuple[AimTables, AimProof | None]:
    """Compute the aim tables of a scene and their proof."""
    plain = camera._replace(lens=camera.lens._replace(aperture=None), mla=undiffracted(camera.mla))
    found = aim_table(scene, report, plain, shapes, analytic=analytic)
    through = found.through._replace(stop=camera.lens.aperture)
    aim, proof = proven(found.aim, through, found.seen, found.near) if found.fits else (found.aim, None)
    if camera.mla.apertures is not None:
        aim, proof = _diffracted(aim, proof, found.through._replace(mla=camera.mla))
    return aim, proof if analytic else None


def _diffracted(aim: AimTables, proof: AimProof | None, through: CameraTables) -> tuple[AimTables, AimProof | None]:
    """Adapt an aim and its proof to diffraction at the lenslets.

    The views of the lenslets grow until they hold the light that crosses to neighbours in the plate; the light over
    them is measured after diffraction. If the aim still misses too much, half of the rays go anywhere.

    Parameters
    ----------
    aim : AimTables
    proof : AimProof or None
    through : CameraTables
        With diffraction.
    """
    if proof is None:
        return aim, None
    random = np.random.default_rng(0x6B1C)
    reach = reach_of(through._replace(mla=undiffracted(through.mla)), random)
    if reach is None:
        return aim, proof
    rays = rays_from_stop(through, reach, random)
    if not len(rays.throughput):
        return aim, proof
    narrow, missed = aim.lenslets, Missed(1.0, 1.0)
    for growth in GROWTH_OF_VIEWS:
        wide = narrow._replace(slope_radius2=growth * growth * narrow.slope_radius2, search=growth * narrow.search)
        aim = _measured_light(aim._replace(lenslets=wide), through, rays)
        missed = _missed(beyond_sensor_aim(aim, through, rays), rays.throughput)
        if missed.share <= ALLOWED:
            break
    proof = proof._replace(diffracted=missed)
    if missed.share > ALLOWED:
        aim = aim._replace(exit=aim.exit._replace(wide_share=WIDE_SHARE_OF_FALLBACK, share_without_aim=1.0))
        proof = proof._replace(fallback=True)
    return aim, proof


def proven(
    aim: AimTables, through: CameraTables, seen: Viewpoints | None, near: NearViewpoints | None = None
) -> tuple[AimTables, AimProof | None]:
    """Widen an aim until it misses a negligible share of the light; return it with its proof.

    The proof is None if no ray from the stop arrives at the sensor.

    Parameters
    ----------
    aim : AimTables
    through : CameraTables
        Every surface of the lens must be exact.
    seen : Viewpoints or None
        Viewpoints of the targets; None if no target lies before the lens.
    near : NearViewpoints, optional
        Viewpoints close to the front of the lens.
    """
    random = np.random.default_rng(0x5106)
    reach = reach_of(through, random)
    if reach is None:
        return aim, None
    proof = None
    for attempt in range(ATTEMPTS):
        rays = rays_from_stop(through, reach, random)
        if not len(rays.throughput):
            return aim, None
        if attempt == 0 and through.mla.present and aim.lenslets.search > FEW_CELLS:
            aim = fitted(aim, through, rays)
            continue
        proof, factors = _measured(aim, through, seen, near, rays, random, attempt)
        for _ in range(ROUNDS - 1):
            if not proof.is_open:
                break
            more = rays_from_stop(through, reach, random)
            rays = Rays(*(np.concatenate(each) for each in zip(rays, more, strict=True)))
            proof, factors = _measured(aim, through, seen, near, rays, random, attempt)
        if proof.holds:
            break
        if attempt == ATTEMPTS - 1:
            aim, proof = _completed(aim, proof, through.mla.present)
            break
        aim = _widened(aim, through, rays, factors)
    if through.mla.present:
        aim = _measured_light(aim, through, rays)
    return aim, proof


def _measured_light(aim: AimTables, through: CameraTables, rays: Rays) -> AimTables:
    """Return the aim with the light over the views of lenslets, after any diffraction, if there are enough rays."""
    shown = unmeasured_light()
    if len(rays.throughput) >= FEWEST:
        off, radius, _ = seen_from_cells(aim, through, rays)
        seen = radius > 0.0
        shown = shown_by(off[seen] / radius[seen], rays.throughput[seen])
    return aim._replace(lenslets=aim.lenslets._replace(shown=shown))


def _measured(
    aim: AimTables, through: CameraTables, seen: Viewpoints | None, near: NearViewpoints | None, rays: Rays,
    random: np.random.Generator, attempt: int,
) -> tuple[AimProof, tuple[Array, Array, Array]]:  # fmt: skip
    """Return the proof of an aim, and the factors of both sides."""
    factors = beyond_sensor_aim(aim, through, rays), *beyond_object_aim(aim, seen, near, rays, random)
    behind, before, close = (_missed(beyond, rays.throughput) for beyond in factors)
    return AimProof(len(rays.throughput), behind, max(before, close, key=lambda m: m.most), attempt), factors


def _widened(aim: AimTables, through: CameraTables, rays: Rays, factors: tuple[Array, Array, Array]) -> AimTables:
    """Widen an aim by the factors of `_measured`."""
    behind, before, close = factors
    if through.mla.present:
        aim = fitted(aim, through, rays)
    else:
        opening, radius = aim.exit.opening, aim.exit.wide_radius
        far = widened(opening.far, behind, rays.throughput, radius)
        aim = aim._replace(exit=aim.exit._replace(opening=opening._replace(far=far)))
    opening, radius = aim.entrance.opening, aim.entrance.wide_radius
    opening = opening._replace(
        far=widened(opening.far, before, rays.throughput, radius),
        near=widened(opening.near, close, rays.throughput, radius),
    )
    return aim._replace(entrance=aim.entrance._replace(opening=opening))


def _completed(aim: AimTables, proof: AimProof, has_array: bool) -> tuple[AimTables, AimProof]:
    """Return an aim that holds all light, in place of one that failed its proof, and the proof marked so.

    Rays to the lens go all over it. Behind an array half of the rays go into the whole hemisphere. A side with no more
    outside than is allowed keeps its aim, though too few rays came through to prove it.

    Parameters
    ----------
    aim : AimTables
        After all attempts to fit it.
    proof : AimProof
        Shows that the aim misses, or may miss, more than is allowed.
    has_array : bool
    """
    if proof.objects.share > ALLOWED:
        aim = aim._replace(entrance=anywhere(aim.entrance))
    if proof.sensor.share > ALLOWED:
        aim = (
            aim._replace(exit=aim.exit._replace(wide_share=WIDE_SHARE_OF_FALLBACK, share_without_aim=1.0))
            if has_array
            else aim._replace(exit=anywhere(aim.exit))
        )
    return aim, proof._replace(fallback=proof.missed > ALLOWED)


def _missed(beyond: Array, throughput: Array) -> Missed:
    outside, total = throughput * (beyond > 1.0), throughput.sum()
    return Missed(float(outside.sum() / total), float(max(np.sqrt((outside**2).sum()), throughput.mean()) / total))
