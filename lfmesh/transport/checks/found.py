"""Warnings about a picture from the numbers of its own run.

They are raised in Python, printed by the command line and written to `report.json`; see `lfmesh.errors.PictureWarning`.
"""

import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import (
    BlackPictureWarning,
    BlindCheckWarning,
    CutPathsWarning,
    HeavyPathsWarning,
    InterruptedRenderWarning,
    LightOutsideAimWarning,
    LostEnergyWarning,
    OpenLedgerWarning,
    OrderCheckWarning,
    PictureWarning,
    TooFewSamplesWarning,
)
from lfmesh.scene import Scene
from lfmesh.scene.literals import counted, percent, plain
from lfmesh.scene.objects.shapes import Box
from lfmesh.transport.aims.fitting import ALLOWED
from lfmesh.transport.checks.aim_proof import AimProof
from lfmesh.transport.checks.blind_check import BlindCheck
from lfmesh.transport.checks.order_check import OrderCheck
from lfmesh.transport.checks.tails import SIDE, tails
from lfmesh.transport.packets.ledger import Ledger
from lfmesh.transport.render.adaptive import ROWS_AT_ONCE
from lfmesh.transport.render.certainty import FEW_HITS, neighbours, weight_around
from lfmesh.transport.tables.gradient_spaces import stop_within_gradients
from lfmesh.transport.tables.phase_faces import has_orders

if TYPE_CHECKING:
    from lfmesh.transport.render.image import Image

LIT_SHARE_OF_BRIGHT = 0.05
"""A pixel counts as lit above this share of the 99th percentile."""

FEW_SHARE = 0.25
"""Share of lit pixels with fewer than `FEW_HITS` hits above which the run warns."""

OPEN_SHARE = 1e-9
"""Imbalance of the ledger that rounding may cause, as a share of the emitted energy."""

HEAVY_SHARE = 0.01
"""Share of pixel blocks dominated by few paths above which the run warns."""

UNMET, UNMET_SHARE = 10.0, 0.05
"""Light of one path that a pixel of at least `FEW_HITS` hits may have missed, relative to all its light; and share of
such pixels among those with light above which the run warns."""

CUT_SHARE = 1e-3
"""Share of the light that `max_events` may cut without a warning: of that reaching targets, if any, or emitted."""

_AS_NOISE = (
    "as noise that the error may not show, from samples that go in all directions. Take many more samples, and "
    'compare with method = "forward"'
)


def found(image: "Image") -> list[PictureWarning]:
    """Return the warnings from the numbers of a finished image; list a new cause here."""
    return [
        *_black(image),
        *proofs(image.scene, image.aim, image.order),
        *_blind(image.scene, image.blind),
        *books(image.scene, image.ledger),
        *_no_numbers(image),
        *_heavy_paths(image),
        *_unmet_paths(image),
        *_interrupted(image),
        *_few_samples(image),
    ]


def _black(image: "Image") -> Iterator[PictureWarning]:
    if not image.mean.any():
        out = _out_of_field(image.scene)
        yield BlackPictureWarning(
            "the picture is black: no path found light. lfmesh check names targets that are not lit or not in view; "
            f"image.ledger lists where the paths ended{'; out of the field: ' if out else ''}{', '.join(out)}"
            f"{_in_time(image.scene)}"
        )


def _in_time(scene: Scene) -> str:
    """Return a remark on a black picture of a scene that moves, or ""."""
    exposure = scene.exposure
    if exposure is None or not scene.moves:
        return ""
    end_s = exposure.end_s(scene.camera.sensor.pixels[1])
    return f"; these are places at t = 0, and the scene moves until t = {end_s:.4g} s: see the ways in lfmesh check"


def _out_of_field(scene: Scene) -> list[str]:
    """Return the names of a scene's media and particles that are out of the field."""
    if not (scene.media or scene.particles):
        return []
    # Imported here because only a black picture needs to build a world.
    from lfmesh.transport.build import build
    from lfmesh.transport.checks.media_places import unseen

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return unseen(build(scene))


def proofs(scene: Scene, aim: AimProof | None, order: OrderCheck | None) -> list[PictureWarning]:
    """Return the warnings of the checks made before a render.

    Parameters
    ----------
    scene : Scene
    aim : AimProof or None
    order : OrderCheck or None
    """
    return [*_aim(scene, aim), *_order(order)]


def books(scene: Scene, ledger: Ledger) -> list[PictureWarning]:
    """Return the warnings of a ledger and of the separate ledger of lamps' own packets."""
    ledgers = [each for each in (ledger, ledger.lamps) if each is not None]
    found: list[PictureWarning] = []
    for each in ledgers:
        nothing_came = each.sensor + each.reached_target <= 0.0
        found += [*given_up(scene, each, 0.0 if nothing_came else CUT_SHARE), *_open(each)]
    return found


