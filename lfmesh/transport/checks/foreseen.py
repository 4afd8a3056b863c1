"""Warnings about a picture from its scene and built world, before any ray is traced."""

from collections.abc import Iterator

import numpy as np

from lfmesh.errors import FoldedPatchesWarning, HiddenSceneWarning, MissedLightWarning, PictureWarning
from lfmesh.geometry import frame
from lfmesh.geometry.objects.placement import HIDES, is_round
from lfmesh.geometry.objects.targets import named_target
from lfmesh.scene.advice import doubtful
from lfmesh.transport.checks.lamps import lamps_at_targets, lamps_in_field, narrow_beams
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.transport.render.glass_aim import hardly_aimed
from lfmesh.transport.world import World


def foreseen(world: World) -> list[PictureWarning]:
    """Return the warnings of a world, most of them from its scene; list a new cause here."""
    return [
        *world.warnings,
        *_hidden(world),
        *_folded(world),
        *lamps_in_field(world),
        *lamps_at_targets(world),
        *narrow_beams(world),
        *map(MissedLightWarning, hardly_aimed(world)),
        *_without_reflections(world),
        *doubtful(world.scene, world.facts),
    ]


def _hidden(world: World) -> Iterator[PictureWarning]:
    """Warn of a closed body round the camera; glass there is refused elsewhere."""
    (eye,) = frame.points(world.tables.frames[CAMERA_FRAME, WORLD_FRAME], np.zeros((1, 3)))
    for number, body in enumerate(world.targets):
        if world.scene.targets[number].refractor is None and is_round(body, eye):
            yield HiddenSceneWarning(f"{named_target(world.scene, number)} {HIDES}")


def _folded(world: World) -> Iterator[PictureWarning]:
    """Warn of curved patches that fold over their facets, so that rays crossing no facet may miss them."""
    lens, mla, glass = world.tables.lens, world.tables.mla, world.tables.objects.glass
    trees = [lens.tree, mla.tree, *([] if glass is None else [glass.tree])]
    folded = sum(tree.folded for tree in trees)
    if folded:
        whole = folded + sum(len(np.unique(tree.patches["facet"])) for tree in trees)
        yield FoldedPatchesWarning(
            f"{folded} of {whole} facets of curved glass {'has' if folded == 1 else 'have'} normals that fit no smooth "
            "patch, so grazing rays may pass as if there were no glass. Use finer facets with fitting normals "
            "(crease_deg estimates them)"
        )


def _without_reflections(world: World) -> Iterator[PictureWarning]:
    """Warn that the sequential engine omits reflections that the scene asks for."""
    transport = world.scene.transport
    if transport.engine == "sequential" and transport.split != "transmit":
        yield MissedLightWarning(
            'engine = "sequential" follows only the image path, so the picture lacks the reflections that split = '
            f'"{transport.split}" asks for. Use engine = "auto", or split = "transmit"'
        )
