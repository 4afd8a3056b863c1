"""Pictures: every part is there, in its colour, at its place."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import cKDTree

import lfmesh as lf
from lfmesh.geometry import frame as frames
from lfmesh.scene import loads
from lfmesh.view.rays import launch
from lfmesh.view.rays.paths import Rays
from lfmesh.view.scene3d import pick
from lfmesh.view.scene3d.array_shape import MOST_LENSLETS, PATCH, all_cells, caps, cells_near
from lfmesh.view.scene3d.colours import tint
from lfmesh.view.scene3d.plotter import View
from tests.frames import motion
from tests.view.conftest import SCENE, SIZE, shot

from .test_pick import pixel_corner

pytestmark = pytest.mark.drawing

CORNERS = [(4.5, 4.5), (4.5, 114.5), (94.5, 4.5), (94.5, 114.5)]
"""Row and column in the middle of ten pixels at each corner of the sensor."""


@pytest.mark.parametrize("bright", range(4))
@pytest.mark.parametrize("behind", [False, True])
def test_an_image_lies_on_the_sensor_as_it_was_recorded(
    conventional: lf.World, views: Callable[..., View], bright: int, behind: bool
) -> None:
    row, column = CORNERS[bright]
    picture = np.zeros((100, 120, 3), np.uint8)
    picture[round(row - 4.5) : round(row + 5.5), round(column - 4.5) : round(column + 5.5)] = [255, 250, 5]
    view = views(conventional, picture)
    view.look("whole" if behind else "sensor")
    seen = shot(view)
    for number, (r, c) in enumerate(CORNERS):
        x, y = np.rint(pick.to_picture(view, pixel_corner(conventional, r, c)[None])[0]).astype(int)
        colour = seen[y - 1 : y + 2, x - 1 : x + 2].reshape(-1, 3).mean(axis=0)
        if number == bright:
            assert colour[:2].min() > 180
            assert colour[2] < 120
        else:
            assert colour.max() < 100


@pytest.mark.parametrize(
    ("preset", "kind"),
    [
        ("whole", "glass"), ("whole", "stop"), ("whole", "sensor"), ("whole", "target"), ("side", "glass"),
        ("side", "array"), ("sensor", "array"), ("lens", "mount"), ("lens", "stop"), ("array", "sensor"),
    ],
)  # fmt: skip
def test_every_part_changes_the_picture_where_it_stands_and_nowhere_else(
    world: lf.World, views: Callable[..., View], preset: str, kind: str
) -> None:
    view = views(world)
    view.look(preset)
    with_part = shot(view)
    actors = [actor for actor in view.plotter.actors.values() if (part := view.part_of(actor)) and part.kind == kind]
    assert actors
    for actor in actors:
        actor.SetVisibility(False)
    changed = np.argwhere(np.abs(with_part - shot(view)).max(axis=2) > 4)[:, ::-1]
    assert len(changed) > 30
    points = np.concatenate([np.asarray(mesh.points) for part, mesh in view.meshes() if part.kind == kind])
    place = pick.to_picture(view, points)
    place = place[np.isfinite(place).all(axis=1)]
    assert (changed >= place.min(axis=0) - 3.0).all()
    assert (changed <= place.max(axis=0) + 3.0).all()


@pytest.mark.parametrize(("wavelength", "strongest"), [(450.0, 2), (532.0, 1), (650.0, 0)])
def test_rays_have_the_colour_of_their_light(
    world: lf.World, views: Callable[..., View], wavelength: float, strongest: int
) -> None:
    rays = launch.from_field_point(world, [2.0, -8.0, -199.0], 8, split="transmit", wavelength_nm=wavelength)
    view = views(world)
    view.show_rays(rays)
    view.look("side")
    seen = shot(view)
    assert view.legend is not None
    assert [label for label, _ in view.legend.entries] == [f"{wavelength:.1f} nm"]
    # Halfway to the lens nothing else is drawn.
    place = pick.to_picture(view, rays.position[rays.offsets[:-1]] * 0.5 + rays.position[rays.offsets[:-1] + 1] * 0.5)
    on_rays = [seen[round(y) - 1 : round(y) + 2, round(x) - 1 : round(x) + 2].reshape(-1, 3) for x, y in place]
    for around in on_rays:
        others = np.delete(around, strongest, axis=1).max(axis=1)
        assert ((around[:, strongest] > 150) & (around[:, strongest] > others + 30)).any()


def test_the_cut_takes_half_the_glass_and_leaves_rays_whole(
    world: lf.World, split_rays: Rays, views: Callable[..., View]
) -> None:
    view = views(world)
    view.show_rays(split_rays)
    whole = {part.label: mesh for part, mesh in view.meshes()}
    before = view.ray_actor.GetMapper().GetInput().bounds
    view.cut(True)
    for part, mesh in view.meshes():
        low, high = mesh.bounds.x_min, mesh.bounds.x_max
        if part.kind in ("glass", "mount", "stop", "array"):
            assert low >= -1e-6
            assert high == pytest.approx(whole[part.label].bounds.x_max)
        else:
            assert low == pytest.approx(whole[part.label].bounds.x_min)
        if part.kind == "glass":
            assert mesh.clean().is_manifold, "the cut has a face"
    assert view.ray_actor.GetMapper().GetInput().bounds == before
    view.cut(False)
    assert all(mesh is whole[part.label] for part, mesh in view.meshes())


def test_a_cut_uncovers_rays_that_glass_tinted(world: lf.World, one_ray: Rays, views: Callable[..., View]) -> None:
    view = views(world)
    middle = one_ray.position[1:3].mean(axis=0)
    view.show_rays(one_ray, width=4.0)
    view.look("lens")
    x, y = np.rint(pick.to_picture(view, middle[None])[0]).astype(int)
    tinted = shot(view)[y, x]
    view.cut(True)
    bare = shot(view)[y, x]
    assert view.ray_mesh is not None
    colour = view.ray_mesh.cell_data["rgba"][0, :3].astype(int)
    # The ray lies on the side that is taken away.
    assert middle[0] < 0.0
    assert np.abs(bare - colour).max() < np.abs(tinted - colour).max()
    assert np.abs(bare - colour).max() < 12


def test_new_rays_take_the_place_of_the_old(
    world: lf.World, one_ray: Rays, split_rays: Rays, views: Callable[..., View]
) -> None:
    view = views(world)
    view.look("side")
    empty = shot(view)
    view.show_rays(split_rays)
    full = shot(view)
    view.show_rays(one_ray)
    one = shot(view)
    view.show_rays(None)
    assert (shot(view) == empty).all()
    assert 0 < (one != empty).any(axis=2).sum() < (full != empty).any(axis=2).sum()


def test_denser_glass_has_another_tint() -> None:
    tints = [tint(n) for n in (1.43, 1.5168, 1.62, 1.75, 1.85)]
    assert len(set(tints)) == len(tints)


LARGE = (
    SCENE.replace("count = [12, 10]", 'layout = "hexagonal"\ncount = [541, 434]')
    .replace("pitch_mm = 1.0\nfocal_length_mm = 3.0", "pitch_mm = 0.02\nfocal_length_mm = 0.06")
    .replace("thickness_mm = 1.0", "thickness_mm = 0.05")
)


def test_a_large_array_is_a_plate_with_real_lenslets_where_they_are_looked_at(views: Callable[..., View]) -> None:
    world = lf.build(loads(LARGE))
    of = world.tables.mla.lenslets
    assert of.lattice.columns * of.lattice.rows > MOST_LENSLETS
    near = (2.0, -1.0)
    columns, rows = cells_near(of.lattice, near)
    centres = of.lattice.centres()[rows, columns]
    assert np.abs(centres.mean(axis=0) - near).max() < of.lattice.pitch
    view = views(world, near_mm=near)
    assert sum(mesh.n_cells for part, mesh in view.meshes() if part.kind == "array") < 200_000
    view.look("array")
    looked_at = frames.points(motion(world, "array", "world"), [[*near, 0.0]])
    from_middle = pick.to_picture(view, looked_at)[0] - np.array(SIZE) / 2
    assert (np.abs(from_middle) < 0.2 * np.array(SIZE)).all()
    view.near((0.0, 0.0))
    bounds = next(mesh for part, mesh in view.meshes() if part.label == "mla").bounds
    assert abs(bounds.x_max) <= 0.5 * (PATCH + 2) * of.lattice.pitch


@pytest.mark.parametrize(
    "form",
    [
        "",
        "form = { decenter_mm = 0.05, radius_error = 0.05, seed = 3 }",
        "conic = [-1.5, 0.2]\nasphere_mm = [[], [0.1]]\nform = { decenter_mm = 0.05 }",
    ],
)
@pytest.mark.parametrize("layout", ["square", "hexagonal"])
def test_drawn_lenslets_are_those_of_the_whole_mesh(layout: str, form: str) -> None:
    text = SCENE.replace("count = [12, 10]", f'layout = "{layout}"\n{form}\ncount = [12, 10]')
    world = lf.build(loads(text.replace("focal_length_mm = 3.0", "focal_length_mm = [3.0, 2.5]")))
    of = world.tables.mla.lenslets
    drawn = caps(of, *all_cells(of.lattice))
    to_array = motion(world, "world", "array")
    traced = frames.points(to_array, world.mesh("mla").vertices)
    curved = traced[traced[:, 2] < of.valley + 1e-9]
    assert len(curved) > 12 * 10 * 16
    distance, nearest = cKDTree(drawn.points).query(curved)
    assert distance.max() < 1e-9
    assert len(np.unique(nearest)) > 0.5 * len(np.unique(curved.round(9), axis=0))
    assert (np.bincount(drawn.cells) > 0).sum() == 12 * 10
