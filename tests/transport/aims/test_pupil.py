"""Aiming at the lens's opening changes no pixel's mean, holds what real rays pass, and sends fewer rays in vain."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial import cKDTree

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.geometry import frame as frames
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.transport.aims.lenslet_aim import (
    LISTED,
    ArraySeen,
    cells_that_show,
    lenslets_density,
    list_cells,
    most_listed,
)
from lfmesh.transport.aims.mixture import anywhere
from lfmesh.transport.aims.pupil import opening_from, real_opening, viewpoints
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME, WORLD_FRAME
from lfmesh.transport.render.render import Renderer
from lfmesh.transport.tables.tables import AimTables, LensAim, LensletAim
from tests.instances import instances

Array = NDArray[np.float64]

LEVEL = 1e-3
"""Chance that a scene fails though the law holds, shared by its comparisons (Bonferroni)."""

REPLICATES = 20

# The stop is far from both elements, whose rims cut every oblique bundle.
VIGNETTED = {
    "surfaces": [
        {"radius_mm": 30.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 3.0},
        {"radius_mm": -30.0, "thickness_mm": 6.0, "semi_diameter_mm": 3.0},
        {"stop": True, "thickness_mm": 6.0, "semi_diameter_mm": 2.2},
        {"radius_mm": 30.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 3.0},
        {"radius_mm": -30.0, "semi_diameter_mm": 3.0},
    ]
}
SQUARE = {"layout": "square", "count": [14, 14], "pitch_mm": 0.6, "focal_length_mm": 2.4, "index": 1.5,
          "thickness_mm": 0.5}  # fmt: skip
HEXAGONAL = SQUARE | {"layout": "hexagonal", "count": [14, 16], "focal_length_mm": [2.1, 2.4, 2.8],
                      "curved_side": "sensor"}  # fmt: skip
TILTED = SQUARE | {"pose": {"tilt_deg": [1.0, -0.8, 2.0], "shift_mm": [0.1, -0.1, 0.1]}}


def scene(mla: dict[str, Any] | None, **transport: Any) -> lf.Scene:
    """A field far larger than the lens passes: its corners are dark, and what is before them badly vignetted."""
    camera = {"focus_mm": 60.0, "lens": VIGNETTED, "sensor": {"pixels": [24, 24], "pixel_mm": 0.35}}
    return lf.Scene(
        camera=camera | ({"mla": mla} if mla else {}),
        targets=[{"shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0}, "position_mm": [0, 0, -60.0],
                  "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}],
        transport={"split": "transmit", "samples": 64, "replicates": 1, "threads": 1} | transport,
    )  # fmt: skip


CAMERAS = {"square array": SQUARE, "hexagonal array": HEXAGONAL, "tilted array": TILTED, "no array": None}

Change = Callable[[AimTables], AimTables]


def uniform(aim: AimTables) -> AimTables:
    """Every lenslet for some pitches around, or the whole front or back of the lens: no opening is known.

    A tenth goes into the whole hemisphere, where there is an array.
    """
    return aim._replace(
        entrance=anywhere(aim.entrance),
        exit=anywhere(aim.exit)._replace(wide_share=0.1),
        lenslets=aim.lenslets._replace(slope_radius2=np.full_like(aim.lenslets.slope_radius2, np.inf), search=2.0),
    )


def shrunk(aim: AimTables) -> AimTables:
    """Openings a fifth too small, and nothing that makes up for it.

    Lenslets' a third: with a tilted array they stand out by the range of its distances from the sensor.
    """
    return aim._replace(
        entrance=_narrow(aim.entrance),
        exit=_narrow(aim.exit),
        lenslets=aim.lenslets._replace(
            slope_radius2=np.where(aim.lenslets.slope_radius2 > 0.0, 0.45 * aim.lenslets.slope_radius2, -1.0)
        ),
    )


def _narrow(aim: LensAim) -> LensAim:
    disks = aim.opening.far
    opening = aim.opening._replace(far=disks._replace(radius=0.8 * disks.radius))
    return aim._replace(opening=opening, wide_share=0.0, share_without_aim=0.0)


def images(of: lf.Scene, first: int, change: Change = lambda aim: aim) -> Array:
    """Return REPLICATES images of as many seeds, (n, H, W), with the aim changed."""
    world = lf.build(of)
    renderer = Renderer(changed(world, change), check=False)
    found = []
    for seed in range(first, first + REPLICATES):
        renderer.seed = np.uint64(seed * 7919 + 1)
        found.append(renderer.image().mean[..., 0])
    return np.array(found)


def changed(world: lf.World, change: Change) -> lf.World:
    world.aim = change(world.aim)
    return world


def p_of_difference(one: Array, other: Array) -> float:
    """Return the least p-value of Welch's t-tests of 6 x 6 pixels' sums, and of all, times their number."""
    sums = [np.add.reduceat(np.add.reduceat(i, [0, 6, 12, 18], 1), [0, 6, 12, 18], 2) for i in (one, other)]
    tables = [np.column_stack([s.reshape(len(s), -1), s.sum(axis=(1, 2))]) for s in sums]
    seen = (tables[0].var(axis=0) > 0.0) | (tables[1].var(axis=0) > 0.0)
    p = stats.ttest_ind(tables[0][:, seen], tables[1][:, seen], equal_var=False).pvalue
    return float(p.min()) * len(p)


BOTH_WAYS = [(name, method) for name in CAMERAS for method in ("adjoint", "forward")]
KEPT = [("hexagonal array", "adjoint"), ("tilted array", "forward"), ("no array", "adjoint")]


@pytest.mark.parametrize(
    ("name", "method"), [pytest.param(*each, marks=[] if each in KEPT else [pytest.mark.long]) for each in BOTH_WAYS]
)
def test_aimed_rays_bring_what_rays_to_everywhere_bring(name: str, method: str) -> None:
    here = scene(CAMERAS[name], method=method)
    # Rays to everywhere mostly miss; more of them make up for it.
    everywhere = images(here.changed({"transport.samples": 128}), 1000, uniform)
    assert p_of_difference(images(here, 0), everywhere) > LEVEL
    assert p_of_difference(images(here, 0, shrunk), everywhere) < LEVEL


@pytest.mark.parametrize("seed", instances([4, 8, 9, 11], long=[4, 9, 11]))
def test_aimed_rays_of_a_random_camera_bring_what_rays_to_everywhere_bring(
    seed: int, random_camera: Callable[[int], lf.Scene]
) -> None:
    here = random_camera(seed).changed(
        {"camera.sensor.pixels": (24, 24), "transport.samples": 64, "transport.replicates": 1, "transport.threads": 1}
    )
    everywhere = images(here.changed({"transport.samples": 256}), 1000, uniform)
    aimed = images(here, 0)
    # The comparison is one: both totals are known to 2 %.
    for of in (aimed, everywhere):
        total = of.sum(axis=(1, 2))
        assert stats.sem(total) < 0.02 * total.mean()
    assert p_of_difference(aimed, everywhere) > LEVEL


@pytest.mark.parametrize("name", instances(CAMERAS, long=["square array", "hexagonal array"]))
def test_fewer_rays_are_sent_in_vain(name: str) -> None:
    """The noise at equal samples falls: one-sided paired t-test of the pixels' variances."""
    here = scene(CAMERAS[name], samples=32)
    aimed, everywhere = (images(here, 0, change).var(axis=0, ddof=1) for change in (lambda aim: aim, uniform))
    assert stats.ttest_1samp((everywhere - aimed)[everywhere > 0.0], 0.0, alternative="greater").pvalue < LEVEL


