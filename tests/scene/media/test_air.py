"""`camera.air`: every glass of a scene has its index relative to it, numbers stay, and faults are one line."""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.geometry.objects.tanks import tank_lines
from lfmesh.optics.air import air_index
from lfmesh.optics.glass import absorption_per_mm, refractive_index
from lfmesh.scene.materials.glasses import glass_lines

LENS, ARRAY, COVER, WALL, OWN = "SCHOTT/SF11", "SCHOTT/N-BK7", "SCHOTT/N-SF5", "SCHOTT/N-LAK22", {"nd": 1.5, "vd": 60.0}
PLAIN = 1.333
D_NM = 587.5618


def scene_of(glasses: list[Any], air: dict[str, float] | None = None, **camera: Any) -> lf.Scene:
    """Return a scene with a glass in every place: lens twice, array, cover, tank's wall; its liquid is a number."""
    first, second, array, cover, wall = ({"index": g} if isinstance(g, float) else {"glass": g} for g in glasses)
    surfaces = [
        {"radius_mm": 60.0, "thickness_mm": 6.0, "semi_diameter_mm": 11.0, **first},
        {"radius_mm": -40.0, "thickness_mm": 2.0, "semi_diameter_mm": 11.0, "stop": True, **second},
        {"radius_mm": -200.0, "semi_diameter_mm": 11.0},
    ]
    mla = {"count": (9, 9), "pitch_mm": 0.3, "radius_mm": 0.8, "thickness_mm": 0.4, **array}
    sensor = {"pixels": (27, 27), "pixel_mm": 0.1, "cover": {"thickness_mm": 0.3, "gap_mm": 0.2, **cover}}
    air_key = {} if air is None else {"air": air}
    return lf.Scene(
        camera={"focus_mm": 500.0, "lens": {"surfaces": surfaces}, "mla": mla, "sensor": sensor, **air_key, **camera},
        tanks=[
            {
                "size_mm": (80.0, 80.0, 40.0), "wall_mm": 3.0, "wall": wall, "liquid": {"index": PLAIN},
                "position_mm": (0.0, 0.0, -250.0), "rotation_deg": (5.0, -8.0, 0.0),
            }
        ],
        transport={"wavelengths_nm": [D_NM]},
    )  # fmt: skip


def by_hand(glass: Any, temperature_c: float, pressure_kpa: float, nm: float = D_NM) -> float:
    """Return an index relative to other air: both are known relative to vacuum."""
    in_air = OWN["nd"] if glass == OWN else refractive_index(glass, nm)
    return in_air * air_index(nm, 20.0, 101.325) / air_index(nm, temperature_c, pressure_kpa)


AIRS = [(20.0, 0.0), (20.0, 101.325), (-60.0, 1000.0), (150.0, 35.0)]
GLASSES = [LENS, OWN, ARRAY, COVER, WALL]


@pytest.mark.parametrize("air", AIRS)
def test_every_part_is_that_of_plain_indices_computed_by_hand(air: tuple[float, float]) -> None:
    """First-order figures, and rays of both engines."""
    named = scene_of(GLASSES, {"temperature_c": air[0], "pressure_kpa": air[1]})
    plain = scene_of([by_hand(glass, *air) for glass in GLASSES])
    one, other = lf.first_order(named), lf.first_order(plain)
    assert one.efl_mm == pytest.approx(other.efl_mm, rel=1e-12)
    assert one.image_z_mm == pytest.approx(other.image_z_mm, rel=1e-12)
    for engine in ("mesh", "sequential"):
        worlds = [lf.build(each.changed({"transport.engine": engine})) for each in (named, plain)]
        draw = np.random.default_rng(3)
        origins = np.column_stack([draw.uniform(-20.0, 20.0, (200, 2)), np.full(200, -500.0)])
        ways = np.column_stack([draw.uniform(-8.0, 8.0, (200, 2)), np.zeros(200)]) - origins
        ends = [lf.trace(world, origins, ways, split="transmit", wavelength_nm=D_NM) for world in worlds]
        assert (ends[0].status == lf.Status.SENSOR).sum() > 40
        np.testing.assert_array_equal(ends[0].status, ends[1].status)
        np.testing.assert_allclose(ends[0].position, ends[1].position, rtol=0.0, atol=1e-11)
        np.testing.assert_allclose(ends[0].weight, ends[1].weight, rtol=1e-12)


