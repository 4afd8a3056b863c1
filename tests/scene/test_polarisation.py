"""Polarised light in a scene: what lights may have, and what is refused in one clear line."""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import LfmeshError, SceneError
from lfmesh.scene import CircularPolarisation, LinearPolarisation
from tests.cameras import camera_without_array, close_up_camera

LAMP = {"kind": "point", "position_mm": [0.0, 0.0, -10.0], "power_w": 1.0}
COATINGS = {
    "share": {"reflectance": 0.5},
    "table": {"table": "r.csv"},
    "measured": {"measured": {"wavelengths_nm": [550.0], "angles_deg": [0.0, 90.0], "reflectance": [[0.1, 1.0]]}},
    "film": {"layers": [{"index": 1.38, "thickness_nm": 100.0}]},
}


def scene(camera=None, polarisation=True, **tables):
    transport = {"polarisation": polarisation} | tables.pop("transport", {})
    return lf.Scene(camera=camera or camera_without_array(), transport=transport, **tables)


def test_states_of_lights_have_their_stokes_vectors():
    assert LinearPolarisation(angle_deg=0.0).stokes == (1.0, 0.0, 0.0)
    assert LinearPolarisation(angle_deg=45.0).stokes == pytest.approx((0.0, 1.0, 0.0), abs=1e-15)
    assert LinearPolarisation(angle_deg=-30.0).stokes == pytest.approx((0.5, -np.sqrt(0.75), 0.0), abs=1e-15)
    assert CircularPolarisation().stokes == (0.0, 0.0, 1.0)
    assert CircularPolarisation(handedness="left").stokes == (0.0, 0.0, -1.0)


def test_a_scene_with_polarised_light_survives_its_file():
    given = scene(
        camera_without_array() | {"polariser_deg": 30.0},
        lights=[
            LAMP | {"polarisation": {"kind": "linear", "angle_deg": 20.0}},
            {"kind": "directional", "direction": [0.0, 0.0, -1.0], "irradiance_w_m2": 1.0,
             "polarisation": {"kind": "circular", "handedness": "left"}},
        ],
    )  # fmt: skip
    assert lf.loads(given.dump_toml()) == given


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        (
            {"camera": camera_without_array() | {"polariser_deg": 0.0}, "polarisation": False},
            "camera.polariser_deg = 0.0: needs transport.polarisation = true",
        ),
        (
            {"lights": [LAMP | {"polarisation": {"kind": "circular"}}], "polarisation": False},
            "lights[0].polarisation: needs transport.polarisation = true",
        ),
        (
            {"lights": [{"kind": "disk", "position_mm": [0.0, 0.0, -10.0], "direction": [0.0, 0.0, -1.0],
                         "radius_mm": 1.0, "power_w": 1.0, "polarisation": {"kind": "circular"}}]},
            "lights[0].polarisation: unknown key (did you mean 'position_mm'?)",
        ),
        ({"lights": [LAMP | {"polarisation": {"kind": "linear"}}]}, "lights[0].polarisation.angle_deg: missing"),
        (
            {"lights": [LAMP | {"polarisation": {"kind": "circular", "handedness": "both"}}]},
            "lights[0].polarisation.handedness = \"both\": must be 'right' or 'left'",
        ),
        (
            {"camera": close_up_camera() | {"mla": close_up_camera()["mla"] | {"curved_coating": "share"}}},
            'camera.mla.curved_coating = "share": transport.polarisation needs the phases of this coating, which '
            "reflectance does not give; give layers",
        ),
        (
            {"camera": close_up_camera() | {"mla": close_up_camera()["mla"] | {"flat_coating": "table"}}},
            'camera.mla.flat_coating = "table": transport.polarisation needs the phases of this coating, which '
            "table does not give; give layers",
        ),
        (
            {"camera": close_up_camera() | {"mla": close_up_camera()["mla"] | {"flat_coating": "measured"}}},
            'camera.mla.flat_coating = "measured": transport.polarisation needs the phases of this coating, which '
            "measured does not give; give layers",
        ),
        (
            {"camera": camera_without_array() | {
                "sensor": camera_without_array()["sensor"] | {"reflectance": 0.1}
            }},
            "camera.sensor.reflectance = 0.1: transport.polarisation needs the phases",
        ),
    ],
)  # fmt: skip
def test_what_has_no_known_state_is_refused_in_one_line(tables, words):
    with pytest.raises(SceneError) as error:
        scene(coatings=COATINGS, **tables)
    (line,) = str(error.value).splitlines()
    assert line.startswith(f"Scene.{words}")


def test_layers_are_welcome_and_so_is_what_no_surface_has():
    camera = close_up_camera()
    scene(camera | {"mla": camera["mla"] | {"curved_coating": "film"}}, coatings=COATINGS)


def test_the_mesh_engine_traces_polarised_light():
    few = {"transport.samples": 1, "transport.replicates": 2}
    assert lf.render(scene().changed(few)).engine == "mesh: transport.polarisation needs the mesh engine"
    assert lf.render(scene(polarisation=False).changed(few)).engine.startswith("both: ")
    with pytest.raises(SceneError, match=r"transport\.polarisation needs the mesh engine"):
        lf.render(scene(transport={"engine": "sequential"}))
    with pytest.raises(LfmeshError, match=r"transport\.polarisation needs the mesh engine"):
        lf.trace(lf.build(scene(), aimed=False), [0, 0, -9], [0, 0, 1], split="transmit", engine="sequential")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"stokes": [1.0, 1.0, 0.1, 0.0]}, "ray 0: stokes = .*I > 0 and I² ≥ Q² + U² + V²"),
        ({"stokes": [0.0, 0.0, 0.0, 0.0]}, "I > 0"),
        ({"stokes": [-1.0, 0.0, 0.0, 0.0]}, "I > 0"),
        ({"stokes": [1.0, np.nan, 0.0, 0.0]}, "must be finite"),
        ({"stokes": [1.0, 0.0, 0.0]}, r"stokes must be \(4,\) or \(n, 4\) numbers"),
        ({"stokes": "linear"}, "stokes must be"),
        ({"stokes": [1.0, 1.0, 0.0, 0.0], "reference": [0.0, 0.0, 0.0]}, "ray 0: reference = .*with a direction"),
        ({"stokes": [1.0, 1.0, 0.0, 0.0], "reference": [np.inf, 0.0, 0.0]}, "reference = .*must be finite"),
    ],
)
def test_stokes_vectors_that_no_light_has_are_refused(given, words):
    with pytest.raises(LfmeshError, match=words.replace("+", r"\+")):
        lf.trace(lf.build(scene(), aimed=False), [0, 0, -9], [0, 0, 1], **given)


def test_stokes_vectors_need_a_scene_with_polarised_light():
    with pytest.raises(LfmeshError, match=r"stokes: the scene needs transport\.polarisation = true"):
        lf.trace(lf.build(scene(polarisation=False), aimed=False), [0, 0, -9], [0, 0, 1], stokes=[1.0, 0.0, 0.0, 0.0])
