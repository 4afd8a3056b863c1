"""Kirchhoff's law: in a closed room of one temperature everything looks like a black body, whatever it is made of.

The walls of a room, and all that stands in it, have one temperature. The camera looks in through a hole as large as its
lens: what the room sees of the camera's darkness is below 1e-5 of its walls. So each picture is that of the empty room
with black walls, whose light needs no scattering: their ratio is 1, within three standard errors that are stated.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

import lfmesh as lf
from tests.instances import instances
from tests.renders import unchecked

HALF, DEPTH, HOLE, FRONT = 60.0, 100.0, 0.3, -0.1
"""Half the room's width, its depth, half the hole's width, and where the front wall stands, mm."""

MIDDLE = (0.0, 0.0, -65.0)
RADIUS = 30.0
HOT = {"temperature_k": 1700.0}
BLACK = HOT | {"reflectance": 0.0}
MATT = HOT | {"reflectance": 0.5}
SILVER = HOT | {"gloss": {"metal": "Ag", "roughness": 0.3}}
GLOSS = HOT | {"reflectance": 0.5, "gloss": {"index": 1.6, "roughness": 0.3}}
SHINY = HOT | {"reflectance": 0.9, "gloss": {"index": 1.6, "roughness": 0.1}}
GROUND = {"kind": "ground", "roughness": 0.6}
Body = dict[str, Any]


def plane(size: tuple[float, float], at: tuple[float, float, float], turned: Any, material: Body) -> Body:
    shape = {"kind": "plane", "width_mm": size[0], "height_mm": size[1]}
    return {"shape": shape, "position_mm": at, "rotation_deg": turned, "material": material}


def walls(material: Body) -> list[Body]:
    """Return the walls of the room; the front wall is four planes round the hole."""
    middle, across, aside = FRONT - 0.5 * DEPTH, 2.0 * HALF, 0.5 * (HALF + HOLE)
    made = [plane((across, across), (0.0, 0.0, FRONT - DEPTH), (0.0, 0.0, 0.0), material)]
    for sign in (-1.0, 1.0):
        made += [
            plane((DEPTH, across), (sign * HALF, 0.0, middle), (0.0, 90.0, 0.0), material),
            plane((across, DEPTH), (0.0, sign * HALF, middle), (90.0, 0.0, 0.0), material),
            plane((HALF - HOLE, across), (sign * aside, 0.0, FRONT), (0.0, 0.0, 0.0), material),
            plane((2.0 * HOLE, HALF - HOLE), (0.0, sign * aside, FRONT), (0.0, 0.0, 0.0), material),
        ]
    return made


def ball(material: Body, radius_mm: float = RADIUS, at: tuple[float, float, float] = MIDDLE) -> Body:
    return {"shape": {"kind": "sphere", "radius_mm": radius_mm}, "position_mm": at, "material": material}


def sheet(material: Body, turn: float = 25.0) -> Body:
    return plane((60.0, 60.0), MIDDLE, (0.0, turn, 0.0), material)


def mesh(material: Body) -> Body:
    """Return a ball of 80 facets with normals at its vertices."""
    return {"file": "coarse.obj", "units": "mm", "position_mm": MIDDLE, "material": material}


def glass(file: str = "ball.stl", at: tuple[float, float, float] = MIDDLE, **more: Any) -> Body:
    return {"refractor": {"file": file, "units": "mm", "index": 1.5, **more}, "position_mm": at, "name": "glass"}


BLOCK = {"refractor": {"box_mm": (50.0, 50.0, 50.0), "index": 1.5}, "position_mm": MIDDLE,
         "rotation_deg": (10.0, 20.0, 0.0)}  # fmt: skip
THREE = [
    ball(SILVER, 16.0, (-17.0, -14.0, -65.0)),
    ball(GLOSS, 16.0, (17.0, -14.0, -65.0)),
    glass("small.stl", (0.0, 17.0, -65.0), finish=GROUND),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Meshes and pictures."""
    there = tmp_path_factory.mktemp("room")
    coarse = trimesh.creation.icosphere(subdivisions=1, radius=RADIUS)
    coarse.export(there / "coarse.obj", include_normals=True)
    for name, radius in (("ball.stl", RADIUS), ("small.stl", 16.0)):
        trimesh.creation.icosphere(subdivisions=3, radius=radius).export(there / name)
    texels = np.random.default_rng(0).integers(0, 256, (16, 16, 4), dtype=np.uint8)
    Image.fromarray(texels[..., :3]).save(there / "colours.png")
    Image.fromarray(texels).save(there / "holes.png")
    return there