def test_the_opening_holds_what_real_rays_pass_and_little_more() -> None:
    """Rays from points of the sensor to a grid on the lens's back, by the mesh engine, against the table."""
    world = lf.build(scene(None))
    opening = world.aim.exit.opening
    z = world.tables.frames[SENSOR_FRAME, CAMERA_FRAME][2, 3]
    grid = np.linspace(-1.0, 1.0, 61) * world.aim.exit.wide_radius
    for height in (0.0, 0.7, 1.6, 2.4, 3.1):
        x, y = 0.6 * height, -0.8 * height
        to = np.array([(a, b, opening.plane_z) for a in grid for b in grid])
        start = np.tile([x, y, z - 1e-6], (len(to), 1))
        paths = lf.trace(world, start, to - start, split="transmit")
        out = (paths.status == lf.Status.TARGET) | (paths.status == lf.Status.ESCAPED)
        passed = to[paths.source[out]]
        cx, cy, radius = opening_from(opening, (x, y, z))
        assert len(passed) > 50
        off = np.hypot(passed[:, 0] - cx, passed[:, 1] - cy)
        assert off.max() <= radius
        assert radius <= 1.15 * off.max() + (grid[1] - grid[0])


def test_a_point_by_itself_sees_the_lens() -> None:
    """The table ends at the widest of the points that it is made for, which must not fall beyond it by rounding."""
    places = np.random.default_rng(5).uniform((-5.0, -5.0, -90.0), (5.0, 5.0, -50.0), (150, 3))
    lens = lf.build(scene(None)).tables.lens
    dark = []
    for place in places:
        seen = viewpoints(float(lens.box_low[2]), 3.5, place[None], to_sensor=True)
        assert seen is not None
        opening = real_opening(seen, lens, 6.0, 2.2)
        if not opening_from(opening, tuple(place))[2] > 0.0:
            dark.append(place)
    assert not dark


