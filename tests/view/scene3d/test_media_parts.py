"""Media in a 3D view: bodies where they are, shells of what varies, names, and words of their amounts."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.scene import loads
from lfmesh.view.scene3d import pick
from lfmesh.view.scene3d.describe import describe
from lfmesh.view.scene3d.media_parts import LEVELS
from lfmesh.view.scene3d.parts import Part, parts
from lfmesh.view.scene3d.plotter import View
from tests.view.conftest import SCENE, SIZE, shot

pytestmark = pytest.mark.drawing

CENTRE = np.array([4.0, 3.0, -150.0])


def world_of(medium: dict[str, Any], **more: Any) -> lf.World:
    placed = {"name": "smoke", "position_mm": CENTRE.tolist(), **medium}
    return lf.build(loads(SCENE).changed({"media": [placed], **more}))


def bodies(world: lf.World) -> list[Part]:
    return [part for part in parts(world) if part.kind == "medium" and not part.mesh.n_lines]


def test_a_medium_with_bounds_is_a_translucent_body() -> None:
    ball = {"bounds": {"kind": "sphere", "radius_mm": 12.0}, "scattering_per_mm": 0.05}
    (body,) = bodies(world_of(ball))
    points = np.asarray(body.mesh.points, dtype=np.float64)
    assert np.linalg.norm(points - CENTRE, axis=1) == pytest.approx(12.0, rel=1e-3)
    assert 0.0 < body.look["opacity"] < 0.5
    (thin,) = bodies(world_of({**ball, "scattering_per_mm": 0.001}))
    assert thin.look["opacity"] < body.look["opacity"], "the denser, the more opaque"


def test_a_medium_that_varies_is_drawn_as_shells_of_equal_amount(tmp_path: Path) -> None:
    """Of a Gaussian ball they are spheres of the radii at which it has the amounts."""
    width, spacing = 6.0, 1.5
    axis = spacing * (np.arange(41) - 20.0)
    r2 = axis[:, None, None] ** 2 + axis[:, None] ** 2 + axis**2
    np.savez(tmp_path / "ball.npz", emission_w_mm3_sr=1e-6 * np.exp(-0.5 * r2 / width**2), spacing_mm=spacing)
    world = world_of({"grid": str(tmp_path / "ball.npz")})
    shells = bodies(world)
    assert len(shells) == len(LEVELS)
    for shell, level in zip(shells, LEVELS, strict=True):
        radii = np.linalg.norm(np.asarray(shell.mesh.points, dtype=np.float64) - CENTRE, axis=1)
        assert radii == pytest.approx(width * np.sqrt(-2.0 * np.log(level)), abs=0.1 * spacing)
    assert dict(describe(world, "media[0]"))["effect"] == "emits up to 1e-06 W/(mm³ sr)"


def test_a_medium_that_bends_light_is_described_by_its_law() -> None:
    """Air that absorbs nothing does not glow."""
    box = {"bounds": {"kind": "box", "size_mm": [10.0, 10.0, 10.0]}}
    air = dict(describe(world_of(box | {"temperature_k": 400.0, "pressure_kpa": 101.3}), "media[0]"))
    assert (air["effect"], air["pressure_kpa"], air["temperature_k"]) == ("bends light", "101.3", "400")
    formula = {"kind": "radial_n", "index": 1.0, "coefficients": [-1e-6]}
    lens = dict(describe(world_of(box | {"index": formula, "absorption_per_mm": 0.01}), "media[0]"))
    assert lens["effect"] == "absorbs 0.01 per mm, bends light"
    assert lens["index"] == "gradient radial_n, n = 1 at the vertex"


def test_a_medium_is_named_in_the_picture_and_in_the_caption(views: Callable[..., View]) -> None:
    view = views(world_of({"bounds": {"kind": "sphere", "radius_mm": 12.0}, "scattering_per_mm": 0.05}))
    view.look("object")
    named = shot(view)
    view.overlay.only_scale(True)
    bare = shot(view)
    view.overlay.only_scale(False)
    top = pick.to_picture(view, np.add(CENTRE, [0.0, 12.0, 0.0])[None])[0]
    x, y = np.rint(top).astype(int)
    changed = np.abs(named - bare).max(axis=2)[max(0, y - 20) : y + 3, x - 40 : x + 40]
    assert (changed > 60).sum() > 20, "letters above its top"
    view.write(["a view"])
    assert view.caption == ["a view", "smoke scatters 0.05 per mm"]


def place_of_name(view: View) -> np.ndarray | None:
    """Return the corners of the only name in a picture, its lower left and upper right one; None if it is hidden."""
    shot(view)
    (name,) = view.overlay.names
    if not name.text.GetVisibility():
        return None
    x, y = name.text.GetPosition() * np.array(SIZE)
    wide, high = name.size_px
    return np.array([[x - 0.5 * wide, y], [x + 0.5 * wide, y + high]])


def test_a_name_stays_in_the_picture_of_its_medium_and_in_no_other(views: Callable[..., View]) -> None:
    """The tops of a wide fog and of a narrow one: outside the picture, and in it."""
    for height, inside in ((300.0, False), (30.0, True)):
        fog = {"bounds": {"kind": "box", "size_mm": [300.0, height, 60.0]}, "scattering_per_mm": 0.01}
        view = views(world_of(fog))
        view.write([])
        view.look("object")
        top = pick.to_picture(view, np.add(CENTRE, [0.0, 0.5 * height, 0.0])[None])[0]
        assert bool(((top >= 0.0) & (top <= SIZE)).all()) == inside
        place = place_of_name(view)
        assert place is not None
        assert (place >= 0.0).all()
        assert (place <= SIZE).all()
        view.look("sensor")
        assert place_of_name(view) is None, "it is behind the eye"


def test_names_at_one_place_are_written_below_each_other(views: Callable[..., View]) -> None:
    ball = {"bounds": {"kind": "sphere", "radius_mm": 12.0}, "scattering_per_mm": 0.05, "position_mm": CENTRE.tolist()}
    view = views(lf.build(loads(SCENE).changed({"media": [ball | {"name": name} for name in ("smoke", "steam")]})))
    view.look("object")
    shot(view)
    first, second = view.overlay.names
    apart = np.abs(np.subtract(first.text.GetPosition(), second.text.GetPosition())) * SIZE
    assert apart[1] >= max(first.size_px[1], second.size_px[1])


@pytest.mark.parametrize("preset", ["whole", "side", "object"])
@pytest.mark.parametrize("z_mm", [-120.0, -300.0], ids=["before", "behind"])
def test_media_before_and_behind_a_target_are_in_the_picture(
    views: Callable[..., View], preset: str, z_mm: float
) -> None:
    ball = {"bounds": {"kind": "sphere", "radius_mm": 12.0}, "scattering_per_mm": 0.05}
    world = world_of({**ball, "position_mm": [2.0, 3.0, z_mm]})
    view = views(world)
    view.look(preset)
    (body,) = bodies(world)
    place = pick.to_picture(view, np.asarray(body.mesh.points, dtype=np.float64))
    assert (place >= 0.0).all()
    assert (place <= SIZE).all()


def test_fog_far_behind_a_target_does_not_make_it_small(views: Callable[..., View]) -> None:
    card = np.array([[-15.0, -10.0, -200.0], [15.0, 10.0, -200.0]])
    sizes = []
    for length in (100.0, 10_000.0):
        fog = {"bounds": {"kind": "box", "size_mm": [60.0, 60.0, length]}, "scattering_per_mm": 0.001}
        view = views(world_of({**fog, "position_mm": [0.0, 0.0, -150.0 - 0.5 * length]}))
        view.look("object")
        sizes.append(np.ptp(pick.to_picture(view, card), axis=0))
    assert sizes[1] == pytest.approx(sizes[0])


def test_an_eye_in_fog_sees_between_clipping_planes_far_from_it(views: Callable[..., View]) -> None:
    """The distance of the eye from the fog is 0, which must not count, as near planes reduce the depth resolution."""
    fog = {"bounds": {"kind": "box", "size_mm": [300.0, 300.0, 160.0]}, "scattering_per_mm": 0.001}
    view = views(world_of({**fog, "position_mm": [0.0, 0.0, -100.0]}))
    bare = views(lf.build(loads(SCENE)))
    for each in (view, bare):
        each.plotter.camera.position = (40.0, 30.0, -60.0)
        each.plotter.camera.focal_point = (0.0, 0.0, -200.0)
        each.plotter.renderer.ResetCameraClippingRange()
        shot(each)
    near = [each.plotter.camera.clipping_range[0] for each in (view, bare)]
    assert near[0] == pytest.approx(near[1], rel=0.1)


def test_fog_without_bounds_stands_in_the_caption(views: Callable[..., View]) -> None:
    fog = {"scattering_per_mm": 0.001, "position_mm": [0.0, 0.0, 0.0]}
    view = views(world_of(fog))
    view.write([])
    assert view.caption == ["smoke, everywhere before the camera, scatters 0.001 per mm"]
    assert not bodies(view.world)


def test_a_click_reaches_through_a_medium_or_else_describes_it(views: Callable[..., View]) -> None:
    """A ball of smoke before a card and beside it."""
    medium = {"bounds": {"kind": "sphere", "radius_mm": 25.0}, "scattering_per_mm": 0.01}
    view = views(world_of(medium))
    view.look("object")
    card, beside = pick.to_picture(view, np.array([[0.0, 0.0, -200.0], np.add(CENTRE, [0.0, 23.0, 0.0])]))
    through = pick.pick(view, *card)
    assert isinstance(through, pick.PickedPart)
    assert through.name == "targets[0]"
    alone = pick.pick(view, *beside)
    assert alone == pick.PickedPart("media[0]", "medium")
