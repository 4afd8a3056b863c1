"""Media inside liquids and glass: Beer and Lambert along refracted ways, radiance over n², and both methods alike.

Ways in the water follow from Snell's law in vectors, shares from Fresnel's equations, both written here or in
`test_particles_in_water`.
"""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.geometry.frame import rotation
from lfmesh.optics.cie import planck_radiance
from tests.cameras import camera_without_array
from tests.instances import instances
from tests.renders import unchecked
from tests.validation.test_particles_in_water import bent

Array = NDArray[np.float64]

LIQUID = "tanks[0] liquid"
LEVEL = 1e-3
"""Of all comparisons of a test together, after Bonferroni."""


def tank(**changes: Any) -> dict[str, Any]:
    return {
        "size_mm": (60.0, 60.0, 40.0), "wall_mm": 4.0, "wall": {"index": 1.5}, "liquid": {"index": 1.333},
        "position_mm": (0.0, 0.0, -150.0), **changes,
    }  # fmt: skip


def scene(media: list[dict[str, Any]], pixels: int = 4, pixel_mm: float = 0.4, **parts: Any) -> lf.Scene:
    given: dict[str, Any] = {"camera": camera_without_array(pixels=pixels, pixel_mm=pixel_mm), "tanks": [tank()]}
    return lf.Scene(**(given | {"media": media} | parts))


def test_dye_in_water_weakens_light_along_its_refracted_way() -> None:
    """Random tanks, indices, coefficients and rays: exp(−κ s) of the same rays in clear water, within 1e-12."""
    draw = np.random.default_rng(21)
    for _ in range(4):
        turn = draw.uniform(-25.0, 25.0, 3)
        index, kappa, alpha = draw.uniform(1.2, 1.8), 10.0 ** draw.uniform(-4.0, -0.5), draw.uniform(0.0, 0.05)
        thick = draw.uniform(5.0, 20.0)
        water = tank(rotation_deg=turn.tolist(), liquid={"index": index, "absorption_per_mm": alpha})
        cut = {"kind": "box", "size_mm": (500.0, 500.0, thick)}
        dyes = [
            {"inside": LIQUID, "absorption_per_mm": 0.4 * kappa},
            {"inside": LIQUID, "scattering_per_mm": 0.6 * kappa, "bounds": cut, "position_mm": (0.0, 0.0, -150.0),
             "rotation_deg": turn.tolist()},
        ]  # fmt: skip
        n = 40
        origins = np.column_stack([draw.uniform(-3.0, 3.0, (n, 2)), np.full(n, -20.0)])
        ways = np.column_stack([draw.uniform(-0.05, 0.05, (n, 2)), -np.ones(n)])
        ends, normal = [], rotation(turn)[:, 2]
        for media in ([], dyes):
            paths = lf.trace(lf.build(scene(media, tanks=[water])), origins, ways, split="transmit")
            straight = (paths.events == 4) & ((paths.position - [0.0, 0.0, -150.0]) @ normal < -19.9)
            ends.append(np.bincount(paths.source[straight], paths.weight[straight], minlength=n))
        d = bent(bent(ways / np.linalg.norm(ways, axis=1)[:, None], -normal, 1.0, 1.5)[0], -normal, 1.5, index)[0]
        through = 1.0 / np.abs(d @ normal)
        depth = 0.4 * kappa * 32.0 * through + 0.6 * kappa * thick * through
        assert (ends[0] > 0.0).all()
        np.testing.assert_allclose(ends[1] / ends[0], np.exp(-depth), rtol=1e-12 * (1.0 + depth.max()))


