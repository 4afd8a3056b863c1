"""Many emitting facets, few of which light what is seen: against scattered packets alone, and forward against adjoint.

Scattered packets alone know neither the tree of facets nor its chances, and the forward method has no part of it.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from tests.instances import instances
from tests.renders import by_seed
from tests.validation.test_emitters import assert_chance_agrees
from tests.validation.test_sized_lamps import CAMERA, PLACES, WALL, agree, watts


def ball(folder: Path, radius: float, place: list[float], radiance: float) -> dict[str, Any]:
    """Return a glowing ball of 20,480 facets."""
    path = folder / "ball.ply"
    if not path.exists():
        trimesh.creation.icosphere(subdivisions=5).export(path)
    return {"file": str(path), "units": "mm", "scale": radius, "position_mm": place,
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": radiance}}  # fmt: skip


def near_and_far(folder: Path) -> list[dict[str, Any]]:
    """Return balls that light the wall alike: one beside it, one far away, and a dim one between."""
    return [
        ball(folder, 1.5, [11.5, 0.0, -57.0], 8.0),
        ball(folder, 60.0, [300.0, 50.0, 100.0], 8.0),
        ball(folder, 8.0, [-25.0, 5.0, -40.0], 0.05),
    ]


@pytest.mark.parametrize("place", instances(["air", "fog"], long=["fog"]))
def test_many_facets_light_as_scattered_packets_find(place: str, tmp_path: Path) -> None:
    scene = PLACES[place] | {"targets": [WALL, *near_and_far(tmp_path)]}
    transport = {"samples": 256, "replicates": 1, "split": "both"}
    assert_chance_agrees(lf.Scene(camera=CAMERA, transport=transport, **scene), 0.7)


@pytest.mark.filterwarnings("ignore::lfmesh.PictureWarning")
@pytest.mark.parametrize("place", instances(list(PLACES), long=["fog", "glass", "tank"]))
def test_forward_equals_adjoint_with_many_facets(place: str, tmp_path: Path) -> None:
    """Without the ball far away, at which the forward method starts most packets, few of which light the wall."""
    near, _, dim = near_and_far(tmp_path)
    scene = PLACES[place] | {"targets": [*PLACES[place]["targets"], near, dim]}
    agree(watts(512, "adjoint", **scene), watts(131_072, "forward", **scene), 0.05)


@pytest.mark.filterwarnings("ignore::lfmesh.PictureWarning")
@pytest.mark.parametrize("place", instances(["air", "fog"], long=["fog"]))
def test_the_error_of_many_facets_is_what_it_is_said_to_be(place: str, tmp_path: Path) -> None:
    """In each quarter of the pixels by brightness, over 32 seeds: the spread over the reported error."""
    camera = CAMERA | {"sensor": {"pixels": [8, 8], "pixel_mm": 0.5}}
    settings = {"samples": 32, "replicates": 8, "split": "transmit"}
    scene = PLACES[place] | {"targets": [WALL, *near_and_far(tmp_path)]}
    found = [
        (image.mean[:, :, 0], image.stderr[:, :, 0])
        for image in by_seed(lf.Scene(camera=camera, transport=settings, **scene), range(32))
    ]
    means, errors = (np.array(each) for each in zip(*found, strict=True))
    spread, said = means.var(axis=0, ddof=1), (errors**2).mean(axis=0)
    for quarter in np.split(np.argsort(means.mean(axis=0), axis=None), 4):
        assert 0.8 < np.sqrt(spread.ravel()[quarter].sum() / said.ravel()[quarter].sum()) < 1.3
