"""Many lights of the forward method share its packets by their light on what the camera sees, and none is left out."""

from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
import trimesh

import lfmesh as lf
from tests.cameras import camera_without_array

FLOOR = {"shape": {"kind": "plane", "width_mm": 4000.0, "height_mm": 4000.0}, "position_mm": [0.0, 0.0, -150.0]}
HOT = {"shape": {"kind": "sphere", "radius_mm": 3.0}, "position_mm": [400.0, 0.0, -100.0],
       "material": {"reflectance": 0.0, "radiance_w_m2_sr": 5.0}}  # fmt: skip


def sources(method: str, **scene: Any) -> np.ndarray:
    given = lf.Scene(camera=camera_without_array(), transport={"method": method}, **scene)  # type: ignore[arg-type]
    return lf.build(given, aimed=False).tables.objects.sources


def shares(**scene: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the sources of a scene's forward method, and their shares by power alone."""
    forward, plain = sources("forward", **scene), sources("adjoint", **scene)["share"]
    assert forward["until"][-1] == pytest.approx(1.0, rel=1e-12)
    np.testing.assert_allclose(np.cumsum(forward["share"]), forward["until"], rtol=1e-12)
    # None has less than half of what its power gives it.
    assert (forward["share"] >= 0.5 * plain - 1e-15).all()
    return forward, plain


def in_a_row(count: int) -> list[list[float]]:
    """Return places over a wide floor; the camera sees what the first one lights."""
    return [[60.0 + 90.0 * i, 0.0, -130.0] for i in range(count)]


@pytest.mark.parametrize("count", [3, 20])
def test_many_lamps_start_packets_by_their_light_on_what_is_seen_and_few_by_their_power(count: int) -> None:
    lights = [{"kind": "point", "position_mm": place, "power_w": 1.0} for place in in_a_row(count)]
    forward, plain = shares(targets=[FLOOR, HOT], lights=lights)
    if count == 3:
        np.testing.assert_array_equal(forward["share"], plain)
    else:
        share = forward["share"][forward["light"] >= 0]
        assert share[0] > 5.0 * share[-1]
        assert (np.diff(share) < 0.0).all()


def test_many_flames_start_packets_by_their_light_on_what_is_seen() -> None:
    flames = [
        {"bounds": {"kind": "sphere", "radius_mm": 2.0}, "position_mm": place, "emission_w_mm3_sr": 0.1}
        for place in in_a_row(20)
    ]
    share = shares(targets=[FLOOR], media=flames)[0]["share"]
    assert share[0] > 5.0 * share[-1]
    assert (np.diff(share) < 0.0).all()


def test_facets_that_light_what_is_seen_start_half_of_the_packets(tmp_path: Path) -> None:
    """A ball beside the field gives as much light there as a ball of a thousand times its power far away."""
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "ball.ply")
    glow = {"file": str(tmp_path / "ball.ply"), "units": "mm",
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0, "sides": "front"}}  # fmt: skip
    near, far = {"scale": 2.0, "position_mm": [30.0, 0.0, -140.0]}, {"scale": 60.0, "position_mm": [800.0, 0.0, 500.0]}
    forward, plain = shares(targets=[FLOOR, glow | near, glow | far])
    of_near = np.arange(len(plain)) < len(plain) // 2
    assert plain[of_near].sum() < 2e-3
    assert forward["share"][of_near].sum() > 0.1
    # Of the far one, the back starts fewer packets than the front.
    back = forward["share"][~of_near] < 0.51 * plain[~of_near]
    assert 0.3 < back.mean() < 0.7


def test_an_emitter_in_the_field_starts_packets_for_the_eye() -> None:
    """Of equal spheres, above a floor that is nowhere seen, that in the field starts most of the packets."""
    places = [[0.0, 0.0, -100.0], *([200.0 * i, 0.0, -100.0] for i in range(1, 13))]
    forward, _ = shares(targets=[HOT | {"position_mm": place} for place in places])
    assert forward["share"][0] > 0.45


def test_the_bright_part_of_a_picture_starts_most_packets(tmp_path: Path) -> None:
    """A sheet of many facets with a picture of a few bright texels: its bright facets start half of the packets."""
    side = 16
    grid = np.stack(np.meshgrid(np.arange(side + 1), np.arange(side + 1), indexing="ij"), -1).reshape(-1, 2) / side
    i = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    faces = np.concatenate([np.stack([i, i + side + 1, i + 1], 1), np.stack([i + 1, i + side + 1, i + side + 2], 1)])
    lines = [f"v {40.0 * x - 20.0} {40.0 * y - 20.0} 0\nvt {x} {y}" for x, y in grid]
    lines += ["f " + " ".join(f"{k}/{k}" for k in face) for face in (faces + 1).tolist()]
    (tmp_path / "sheet.obj").write_text("\n".join(lines))
    dark = np.zeros((32, 32), np.uint8)
    dark[4:8, 20:24] = 255
    PIL.Image.fromarray(dark).save(tmp_path / "dot.png")
    glow = {"reflectance": 0.0, "radiance_w_m2_sr": 1.0, "texture": str(tmp_path / "dot.png")}
    place = [60.0, 0.0, -100.0]
    sheet = {"file": str(tmp_path / "sheet.obj"), "units": "mm", "position_mm": place, "material": glow}
    forward, plain = shares(targets=[FLOOR, sheet])
    assert plain.max() < 1.1 / (2 * side**2)
    assert np.sort(forward["share"])[-16:].sum() > 0.45