def test_dye_in_a_ball_of_glass_follows_its_curved_faces(tmp_path: Path) -> None:
    """Patches stand off their facets: the way between the vertices that are recorded counts, not that to the facets."""
    kappa = 0.05
    trimesh.creation.icosphere(2, 12.0).export(tmp_path / "ball.stl")
    glass = {"file": "ball.stl", "units": "mm", "index": 1.5, "surface": "patch", "crease_deg": 60.0}
    ball = {"refractor": glass, "name": "ball", "position_mm": (0.0, 0.0, -150.0)}
    draw = np.random.default_rng(4)
    origins = np.column_stack([draw.uniform(-4.0, 4.0, (60, 2)), np.full(60, -60.0)])
    bare = scene([], tanks=(), targets=[ball]).in_folder(tmp_path)
    clear, world = (
        lf.build(bare.changed({"media": media})) for media in ((), [{"inside": "ball", "absorption_per_mm": kappa}])
    )
    ends = [lf.trace(each, origins, [[0.0, 0.0, -1.0]] * 60, split="transmit", record=True) for each in (world, clear)]
    assert len(ends[0]) == len(ends[1]) > 50
    for k in range(len(ends[0])):
        assert ends[0].source[k] == ends[1].source[k]
        way = ends[0].vertices(k)
        inside = sum(
            np.linalg.norm(b.position - a.position)
            for a, b in pairwise(way)
            if "glass" in a.surface and "glass" in b.surface
        )
        assert ends[0].weight[k] / ends[1].weight[k] == pytest.approx(np.exp(-kappa * inside), rel=1e-11)


def test_hot_water_shines_as_a_black_body_through_its_window() -> None:
    """Opaque and isothermal, it has n² of Planck's radiance inside; beyond the window that is Planck's times T."""
    kelvin, center = 1800.0, 600.0
    band = [{"name": "R", "center_nm": center, "fwhm_nm": 2.0}]
    soot = {"inside": LIQUID, "absorption_per_mm": 40.0, "temperature_k": kelvin}
    camera = camera_without_array(pixels=2, pixel_mm=0.1)
    camera["lens"]["surfaces"][0]["semi_diameter_mm"] = camera["lens"]["surfaces"][1]["semi_diameter_mm"] = 1.0
    camera["sensor"]["bands"] = band
    settings = {"split": "transmit", "samples": 256, "seed": 2}
    black = {"shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0}, "position_mm": (0.0, 0.0, -130.0),
             "material": {"reflectance": 0.0, "temperature_k": kelvin}}  # fmt: skip
    water = unchecked(lf.Scene(camera=camera, tanks=[tank()], media=[soot], transport=settings)).mean.sum()  # type: ignore[arg-type]
    plate = unchecked(lf.Scene(camera=camera, targets=[black], transport=settings)).mean.sum()  # type: ignore[arg-type]
    normal = np.array([[0.0, 0.0, 1.0]])
    share = bent(normal, normal[0], 1.333, 1.5)[1] * bent(normal, normal[0], 1.5, 1.0)[1]
    assert planck_radiance(np.array([center]), kelvin)[0] > 0.0
    assert water / plate == pytest.approx(float(share[0]), rel=1e-4)


CASES = {
    "glow": ([{"inside": LIQUID, "absorption_per_mm": 0.02, "emission_w_mm3_sr": 1e-3, "scattering_per_mm": 0.03,
               "phase": {"kind": "henyey_greenstein", "g": 0.6}, "bounds": {"kind": "sphere", "radius_mm": 6.0},
               "position_mm": (1.0, 2.0, -148.0)}], ()),
    "lit fog in water": ([{"inside": LIQUID, "scattering_per_mm": 0.01, "absorption_per_mm": 0.005}],
                         [{"kind": "point", "position_mm": (100.0, 30.0, -100.0), "power_w": 1.0}]),
}  # fmt: skip


@pytest.mark.parametrize("case", instances(CASES, long=["glow"]))
def test_forward_equals_adjoint_in_a_tank(case: str) -> None:
    """In a tilted tank whose water absorbs, by z-tests of four quarters and the whole."""
    media, lights = CASES[case]
    water = tank(rotation_deg=(4.0, 9.0, 0.0), liquid={"index": 1.333, "absorption_per_mm": 0.004})
    images = []
    for method, samples in (("adjoint", 2048), ("forward", 8192)):
        settings = {"samples": samples, "replicates": 16, "method": method, "seed": 3, "split": "transmit"}
        images.append(unchecked(scene(media, tanks=[water], lights=lights, transport=settings)))
    sums = [
        np.append(each.sum(axis=(1, 3)).ravel(), each.sum())
        for image in images
        for each in ((image.mean[..., 0]).reshape(2, 2, 2, 2), (image.stderr[..., 0] ** 2).reshape(2, 2, 2, 2))
    ]
    z = (sums[0] - sums[2]) / np.sqrt(sums[1] + sums[3])
    assert sums[0][-1] > 0.0
    assert 2.0 * stats.norm.sf(np.abs(z).max()) > LEVEL / (len(z) * len(CASES))
    assert all(abs(image.ledger.imbalance) < 1e-12 for image in images)


