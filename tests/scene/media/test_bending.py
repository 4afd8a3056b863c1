"""Keys of media that bend light, and what is refused of them."""

import pytest

from lfmesh.errors import SceneError
from lfmesh.scene import Medium, Scene, loads
from lfmesh.scene.camera.gradient import RadialGradient
from tests.cameras import camera_without_array

BOX = {"kind": "box", "size_mm": [10.0, 10.0, 10.0]}
LENS = {"kind": "radial_n", "index": 1.0, "coefficients": [-1e-7]}
DARK = {"bounds": BOX, "position_mm": [0.0, 0.0, -150.0]}


@pytest.mark.parametrize(
    "values",
    [
        {"index": 1.0003},
        {"index": 0.9999},
        {"index": LENS},
        {"index": LENS | {"index": 0.9998}},
        {"density_kg_m3": 1.1},
        {"density_kg_m3": 0.0},
        {"density_kg_m3": 0.16, "gladstone_dale_m3_kg": 1.96e-4},
        {"temperature_k": 400.0, "pressure_kpa": 101.3},
        {"pressure_kpa": 101.3, "grid": "hot.npz"},
    ],
)
def test_a_medium_bends_light_by_each_of_its_laws(values: dict[str, object]) -> None:
    medium = Medium(**{"bounds": BOX} | values)  # type: ignore[arg-type]
    assert medium.bends
    assert not Medium(bounds=BOX, absorption_per_mm=0.1).bends  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"index": 0.0}, r"index = 0\.0: must be above 0"),
        ({"index": 11.0}, "must be 10 or less"),
        ({"index": float("nan")}, "index"),
        ({"index": "SCHOTT/N-BK7"}, "must be a number"),
        ({"index": True}, "must be a number"),
        ({"index": {"kind": "lens", "index": 1.0}}, "valid kinds are radial_n2, radial_n"),
        ({"index": {"kind": "radial_n", "index": 1.0}}, "index.coefficients: missing"),
        ({"density_kg_m3": -1.0}, "density_kg_m3"),
        ({"density_kg_m3": 1.0, "gladstone_dale_m3_kg": 0.0}, "gladstone_dale_m3_kg"),
        ({"index": 1.0001, "density_kg_m3": 1.0}, "density_kg_m3 = 1.0: index is given too.*give one of them"),
        ({"density_kg_m3": 1.0, "pressure_kpa": 99.0, "temperature_k": 300.0}, "pressure_kpa = 99.0: density_kg_m3"),
        ({"index": 1.0001, "gladstone_dale_m3_kg": 2e-4}, "index sets the index without it"),
        ({"gladstone_dale_m3_kg": 2e-4}, "needs density_kg_m3"),
        ({"pressure_kpa": 99.0}, "needs temperature_k"),
        ({"pressure_kpa": -1.0, "temperature_k": 300.0}, "pressure_kpa"),
        ({"temperature_k": 300.0}, "with pressure_kpa it bends light"),
        ({"index": 1.0001, "bounds": None}, "missing beside index.*give it a box or a grid"),
        ({"index": 1.0001, "bounds": {"kind": "sphere", "radius_mm": 1.0}}, '"sphere".*give it a box or a grid'),
        ({"index": 1.0001, "bounds": {"file": "a.stl", "units": "mm"}}, '"mesh".*give it a box or a grid'),
        ({"index": 1.0001, "inside": "tanks[0] liquid"}, "in air or the object medium only"),
    ],
)
def test_keys_that_give_no_index_or_two_are_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        Medium(**{"bounds": BOX} | values)  # type: ignore[arg-type]


def test_air_that_absorbs_nothing_has_a_temperature_without_bands() -> None:
    air = {"temperature_k": 400.0, "pressure_kpa": 101.3}
    assert not Scene(camera=camera_without_array(), media=[DARK | air]).media[0].may_emit  # type: ignore[arg-type]
    with pytest.raises(SceneError, match=r"temperature_k = 400\.0: needs camera\.sensor\.bands"):
        Scene(camera=camera_without_array(), media=[DARK | air | {"absorption_per_mm": 0.1}])  # type: ignore[arg-type]


def test_a_formula_survives_the_scene_file() -> None:
    scene = Scene(camera=camera_without_array(), media=[DARK | {"index": LENS}, DARK | {"index": 1.0001}])  # type: ignore[arg-type]
    again = loads(scene.dump_toml())
    assert again.media == scene.media
    assert isinstance(again.media[0].index, RadialGradient)


def test_the_density_of_air_takes_the_place_of_its_temperature_at_a_single_wavelength() -> None:
    """Without bands a body of a temperature has no emission, but the index stays."""
    air = {"temperature_k": 400.0, "pressure_kpa": 101.3}
    camera = camera_without_array()
    camera["sensor"]["bands"] = "rgb"
    media = [DARK | air, DARK | air | {"absorption_per_mm": 0.1}]
    still, hot = Scene(camera=camera, media=media).at_line(550.0).media  # type: ignore[arg-type]
    # The ideal gas: p M / (R T), with R of CODATA and M of dry air in the standard atmosphere.
    density = 101.3e3 * 28.96442e-3 / (8.314462618 * 400.0)
    for medium in (still, hot):
        assert medium.density_kg_m3 == pytest.approx(density, rel=3e-5)
        assert medium.temperature_k is None
        assert medium.pressure_kpa is None
    assert still.emission_w_mm3_sr == 0.0
    assert hot.emission_w_mm3_sr == 1.0