def given_up(scene: Scene, ledger: Ledger, cut: float = CUT_SHARE) -> list[PictureWarning]:
    """Return the warnings of lost or cut paths, for any tracing that keeps a ledger.

    Parameters
    ----------
    scene : Scene
    ledger : Ledger
        Need not balance: rays may end without being booked.
    cut : float
        See `CUT_SHARE`.
    """
    return [*_lost(scene, ledger), *_cut(scene, ledger, cut)]


def _aim(scene: Scene, proof: AimProof | None) -> Iterator[PictureWarning]:
    if scene.rough_in_camera() or has_orders(scene):
        # Rays go anywhere.
        return
    if proof is None:
        meshes = scene.camera.lens.has_meshes
        why = "the lens has surfaces of mesh files" if meshes else "no ray from the stop could be traced to the sensor"
        why = "the stop lies between gradient-index glass on both sides" if stop_within_gradients(scene) else why
        yield LightOutsideAimWarning(
            f"rays are not proven to be aimed at all light, because {why}. Light outside the aim comes {_AS_NOISE}"
        )
        return
    if proof.holds:
        return
    if proof.diffracted is not None and proof.diffracted.share > ALLOWED:
        yield LightOutsideAimWarning(
            f"after diffraction, rays cannot be aimed at {percent(proof.diffracted.share)} of the light. Half of "
            "them therefore go in all directions, which adds noise. Take more samples"
        )
    if proof.most <= ALLOWED:
        return
    if proof.missed <= ALLOWED:
        yield LightOutsideAimWarning(
            f"rays may miss up to {percent(proof.most)} of the light through the stop ({proof.rays} test rays cannot "
            f"rule out less). That light comes {_AS_NOISE}"
        )
        return
    missed = f"rays cannot be aimed at {percent(proof.missed)} of the light through the stop"
    if proof.fallback:
        yield LightOutsideAimWarning(
            f"{missed}. Most of them therefore go in all directions, which adds noise. Take more samples"
        )
        return
    yield LightOutsideAimWarning(f"{missed}. It comes {_AS_NOISE}")


def _order(order: OrderCheck | None) -> Iterator[PictureWarning]:
    if order is None or order.compared == 0 or order.holds:
        return
    yield OrderCheckWarning(
        f"sequential and mesh tracing of lens and array disagree: {order.words}. The slower meshes are used; engine "
        '= "mesh" skips this test'
    )


def _blind(scene: Scene, blind: BlindCheck | None) -> Iterator[PictureWarning]:
    if blind is None or blind.agrees:
        return
    rows, columns = blind.blocks
    others, other = "unaimed samples", 'method = "forward"'
    if scene.transport.method == "forward":
        others, other = "paths traced back from some pixels", 'the default, method = "adjoint"'
    yield BlindCheckWarning(
        f"the picture is wrong by more than its error says. In one of {rows} × {columns} blocks of pixels, {others} "
        f"found {'more' if blind.worst > 0.0 else 'less'} light than it has, by {abs(blind.worst):.1f} standard "
        f"errors. Do not use the picture. Take many more samples, or compare with {other}"
    )


def _lost(scene: Scene, ledger: Ledger) -> Iterator[PictureWarning]:
    lost = ledger.loss_in_words()
    if lost is not None:
        yield LostEnergyWarning(f"{lost}; the picture lacks it{_remedy(scene, ledger)}")


def _remedy(scene: Scene, ledger: Ledger) -> str:
    """Return advice for the bodies that lost energy; a box can only change in size."""
    names = {target.name or f"targets[{i}]": target.refractor for i, target in enumerate(scene.targets)}
    glass = [body for name in ledger.lost_in if (body := names.get(name)) is not None]
    of_lens = scene.camera.lens.has_meshes and bool(ledger.lost_in.keys() - names.keys())
    words = ""
    if of_lens or any(body.solid is None for body in glass):
        words += (
            ". For glass from a mesh file use finer facets and fitting normals (crease_deg estimates them), keep "
            'bodies apart, or take surface = "flat", which traces the facets as they are'
        )
    # Walls and liquid of a tank are boxes, too, in a scene that is traced.
    if any(isinstance(body.solid, Box) for body in glass):
        words += (
            ". A box loses rays that meet its edges: enlarge it (box_mm, or size_mm of a tank) until its edges lie "
            "out of the light"
        )
    return words


def _open(ledger: Ledger) -> Iterator[PictureWarning]:
    if abs(ledger.imbalance) > OPEN_SHARE:
        yield OpenLedgerWarning(
            f"the energy ledger does not close: {ledger.imbalance:.1e} of the emitted energy is missing, and the "
            "picture is wrong by about as much. This is a fault of lfmesh: please report the scene"
        )


