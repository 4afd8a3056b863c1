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
from lfmesh.scene.literals import percent, plain
from lfmesh.scene.objects.shapes import Box
from lfmesh.transport.aims.fitting import ALLOWED
from lfmesh.transport.checks.aim_proof import AimProof
from lfmesh.transport.checks.blind_check import BlindCheck
from lfmesh.transport.checks.order_check import OrderCheck
from lfmesh.transport.checks.tails import SIDE, tails
from lfmesh.transport.packets.ledger import Ledger
from lfmesh.transport.render.adaptive import ROWS_AT_ONCE
from lfmesh.transport.render.certainty import FEW_HITS, neighbours, weight_around

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
    "by samples that go anywhere, as noise that the error may not show; take many more samples, and compare with "
    'method = "forward"'
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
            "no path found light, and the picture is black. lfmesh check names what is not lit or not in view; "
            f"image.ledger says where the paths ended{'; out of the field: ' if out else ''}{', '.join(out)}"
        )


def _out_of_field(scene: Scene) -> list[str]:
    """Return the names of a scene's media and particles that are out of the field."""
    if not (scene.media or scene.particles):
        return []
    # Imported here because only a black picture needs to build a world.
    from lfmesh.transport.checks.media_places import unseen
    from lfmesh.transport.world import build

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
    if scene.rough_in_camera():
        return
    if proof is None:
        meshes = scene.camera.lens.has_meshes
        why = "the lens has surfaces of mesh files" if meshes else "no ray from the stop could be traced to the sensor"
        yield LightOutsideAimWarning(
            f"rays are not proven to be aimed at all light, as {why}: what is left out comes {_AS_NOISE}"
        )
        return
    if proof.holds:
        return
    if proof.diffracted is not None and proof.diffracted.share > ALLOWED:
        yield LightOutsideAimWarning(
            f"after diffraction, rays cannot be aimed at {percent(proof.diffracted.share)} of the light: so half of "
            "them go anywhere, and the picture is noisier than that of other cameras; take more samples"
        )
    if proof.most <= ALLOWED:
        return
    if proof.missed <= ALLOWED:
        yield LightOutsideAimWarning(
            f"rays may not be aimed at up to {percent(proof.most)} of the light that comes through the stop, of which "
            f"{proof.rays} rays are too few to tell: it comes {_AS_NOISE}"
        )
        return
    missed = f"rays cannot be aimed at {percent(proof.missed)} of the light that comes through the stop"
    if proof.fallback:
        yield LightOutsideAimWarning(
            f"{missed}: so most of them go anywhere, and the picture is noisier than that of other cameras; take more "
            "samples"
        )
        return
    yield LightOutsideAimWarning(f"{missed}: it comes {_AS_NOISE}")


def _order(order: OrderCheck | None) -> Iterator[PictureWarning]:
    if order is None or order.compared == 0 or order.holds:
        return
    yield OrderCheckWarning(
        f"surfaces of lens and array found by their order are not those found by their meshes: {order.words}; the "
        'meshes alone are used, which takes longer; engine = "mesh" does so from the start'
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
        f"errors. Do not use it: take many more samples, or compare with {other}"
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
            "; glass from a mesh file loses least where its facets are small, its normals fit them (crease_deg has "
            'them estimated) and its bodies do not touch; surface = "flat" takes the facets as they are'
        )
    # Walls and liquid of a tank are boxes, too, in a scene that is traced.
    if any(isinstance(body.solid, Box) for body in glass):
        words += (
            "; a box loses light that meets its edges within rounding: less where it is so large (box_mm, or size_mm "
            "of a tank) that its edges lie out of the light"
        )
    return words


def _open(ledger: Ledger) -> Iterator[PictureWarning]:
    if abs(ledger.imbalance) > OPEN_SHARE:
        yield OpenLedgerWarning(
            f"the energy does not close: {ledger.imbalance:.1e} of what was emitted is missing, and the picture is "
            "wrong by about as much; this is a fault of lfmesh: please report the scene"
        )


def _no_numbers(image: "Image") -> Iterator[PictureWarning]:
    if count := int(np.count_nonzero(~np.isfinite(image.mean))):
        yield OpenLedgerWarning(
            f"{count} values of the picture are no numbers; this is a fault of lfmesh: please report the scene"
        )


def _cut(scene: Scene, ledger: Ledger, most: float) -> Iterator[PictureWarning]:
    # Little of the importance sent out by pixels reaches their targets: the cut part is compared with that.
    whole = ledger.reached_target + ledger.depth if ledger.reached_target > 0.0 else ledger.emitted
    if not ledger.depth > most * whole:
        return
    yield CutPathsWarning(
        f"paths that carry {percent(ledger.depth / whole)} of the light were cut after "
        f"{scene.transport.max_events} events (max_events): the picture lacks what they would have brought; raise "
        "transport.max_events"
    )


def _heavy_paths(image: "Image") -> Iterator[PictureWarning]:
    heavy = tails(image.mean, image.stderr, image.hits) if image.hits is not None and image.replicates > 1 else None
    if heavy is None or heavy.share < HEAVY_SHARE:
        return
    yield HeavyPathsWarning(
        f"few paths bring much of the light. In {percent(heavy.share)} of the blocks of {SIDE} × {SIDE} pixels one "
        f"pixel holds much of it, up to {percent(heavy.held)}, by paths {plain(heavy.heavier, 2)} times as heavy as "
        "the others'. Pixels that met none lack that light, and their errors are too small. Take many more samples"
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
            f"few paths bring much of the light. In {percent(unmet / lit)} of the pixels with light, one such path as "
            f"their neighbours met would bring more than {UNMET:g} times what all others have brought. Pixels that met "
            "none lack that light, which `upper` bounds and their errors do not tell. Take many more samples"
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
    unknown = ", and the errors of its pixels are not known" if image.replicates < 2 else ""
    yield InterruptedRenderWarning(
        f"the render was cut short: {done} of {whole} {stage} were finished, {image.samples:.3g} samples a pixel. The "
        f"picture is noisier than was asked for{unknown}; lfmesh render --resume goes on with a run folder"
    )


def _few_samples(image: "Image") -> Iterator[PictureWarning]:
    share = few_hits_share(image, lit_pixels(image.mean))
    if share is not None and share > FEW_SHARE:
        yield TooFewSamplesWarning(
            f"too few samples to tell the noise well. In {percent(share)} of the lit pixels less than {FEW_HITS} found "
            "light. Edges, and light that few paths find, may be missing in picture and error. Take more "
            f"samples than {image.samples:g} a pixel"
        )