def room(bodies: list[Body], folder: Path, *, wall: Body = BLACK, media: Any = (), **transport: Any) -> lf.Scene:
    """Return a scene of the room: 2 × 2 pixels see 70 degrees of it."""
    lens = {"surfaces": [{"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 0.2, "stop": True}]}
    band = {"name": "R", "center_nm": 650.0, "fwhm_nm": 0.02}
    camera = {"focus_mm": 100.0, "lens": lens, "sensor": {"pixels": (2, 2), "pixel_mm": 55.0, "bands": [band]}}
    settings = {"threads": 1, "split": "transmit", "replicates": 32, "seed": 3, **transport}
    return lf.Scene(
        camera=camera,  # type: ignore[arg-type]
        targets=[*walls(wall), *bodies],  # type: ignore[list-item]
        media=media,
        transport=settings,  # type: ignore[arg-type]
    ).in_folder(folder)


def light(scene: lf.Scene) -> tuple[float, float]:
    """Return the light on the sensor and its standard error, W."""
    image = unchecked(scene)
    assert abs(image.ledger.imbalance) < 1e-12
    return float(image.mean.sum()), float(np.sqrt((image.stderr**2).sum()))


@lru_cache(maxsize=1)
def black_body(folder: Path) -> tuple[float, float]:
    """Return the light of the empty room, whose walls are black."""
    return light(room([], folder, samples=2**14))


def assert_black(scene: lf.Scene, folder: Path, sigma: float) -> None:
    """Compare with the black room: three standard errors, which are below `sigma` of it."""
    found, error = light(scene)
    truth, its_error = black_body(folder)
    error = float(np.hypot(error / truth, its_error / truth))
    assert error < sigma
    assert abs(found / truth - 1.0) < 3.0 * error


def gas(absorption: float, scattering: float = 0.0, **where: Any) -> list[Body]:
    return [HOT | {"absorption_per_mm": absorption, "scattering_per_mm": scattering, **where}]


# Fog at the hole would see the camera's darkness.
BOX = {"bounds": {"kind": "box", "size_mm": (80.0, 80.0, 80.0)}, "position_mm": (0.0, 0.0, -45.0)}
CASES: dict[str, tuple[list[Body], dict[str, Any]]] = {
    "silver": ([ball(SILVER)], {}),
    "gloss": ([ball(GLOSS)], {}),
    "rough glass": ([glass(finish=GROUND)], {}),
    "polished glass": ([glass()], {"split": "roulette", "samples": 2**14}),
    "gloss with colours below": ([ball(SHINY | {"texture": "colours.png"})], {}),
    "matt sheet with colours and holes": ([sheet(MATT | {"texture": "holes.png", "opacity": "texture_alpha"})], {}),
    "silver ball, half opaque": ([ball(SILVER | {"opacity": 0.5})], {"samples": 2**12}),
    "front of a silver sheet": ([sheet(SILVER | {"sides": "front"})], {}),
    "black side of a silver sheet": ([sheet(SILVER | {"sides": "front"}, 155.0)], {}),
    "matt, with normals at vertices": ([mesh(HOT | {"reflectance": 0.9})], {}),
    "gloss, with normals at vertices": ([mesh(SHINY)], {}),
    "silver, with normals at vertices": ([mesh(SILVER)], {"samples": 2**12}),
    "matt room": ([], {"wall": MATT}),
    "gloss in gas in a matt room": ([ball(GLOSS)], {"wall": MATT, "media": gas(0.01, 0.01, **BOX), "samples": 2**12}),
    "silver in soot": ([ball(SILVER)], {"media": gas(0.05, **BOX)}),
    "matt ball in a block of glass": ([BLOCK, ball(MATT, 15.0)], {"split": "both"}),
    "hot glass": ([glass()], {"media": gas(0.02, inside="glass"), "split": "roulette", "samples": 2**14}),
}  # fmt: skip


@pytest.mark.parametrize("case", instances(CASES, long=["silver", "gloss", "rough glass"]))
def test_all_looks_black_in_a_room_of_its_own_temperature(case: str, folder: Path) -> None:
    """By the adjoint method; below, silver, gloss and rough glass are in one room."""
    bodies, more = CASES[case]
    assert_black(room(bodies, folder, **{"samples": 2**11, **more}), folder, 0.01)


FORWARD = ["silver ball, half opaque", "gloss with colours below", "black side of a silver sheet", "rough glass",
           "matt sheet with colours and holes", "silver, with normals at vertices", "matt room"]  # fmt: skip


@pytest.mark.parametrize("case", instances(FORWARD, long=["gloss with colours below", "rough glass"]))
def test_all_looks_black_to_packets_from_its_own_walls(case: str, folder: Path) -> None:
    """By the forward method, with scattering bodies: it cannot aim through polished ones."""
    bodies, more = CASES[case]
    assert_black(room(bodies, folder, **{**more, "samples": 2**16, "method": "forward"}), folder, 0.05)


@pytest.mark.parametrize(
    ("method", "engine", "samples", "sigma"),
    [
        pytest.param("adjoint", "mesh", 2**14, 0.002, id="adjoint, mesh", marks=pytest.mark.long),
        pytest.param("adjoint", "sequential", 2**14, 0.002, id="adjoint, sequential"),
        pytest.param("forward", "auto", 2**18, 0.015, id="forward"),
        pytest.param("adjoint", "auto", 2**16, 0.0006, id="adjoint, exact", marks=pytest.mark.long),
        pytest.param("forward", "auto", 2**22, 0.002, id="forward, exact", marks=pytest.mark.long),
    ],
)
def test_balls_of_silver_gloss_and_rough_glass_are_not_seen(
    method: str, engine: str, samples: int, sigma: float, folder: Path
) -> None:
    """All three in one room."""
    assert_black(room(THREE, folder, method=method, engine=engine, samples=samples), folder, sigma)


@pytest.mark.parametrize(("method", "samples", "sigma"), [("adjoint", 2**12, 0.005), ("forward", 2**17, 0.01)])
def test_a_room_of_a_given_radiance_lights_itself(method: str, samples: int, sigma: float, folder: Path) -> None:
    """Walls of radiance B and reflectance ρ have B / (1 − ρ): a given radiance is not lowered by the reflectance."""
    given = {"radiance_w_m2_sr": 1.0}
    found, error = light(room([], folder, wall={"reflectance": 0.5, **given}, method=method, samples=samples))
    truth, its_error = light(room([], folder, wall={"reflectance": 0.0, **given}, samples=2**14))
    error = float(np.hypot(error / found, its_error / truth))
    assert error < sigma
    assert abs(0.5 * found / truth - 1.0) < 3.0 * error
