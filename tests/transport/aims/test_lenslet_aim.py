"""Paths start in all directions, with the density that their weights say; none through a lenslet next to its own."""

import re
from copy import copy
from typing import Any

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.transport.aims.lenslet_faces import slope_to, solid_angle
from lfmesh.transport.checks.blind_check import without_aim
from lfmesh.transport.engine import Workspace
from lfmesh.transport.packets.packet import BY_MESH, PLATE
from lfmesh.transport.packets.random import run_key
from lfmesh.transport.render.render import Renderer
from lfmesh.transport.settings import options_of
from lfmesh.transport.sources.pixels import PixelSource
from lfmesh.transport.tables.lights import MM2
from lfmesh.transport.tables.lines import Nodes
from tests.cameras import bench_camera
from tests.renders import of_world

Array = NDArray[np.float64]

LEVEL = 1e-3
"""Chance that a test fails though the law holds, shared by its comparisons (Bonferroni)."""

REPLICATES, RAYS = 40, 1600

LENS = {"surfaces": [{"radius_mm": 30.0, "thickness_mm": 4.0, "index": 1.5, "semi_diameter_mm": 9.0},
                     {"radius_mm": -30.0, "thickness_mm": 2.0, "semi_diameter_mm": 9.0},
                     {"stop": True, "semi_diameter_mm": 8.0}]}  # fmt: skip
# Deep faces in thick glass under a wide opening: most rays cross the layer of faces at 10 to 30 degrees.
SQUARE = {"layout": "square", "count": [8, 8], "pitch_mm": 0.5, "radius_mm": 0.5, "index": 1.6, "thickness_mm": 0.7}
HEXAGONAL = SQUARE | {"layout": "hexagonal", "count": [8, 9]}
TYPES = {"radius_mm": [0.45, 0.55, 0.7]}
FORM = {"form": {"decenter_mm": 0.02, "radius_error": 0.05, "seed": 3}}
ASKEW = {"pose": {"tilt_deg": [4.0, -3.0, 5.0], "shift_mm": [0.1, -0.1, 0.0]}}

ARRAYS: dict[str, dict[str, Any]] = {
    "square": SQUARE,
    "square, to the sensor": SQUARE | {"curved_side": "sensor"},
    "hexagonal, three types": HEXAGONAL | TYPES,
    "hexagonal, three types, to the sensor": HEXAGONAL | TYPES | {"curved_side": "sensor"},
    "hexagonal, form errors, tilted": HEXAGONAL | FORM | ASKEW,
    "square, form errors, to the sensor, tilted": SQUARE | FORM | ASKEW | {"curved_side": "sensor"},
    "concave": SQUARE | {"radius_mm": -0.6},
    "near hemispheres": SQUARE | {"radius_mm": 0.36},
    "near hemispheres, to the sensor": HEXAGONAL | {"radius_mm": 0.293, "curved_side": "sensor"},
    # They turn back at 0.6 of the way to their corners, so that some flat rays cross them more than once.
    "aspheres that turn back": SQUARE | {"radius_mm": 0.4, "conic": -1.0, "asphere_mm": [-14.0]},
    "steep aspheres": SQUARE | {"radius_mm": 0.3, "conic": -2.0, "asphere_mm": [10.0]},
    "acylinders towards the sensor": SQUARE | {"curved_side": "sensor", "conic": -2.0, "cylinder_axis": "y"} | FORM,
}


def world_of(mla: dict[str, Any]) -> lf.World:
    """A camera whose sensor is near its array, and askew to it."""
    sensor = {"pixels": [32, 32], "pixel_mm": 0.11, "distance_mm": 0.9, "pose": {"tilt_deg": [1.0, 2.0, 0.0]}}
    return lf.build(
        lf.Scene(camera={"focus_mm": 90.0, "lens": LENS, "mla": mla, "sensor": sensor}, targets=[],
                 transport={"split": "transmit", "wavelengths_nm": [450.0, 650.0]})
    )  # fmt: skip


class Starts:
    """Starts paths from a pixel, `samples` at a time, with some changes of the aim."""

    def __init__(self, world: lf.World, samples: int, **shares: float) -> None:
        self.samples = samples
        self._tables = world.tables._replace(aim=world.aim._replace(exit=world.aim.exit._replace(**shares)))
        self._work = Workspace(world, options_of(world)._replace(faces=BY_MESH), tables=self._tables)

    def drawn(self, pixel: int, seed: int, times: int) -> tuple[Array, Array]:
        """Return directions (n, 2), x and y in the sensor's frame, and cos θ over density, (n,), as a mean of `times`.

        Those whose weight is zero are left out.
        """
        tables, work = self._tables, self._work
        work.begin(packets=self.samples * times)
        for key in range(seed * times, (seed + 1) * times):
            PixelSource(np.array([pixel]), self.samples, run_key(key), Nodes.single(1), stratified=False).launch(
                work, range(1)
            )
        packets = work.stacks.waiting(PLATE)
        area = tables.sensor.pixel**2 * MM2
        return np.column_stack([packets["dx"], packets["dy"]]), packets["weight"] / area / times


