"""What is not supported with media that bend light is refused in one line that names the medium, by every command."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from tests.cameras import camera_without_array
from tests.validation.field_scenes import Tables, ball_of, box_of

AT: Tables = {"position_mm": (0.0, 0.0, -80.0), "rotation_deg": (0.0, 0.0, 0.0)}
UNIFORM = box_of(40.0, index=1.0005) | AT | {"name": "gas"}
CHART: Tables = {
    "shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0}, "position_mm": (0.0, 0.0, -150.0),
    "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
}  # fmt: skip
BLOCK: Tables = {"refractor": {"box_mm": (10.0, 10.0, 10.0), "index": 1.5}, "name": "block"}


def scene(*media: Tables, targets: Any = (CHART,), **changes: Any) -> lf.Scene:
    settings = {"samples": 2, "replicates": 2, "split": "transmit", "threads": 1}
    made = lf.Scene(camera=camera_without_array(), media=list(media), targets=list(targets), transport=settings)  # type: ignore[arg-type]
    return made.changed(changes)


def point_spread(given: lf.Scene) -> object:
    return lf.point_spread(given, [0.0, 0.0, -150.0])


REFUSED: dict[str, tuple[Callable[[], lf.Scene], Callable[[lf.Scene], object], str]] = {
    "polarised light": (
        lambda: scene(UNIFORM, **{"transport.polarisation": True}), lf.build, r"media\[0\].*polaris|polaris.*media\[0\]"
    ),
    "diffraction at the stop": (
        lambda: scene(UNIFORM, **{"transport.diffraction": "stop"}), lf.render, r"media\[0\].*diffract|diffract.*media"
    ),
    "point spread": (lambda: scene(UNIFORM), point_spread, r"media\[0\]"),
    "camera model": (lambda: scene(UNIFORM), lf.camera_model, r"media\[0\]"),
    "behind the first vertex": (
        lambda: scene(UNIFORM | {"position_mm": (0.0, 0.0, -19.0)}), lf.build, r"media\[0\].*(lens|camera|vertex)"
    ),
    "a block of glass across a face": (
        lambda: scene(UNIFORM, targets=[CHART, BLOCK | {"position_mm": (22.0, 0.0, -80.0)}]), lf.build,
        r"media\[0\].*block|block.*media\[0\]",
    ),
    "a block of glass inside": (
        lambda: scene(UNIFORM, targets=[CHART, BLOCK | AT]), lf.build, r"media\[0\].*block|block.*media\[0\]"
    ),
    "fields that overlap": (
        lambda: scene(UNIFORM, UNIFORM | {"position_mm": (15.0, 15.0, -60.0), "rotation_deg": (0.0, 0.0, 45.0)}),
        lf.build, r"media\[0\].*media\[1\].*overlap",
    ),
    "a step at a face": (lambda: scene(UNIFORM | {"index": 1.0 + 1.2e-3}), lf.build, r"media\[0\].*body of glass"),
    "a formula that steps at a corner": (
        lambda: scene(UNIFORM | {"index": {"kind": "radial_n2", "index": 1.0, "coefficients": [4e-6]}}), lf.build,
        r"media\[0\].*body of glass",
    ),
    "a sphere": (
        lambda: scene(UNIFORM | {"bounds": {"kind": "sphere", "radius_mm": 10.0}}), lf.build, "give it a box or a grid"
    ),
    "no bounds": (lambda: scene({"index": 1.0002}), lf.build, "give it a box or a grid"),
    "inside a body": (
        lambda: scene(UNIFORM | {"inside": "block"}, targets=[CHART, BLOCK | AT]), lf.build, r"media\[0\].*inside"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_supported_is_refused_in_one_line(name: str) -> None:
    make, use, message = REFUSED[name]
    with pytest.raises(lf.LfmeshError, match=message) as refusal:
        use(make())
    assert len(str(refusal.value).splitlines()) == 1


def test_a_body_of_glass_from_a_file_may_not_reach_into_a_field(tmp_path: Path) -> None:
    trimesh.creation.icosphere(2, 6.0).export(tmp_path / "ball.stl")
    ball = {"refractor": {"file": "ball.stl", "units": "mm", "index": 1.5}, "position_mm": (24.0, 0.0, -80.0)}
    with pytest.raises(lf.SceneError, match=r"media\[0\]"):
        lf.build(scene(UNIFORM, targets=[CHART, ball]).in_folder(tmp_path))


ACCEPTED: dict[str, Callable[[], lf.Scene]] = {
    "glass beside a field": lambda: scene(UNIFORM, targets=[CHART, BLOCK | {"position_mm": (25.5, 0.0, -80.0)}]),
    "fields that touch": lambda: scene(UNIFORM, UNIFORM | {"position_mm": (0.0, 40.0, -80.0)}),
    "a large step": lambda: scene(UNIFORM | {"index": 1.0 - 9e-4}),
    "close to the lens": lambda: scene(UNIFORM | {"position_mm": (0.0, 0.0, -21.0)}),
    "a target in a field": lambda: scene(UNIFORM, targets=[CHART, CHART | AT]),
    "hot air that absorbs nothing": lambda: scene(box_of(40.0, temperature_k=900.0, pressure_kpa=101.325) | AT),
}


@pytest.mark.parametrize("name", ACCEPTED)
def test_scenes_at_the_limits_are_rendered(name: str) -> None:
    image = lf.render(ACCEPTED[name]())
    assert image.mean.sum() > 0.0
    assert abs(image.ledger.imbalance) < 1e-12


def test_a_coarse_grid_is_named(tmp_path: Path) -> None:
    """A ball that two voxels span: its deflection is wrong by more than a per cent, and the picture says so."""
    given = scene(ball_of(tmp_path, 1e-3, 2.0, 17) | AT).in_folder(tmp_path)
    with pytest.warns(lf.PictureWarning, match=r"media\[0\].*half as many voxels"):
        lf.render(given)


def test_without_media_that_bend_light_no_table_is_built() -> None:
    """A medium that absorbs alone pays nothing for those that bend light."""
    fog = {"bounds": {"kind": "box", "size_mm": [40.0] * 3}, "absorption_per_mm": 0.01} | AT
    assert lf.build(scene(fog)).tables.objects.fields is None
    assert lf.build(scene(UNIFORM)).tables.objects.fields is not None


def test_a_field_of_the_airs_index_changes_no_picture() -> None:
    """Its chords are straight: the picture is that without it, to rounding."""
    plain, faint = (lf.render(scene(*media)) for media in ((), (UNIFORM | {"index": 1.0},)))
    np.testing.assert_allclose(faint.mean, plain.mean, rtol=1e-9)