def test_nothing_is_sent_from_where_the_lens_shows_no_opening() -> None:
    world = lf.build(scene(None, samples=256))
    z = world.tables.frames[SENSOR_FRAME, CAMERA_FRAME][2, 3]
    assert opening_from(world.aim.exit.opening, (40.0, 0.0, z))[2] < 0.0
    assert opening_from(world.aim.exit.opening, (0.0, 0.0, z))[2] > 0.0


PLATES = {
    "first light": ("first_light", {}),
    "hexagonal": ("hexagonal", {}),
    "focused": ("focused", {}),
    "Lytro class": ("lytro_class", {}),
    "curved to the sensor": ("first_light", {"camera.mla.curved_side": "sensor"}),
    "tilted": ("first_light", {"camera.mla.pose": {"tilt_deg": (0.6, -0.5, 2.0), "shift_mm": (0.05, -0.03, 0.1)}}),
}


@pytest.mark.parametrize("name", PLATES)
def test_no_path_through_a_lenslets_corner_goes_past_the_cells_aimed_at(name: str) -> None:
    """Rays from the sensor to near where cells meet: each that comes out of the lens could have been drawn.

    One that could not be would carry the weight of the few rays that go anywhere: ten thousands of others.
    """
    file, changes = PLATES[name]
    of = lf.load(asset_path(f"scenes/{file}.toml"))
    small = {"camera.mla.count": (24, 24), "camera.sensor.pixels": (240, 240), "transport.split": "transmit"}
    world = lf.build(of.changed(small | {"targets": [], "lights": []} | changes))
    array, aim, moves = world.tables.mla, world.aim.lenslets, world.tables.frames
    lattice = array.lenslets.lattice
    random = np.random.default_rng(5)
    rays = 60_000
    p = np.zeros((rays, 3))
    p[:, :2] = random.uniform(-0.5, 0.5, (rays, 2)) * world.scene.camera.sensor.size_mm
    p = frames.points(moves[SENSOR_FRAME, MLA_FRAME], p)
    d = corners(lattice, aim, p, random) - p
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    to_world = moves[MLA_FRAME, WORLD_FRAME]
    paths = lf.trace(
        world, frames.points(to_world, p + 1e-9 * d), d @ to_world[:, :3].T, split="transmit", engine="sequential"
    )
    out = paths.source[paths.status == lf.Status.ESCAPED]
    near, cells = (
        np.zeros((most_listed(aim, aim.search) + 1, LISTED)),
        np.zeros(most_listed(aim, aim.search) + 1, np.int64),
    )
    glass = float(array.media.indices[array.medium, 0]) if array.curved_to_lens else 1.0
    past, seen = 0, ArraySeen(array, aim, glass)
    for i in out:
        point = tuple(p[i])
        shown = cells_that_show(seen, near, list_cells(seen, point, (0.0, 0.0), aim.search, near), cells, point, 1.0)
        past += max(lenslets_density(seen, shown, point, tuple(d[i]))) == 0.0
    assert len(out) > 500
    assert past == 0


def corners(lattice: Lattice, aim: LensletAim, p: Array, random: np.random.Generator) -> Array:
    """Return points near corners of cells within some pitches of points p (n, 3) of the array's frame, as seen."""
    centres = lattice.centres().reshape(-1, 2)
    nearest = cKDTree(centres).query(p[:, :2], 12)[1]
    cell = centres[nearest[np.arange(len(p)), random.integers(0, 12, len(p))]]
    around = lattice.corners()
    at = cell + around[random.integers(0, len(around), len(p))]
    at += 0.05 * lattice.pitch * random.uniform(-1.0, 1.0, at.shape)
    return np.column_stack([at, np.full(len(p), aim.apex_z)])