def test_forward_passes_walls_of_the_index_of_the_water() -> None:
    """Light of a medium behind walls of the liquid's own index: as by the adjoint method, by a z-test of the whole."""
    water = tank(wall={"index": 1.333})
    images = [
        unchecked(scene(CASES["glow"][0], tanks=[water], transport=settings))
        for settings in (
            {"samples": samples, "replicates": 16, "method": method, "seed": 5, "split": "transmit"}
            for method, samples in (("adjoint", 512), ("forward", 4096))
        )
    ]
    sums, variances = [each.mean.sum() for each in images], [(each.stderr**2).sum() for each in images]
    z = (sums[0] - sums[1]) / np.sqrt(sum(variances))
    assert sums[1] > 0.0
    assert 2.0 * stats.norm.sf(abs(z)) > LEVEL


@pytest.mark.parametrize(
    ("medium", "message"),
    [
        ({"absorption_per_mm": 0.1, "inside": "water"}, r"inside = \"water\": no body .* are \"tanks\[0\] wall\", "),
        ({"absorption_per_mm": 0.1, "bounds": {"kind": "sphere", "radius_mm": 5.0}, "position_mm": (0.0, 0.0, -150.0)},
         r"media\[0\]: lies inside tanks\[0\] liquid, which displaces its surroundings; give inside = \"tanks\[0\] "),
        ({"absorption_per_mm": 0.1, "bounds": {"kind": "sphere", "radius_mm": 5.0}, "inside": LIQUID,
          "position_mm": (0.0, 0.0, -90.0)}, r"media\[0\]: lies wholly outside tanks\[0\] liquid"),
        ({"scattering_per_mm": 0.1, "inside": LIQUID, "phase": {"kind": "mie", "diameter_um": 2.0, "index": 1.333}},
         r"media\[0\].phase.index = 1.333: equals the index of the surroundings"),
    ],
)  # fmt: skip
def test_media_that_are_nowhere_are_refused(medium: dict[str, Any], message: str) -> None:
    with pytest.raises(lf.LfmeshError, match=message):
        lf.build(scene([medium]))


def test_spheres_in_water_scatter_by_the_index_of_water() -> None:
    """Where `surrounding_index` is left out, it is that of the place."""
    phase = {"kind": "mie", "diameter_um": 3.0, "index": 1.59}
    tables = [
        lf.build(scene([{"inside": inside, "scattering_per_mm": 0.1, "phase": phase | given}])).tables.objects.volumes
        for inside, given in ((LIQUID, {}), (LIQUID, {"surrounding_index": 1.333}), (None, {}))
    ]
    np.testing.assert_array_equal(tables[0].phases.values, tables[1].phases.values)
    assert not np.array_equal(tables[0].phases.values, tables[2].phases.values)


@pytest.mark.parametrize("wavelengths_nm", [(587.6, 450.0), (450.0, 587.6)])
def test_water_absorbs_at_the_wavelength_of_the_trace(wavelengths_nm: tuple[float, float]) -> None:
    """Fog in water that is clear at one wavelength, traced at the other: bitwise as in a scene of that one."""
    alpha = {"wavelengths_nm": [400.0, 500.0, 700.0], "values": [0.05, 0.0, 0.0]}
    water = tank(liquid={"index": 1.333, "absorption_per_mm": alpha})
    fog = [{"inside": LIQUID, "scattering_per_mm": 0.03}]
    draw = np.random.default_rng(1)
    origins = np.column_stack([draw.uniform(-3.0, 3.0, (500, 2)), np.full(500, -20.0)])
    ways = np.column_stack([draw.uniform(-0.05, 0.05, (500, 2)), -np.ones(500)])
    of_scene, traced = wavelengths_nm
    other, own = (
        lf.trace(
            lf.build(scene(fog, tanks=[water], transport={"wavelengths_nm": [each]})),
            origins, ways, traced, split="transmit",
        )
        for each in (of_scene, traced)
    )  # fmt: skip
    assert other.weight.tobytes() == own.weight.tobytes()
    assert other.ledger.absorbed == own.ledger.absorbed
    assert ("inside tanks[0] liquid" in own.ledger.absorbed) == (traced == 450.0)
    assert abs(own.ledger.imbalance) < 1e-12