def test_a_ball_lens_in_vacuum_has_the_focal_length_of_its_index_there() -> None:
    """f = n R / (2 (n − 1)), with N-BK7's index in vacuum from SCHOTT's data sheet: 1.51680 times 1.000272."""
    ball = [
        {"radius_mm": 10.0, "thickness_mm": 20.0, "semi_diameter_mm": 3.0, "glass": ARRAY, "stop": True},
        {"radius_mm": -10.0, "semi_diameter_mm": 3.0},
    ]
    sensor = {"pixels": (9, 9), "pixel_mm": 0.1, "distance_mm": 5.0}
    camera = {"lens": {"surfaces": ball}, "sensor": sensor, "air": {"pressure_kpa": 0.0}}
    n = 1.51680 * 1.000272
    efl = lf.first_order(lf.Scene(camera=camera)).efl_mm
    assert efl == pytest.approx(n * 10.0 / (2.0 * (n - 1.0)), rel=1e-5)


def test_plain_indices_stay_and_the_key_is_used_once() -> None:
    air = {"temperature_c": 0.0, "pressure_kpa": 300.0}
    plain = scene_of([1.6, 1.5, 1.5, 1.5, 1.5])
    assert lf.first_order(scene_of([1.6, 1.5, 1.5, 1.5, 1.5], air)).efl_mm == lf.first_order(plain).efl_mm
    world = lf.build(scene_of(GLASSES, air))
    assert world.scene.camera.air == lf.Air(**air)
    again = lf.build(lf.loads(world.scene.dump_toml()))
    assert lf.first_order(again.scene).efl_mm == lf.first_order(world.scene).efl_mm
    assert f"(n = {by_hand(WALL, 0.0, 300.0):.6g}), liquid n = {PLAIN:g}" in tank_lines(scene_of(GLASSES, air), 1.0)[0]


def test_a_scene_with_air_is_read_as_it_was_written() -> None:
    scene = scene_of(GLASSES, {"temperature_c": 35.0, "pressure_kpa": 60.0})
    assert lf.loads(scene.dump_toml()) == scene
    assert scene.digest != scene_of(GLASSES).digest
    assert scene.changed({"camera.air.pressure_kpa": 70.0}).digest != scene.digest


def test_a_glass_absorbs_in_any_air_as_its_maker_says() -> None:
    """Along the axis, through 6 mm of the first element, 0.4 mm of the array and 0.3 mm of the cover."""
    glasses = [LENS, OWN, ARRAY, COVER, WALL]
    clear, absorbing = (
        lf.trace(
            lf.build(scene_of(glasses, {"pressure_kpa": 0.0}, absorption=absorption)),
            [[0.0, 0.0, -100.0]], [[0.0, 0.0, 1.0]], split="transmit", wavelength_nm=D_NM,
        ).weight[0]
        for absorption in (False, True)
    )  # fmt: skip
    depth = sum(d * absorption_per_mm(g, D_NM) for g, d in ((LENS, 6.0), (ARRAY, 0.4), (COVER, 0.3)))
    assert depth > 1e-3
    assert absorbing / clear == pytest.approx(np.exp(-depth), rel=1e-12)


def test_check_names_the_air() -> None:
    lines = glass_lines(lf.build(scene_of(GLASSES, {"pressure_kpa": 0.0})).scene)
    assert len(lines) == 5
    assert all("in vacuum: " in line for line in lines)
    assert any(line.endswith("sensor's cover") for line in lines)
    (line,) = (each for each in glass_lines(lf.build(scene_of(GLASSES, {"temperature_c": 35.0})).scene) if LENS in each)
    assert "in air of 35 °C and 101.325 kPa" in line


@pytest.mark.parametrize(
    ("air", "line"),
    [
        ({"pressure_kpa": -1.0}, "camera.air.pressure_kpa = -1.0: must be 0 or more"),
        ({"pressure_kpa": float("nan")}, "camera.air.pressure_kpa = nan: must be a finite number"),
        ({"pressure_kpa": 1e6}, "camera.air.pressure_kpa = 1000000.0: must be 1000 or less"),
        ({"temperature_c": -274.0}, "camera.air.temperature_c = -274.0: must be -100 or more"),
        ({"temperature_c": "20 C"}, 'camera.air.temperature_c = "20 C": must be a number'),
        ({"humidity": 0.5}, "camera.air.humidity"),
        (20.0, "camera.air = 20.0"),
    ],
)
def test_faults_are_one_line(air: Any, line: str) -> None:
    with pytest.raises(SceneError) as refused:
        scene_of(GLASSES, air)
    assert line in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1