def lit_pixels(world: lf.World, count: int) -> list[int]:
    """Return pixels from which lenslets may show the opening: some surely, some not."""
    starts = Starts(world, 20, wide_share=0.0, share_without_aim=0.0)
    pixels = np.random.default_rng(1).permutation(world.tables.sensor.columns * world.tables.sensor.rows)
    lit = (int(pixel) for pixel in pixels if len(starts.drawn(int(pixel), 0, 20)[1]) > 250)
    return [pixel for pixel, _ in zip(lit, range(count), strict=False)]


PLAIN = [
    "square", "square, to the sensor", "hexagonal, three types", "hexagonal, form errors, tilted", "concave",
    "near hemispheres", "steep aspheres",
]  # fmt: skip
"""Steeper lenslets, or more of these at once, are among the others."""
DRAWN = [("square", 2), *(pytest.param(n, 16, marks=[pytest.mark.long] if n in PLAIN else []) for n in ARRAYS)]


@pytest.mark.parametrize(("name", "samples"), DRAWN)
def test_directions_have_the_density_that_their_weights_say(name: str, samples: int) -> None:
    """Weights cos θ / density in bins of (dx, dy) bring the bins' areas, whatever the aim: t-tests of all bins.

    With 2 samples chance says of each whose directions it estimates; fewer rays tell that.
    """
    world = world_of(ARRAYS[name])
    pixels = lit_pixels(world, 3)
    assert len(pixels) == 3
    few, starts = Starts(world, 20, wide_share=0.0, share_without_aim=0.0), Starts(world, samples, wide_share=0.4)
    p = []
    for pixel in pixels:
        d, _ = few.drawn(pixel, 0, 20)
        edges = [np.r_[-1.0, np.linspace(*np.quantile(d[:, axis], [0.02, 0.98]), 9), 1.0] for axis in (0, 1)]
        sums = []
        for seed in range(1, REPLICATES + 1):
            d, w = starts.drawn(pixel, seed, min(RAYS // samples, 200))
            sums.append(np.histogram2d(d[:, 0], d[:, 1], edges, weights=w)[0])
        # But for the outermost, which reach beyond the unit circle, as others may.
        area = np.diff(edges[0])[1:-1, None] * np.diff(edges[1])[None, 1:-1]
        corner = np.maximum(edges[0][1:-2] ** 2, edges[0][2:-1] ** 2)[:, None]
        corner = corner + np.maximum(edges[1][1:-2] ** 2, edges[1][2:-1] ** 2)
        inner = np.array(sums)[:, 1:-1, 1:-1] - area
        p.extend(stats.ttest_1samp(inner[:, corner < 1.0], 0.0).pvalue)
        p.append(stats.ttest_1samp(np.sum(sums, axis=(1, 2)), np.pi).pvalue)
    assert len(p) > 150
    assert min(p) * len(p) > LEVEL


def test_an_even_pixel_of_the_lytro_class_has_no_rare_samples() -> None:
    """What a sample brings varies by less than 3 % where the whole opening shows a plane that glows evenly.

    One in a thousand that goes astray, into another lenslet or beside the opening, would make it vary by more.
    """
    plane = {"shape": {"kind": "plane", "width_mm": 900.0, "height_mm": 900.0}, "position_mm": [0, 0, -300.0],
             "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    samples, replicates = 128, 10
    scene = lf.load(asset_path("scenes/lytro_class.toml")).changed(
        {"camera.sensor.pixels": (48, 48), "targets": [plane], "lights": [], "transport.split": "transmit",
         "transport.samples": samples * replicates, "transport.replicates": replicates}
    )  # fmt: skip
    renderer = Renderer(lf.build(scene))
    renderer.stratified = False
    image = renderer.image()
    mean, error = image.mean[..., 0], image.stderr[1:-1, 1:-1, 0]
    # Pixels inside micro-images are as bright as their neighbours; at the borders, where two overlap, these are not.
    even = np.ptp(sliding_window_view(mean, (3, 3)), axis=(2, 3)) < 0.02 * mean[1:-1, 1:-1]
    assert even.sum() > 200
    assert np.mean((error[even] / mean[1:-1, 1:-1][even]) ** 2) * samples * replicates < 1e-3


def test_lenslets_that_see_half_of_space_are_aimed_at_no_worse_than_by_chance(emitting_plane: dict[str, Any]) -> None:
    """Hundreds of lenslets show the opening to each pixel, most of them from far aside, where they look small.

    The spread of the whole image, over seeds, against that of as many rays that go anywhere: a ratio of variances that
    chance exceeds once in a thousand (F distribution) if they are one. With all lenslets as likely it was 9.
    """
    lens = [
        {"radius_mm": 82.326, "thickness_mm": 1.3027, "index": 1.7075, "semi_diameter_mm": 4.687},
        {"radius_mm": -82.326, "thickness_mm": 7.8056, "semi_diameter_mm": 4.687},
        {"stop": True, "thickness_mm": 7.7678, "semi_diameter_mm": 0.897},
        {"radius_mm": 82.326, "thickness_mm": 1.3027, "index": 1.7075, "semi_diameter_mm": 4.687},
        {"radius_mm": -82.326, "semi_diameter_mm": 4.687},
    ]
    mla = {"layout": "hexagonal", "count": [20, 20], "pitch_mm": 0.1147, "radius_mm": 0.06758, "index": 1.7006,
           "thickness_mm": 0.18773}  # fmt: skip
    scene = lf.Scene(
        camera={
            "focus_mm": 300.0,
            "lens": {"surfaces": lens},
            "mla": mla,
            "sensor": {"pixels": [60, 60], "pixel_mm": 0.010467, "distance_mm": 0.11278},
        },
        targets=[emitting_plane],
        transport={"split": "transmit", "replicates": 1},
    )
    aimed = lf.build(scene.changed({"transport.samples": 2}))
    anywhere = copy(aimed)
    anywhere.aim = without_aim(aimed.aim)
    variance = [
        np.var([image.mean.sum() for image in of_world(world, range(16))], ddof=1) for world in (aimed, anywhere)
    ]
    assert variance[0] < stats.f.isf(1e-3, 15, 15) * variance[1]


@pytest.mark.parametrize("glass", [1.3, 1.9])
@pytest.mark.parametrize(
    ("air", "plate"), [(0.0, 1.0), (1e-100, 1.0), (1e-12, 1.0), (1e-3, 1.0), (1e3, 1.0), (1e-100, 0.0), (1.0, 0.0)]
)
def test_how_large_a_lenslet_looks_is_a_number_wherever_it_stands(air: float, plate: float, glass: float) -> None:
    """From one straight ahead to nothing, and never NaN: one of those would take all others with it."""
    far = np.concatenate([[0.0], np.geomspace(1e-6, 1e9, 60)])
    seen = np.array([solid_angle(r, air, plate, glass) for r in far])
    assert seen[0] == pytest.approx(1.0)
    assert (seen >= 0.0).all()
    assert (np.diff(seen) <= 1e-7).all()


@pytest.mark.parametrize(("has_air", "has_plate"), [(True, True), (True, False), (False, True)])
def test_the_ray_to_a_point_goes_there_by_snells_law(has_air: bool, has_plate: bool) -> None:
    rng = np.random.default_rng(7)
    for _ in range(2_000):
        air = 10.0 ** rng.uniform(-6.0, 2.0) if has_air else 0.0
        plate = 10.0 ** rng.uniform(-3.0, 1.0) if has_plate else 0.0
        glass, angle = rng.uniform(1.0, 4.0), rng.uniform(0.0, 1.55)
        inside = np.arcsin(np.sin(angle) / glass)
        sideways = air * np.tan(angle) + plate * np.tan(inside)
        found = slope_to(sideways, air, plate, glass)
        # In how far sideways it goes, which tells steep slopes badly where nearly all of the way is in the plate.
        reached = air * found + plate * np.tan(np.arcsin(found / np.hypot(1.0, found) / glass))
        assert abs(reached - sideways) <= 1e-7 * sideways


def test_an_exit_pupil_in_the_lenslets_is_refused() -> None:
    """A stop 1e15 mm before the array: their distance, and that of the exit pupil, is lost in rounding."""
    far = re.sub(r"(stop = true, thickness_mm = )[0-9.]+", r"\g<1>1e15", bench_camera(4, 4))
    assert far != bench_camera(4, 4)
    world = lf.build(lf.loads(far))
    with pytest.raises(lf.LfmeshError, match="exit pupil lies in the lenslets"):
        world.aim  # noqa: B018  # found when it is asked for