def _no_numbers(image: "Image") -> Iterator[PictureWarning]:
    if count := int(np.count_nonzero(~np.isfinite(image.mean))):
        yield OpenLedgerWarning(
            f"{counted(count, 'value')} of the picture {'is not a number' if count == 1 else 'are not numbers'}. "
            "This is a fault of lfmesh: please report the scene"
        )


def _cut(scene: Scene, ledger: Ledger, most: float) -> Iterator[PictureWarning]:
    # Little of the importance sent out by pixels reaches their targets: the cut part is compared with that.
    whole = ledger.reached_target + ledger.depth if ledger.reached_target > 0.0 else ledger.emitted
    if not ledger.depth > most * whole:
        return
    yield CutPathsWarning(
        f"paths with {percent(ledger.depth / whole)} of the light were cut after {scene.transport.max_events} events "
        "(max_events), and the picture lacks their further light. Raise transport.max_events"
    )


def _heavy_paths(image: "Image") -> Iterator[PictureWarning]:
    heavy = tails(image.mean, image.stderr, image.hits) if image.hits is not None and image.replicates > 1 else None
    if heavy is None or heavy.share < HEAVY_SHARE:
        return
    yield HeavyPathsWarning(
        f"few paths bring much of the light. In {percent(heavy.share)} of the blocks of {SIDE} × {SIDE} pixels one "
        f"pixel holds up to {percent(heavy.held)} of its block's light, from paths {plain(heavy.heavier, 2)} times as "
        "heavy as the others. Pixels without such a path are too dark, and their errors too small. Take many more "
        "samples"
    )


def _unmet_paths(image: "Image") -> Iterator[PictureWarning]:
    if image.hits is None or image.replicates < 2:
        return
    steps, unmet = neighbours(image.scene), 0
    for low in range(0, len(image.mean), ROWS_AT_ONCE):
        rows = slice(low, low + ROWS_AT_ONCE)
        heavy = weight_around(image.mean, image.stderr, steps, rows) > UNMET * image.mean[rows]
        unmet += int((heavy & (image.hits[rows] >= FEW_HITS)).sum())
    lit = np.count_nonzero(image.hits)
    if unmet > UNMET_SHARE * lit:
        yield HeavyPathsWarning(
            f"few paths bring much of the light. In {percent(unmet / lit)} of the pixels with light, one heavy path "
            f"like those of their neighbours would bring more than {UNMET:g} times their present light. Without it "
            "they are too dark; `upper` bounds the missing light, their errors do not. Take many more samples"
        )


def lit_pixels(mean: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask of lit pixels: above 5 % of the 99th percentile of the pixels with light."""
    received = mean > 0.0
    if not received.any():
        return received
    # In place where possible: a large sensor leaves no room for copies.
    bright = float(np.percentile(mean[received], 99.0, overwrite_input=True))
    lit: NDArray[np.bool_] = mean > LIT_SHARE_OF_BRIGHT * bright
    return lit


def few_hits_share(image: "Image", lit: NDArray[np.bool_]) -> float | None:
    """Return the share of the lit pixels with fewer than `FEW_HITS` hits; None if hits were not counted."""
    return None if image.hits is None or not lit.any() else float((image.hits[lit] < FEW_HITS).mean())


def _interrupted(image: "Image") -> Iterator[PictureWarning]:
    if image.complete:
        return
    whole, refined = image.scene.transport.replicates, image.refinement
    done = image.replicates if refined is None else refined.replicates
    stage = "replicates" if refined is None else "replicates of the second stage"
    unknown = ", and its errors are unknown" if image.replicates < 2 else ""
    yield InterruptedRenderWarning(
        f"the render was interrupted after {done} of {whole} {stage}, {image.samples:.3g} samples per pixel. The "
        f"picture is noisier than requested{unknown}. lfmesh render --resume continues a run folder"
    )


def _few_samples(image: "Image") -> Iterator[PictureWarning]:
    share = few_hits_share(image, lit_pixels(image.mean))
    if share is not None and share > FEW_SHARE:
        yield TooFewSamplesWarning(
            f"too few samples. In {percent(share)} of the lit pixels fewer than {FEW_HITS} samples found light, so "
            "their noise estimate is unreliable, and edges or light on rare paths may be missing. Use more than "
            f"{image.samples:g} samples per pixel{_of_particles(image.scene)}"
        )


def _of_particles(scene: Scene) -> str:
    """Return what else decides on the samples of a scene with particles, or ""."""
    if not scene.particles:
        return ""
    least = min(group.samples for group in scene.particles)
    return f", or for the light of particles more packets than particles[].samples = {least}"
