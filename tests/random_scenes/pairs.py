"""Small scenes in which two features meet in one place: a glossy sheet through the wall of a tank, a lamp in a medium.

Every scene has the same fast lens, an array, a matt wall in focus and a tilted sheet before it, through half of the
field. Features of objects act on that sheet, or lie where it stands. The sheet crosses the faces of tank, medium and
glass, and cuts through the cloud of particles.
"""

import tempfile
from collections.abc import Callable
from functools import cache
from itertools import combinations
from pathlib import Path

import lfmesh as lf
from lfmesh.assets import asset_path
from tests.cameras import SQUARE_ARRAY, biconvex
from tests.random_scenes.draft import Tables

FRONT_MM = -50.0
"""Height of the plane in which features meet: the middle of the sheet, the front of the tank."""

BEAM = "TILT=NONE\n1 -1 1 4 3 1 1 0 0 0 1 1 1\n0 40 80 180\n0 90 180\n9 8 3 1\n9 5 1 1\n9 7 2 1\n"
"""An IES file whose light differs in all directions."""

Pair = frozenset[str]
Put = Callable[[Tables, Pair], None]

FEATURES: dict[str, Put] = {}
"""Functions that put a feature into the tables of a scene, given both features of the pair."""

REFLECTING = frozenset({"tank", "glass", "cover"})
"""Features whose faces reflect light; with them both children of a split are followed."""

OWN_KERNELS = frozenset({"tank", "medium", "glass", "cover", "polarisation", "diffraction"})
"""Features that compile kernels of their own."""

LAMPS = frozenset({"IES lamp", "line lamp"})


def feature(name: str) -> Callable[[Put], Put]:
    def enter(put: Put) -> Put:
        FEATURES[name] = put
        return put

    return enter


def pairs() -> list[tuple[str, str]]:
    """Return every two features, those without kernels of their own first."""
    return sorted(combinations(FEATURES, 2), key=lambda pair: sorted(OWN_KERNELS.intersection(pair)))


def scene_of_pair(one: str, other: str) -> lf.Scene:
    """Return the scene in which two features meet; its files lie in the assets and in a temporary folder.

    Parameters
    ----------
    one, other : str
        Names of features.
    """
    pair = frozenset({one, other})
    tables = _base(pair)
    for name, put in FEATURES.items():
        if name in pair:
            put(tables, pair)
    return lf.Scene(**tables).in_folder(asset_path("."))


def _base(pair: Pair) -> Tables:
    """Return camera, wall and sheet, and a point lamp where the pair has no lamp.

    Before glass a panel that glows takes its place: both methods trace a lamp's light through glass forward.
    """
    wall = {"shape": {"kind": "plane", "width_mm": 12.0, "height_mm": 12.0}, "position_mm": [0.0, 0.0, -60.0],
            "material": {"reflectance": 0.7, "radiance_w_m2_sr": 0.2}}  # fmt: skip
    sheet = {"shape": {"kind": "plane", "width_mm": 7.0, "height_mm": 9.0}, "position_mm": [2.5, 0.0, FRONT_MM],
             "rotation_deg": [10.0, 35.0, 0.0],
             "material": {"reflectance": 0.5, "radiance_w_m2_sr": 0.3}}  # fmt: skip
    tables: Tables = {
        "camera": {
            "focus_mm": 60.0, "lens": biconvex(), "mla": dict(SQUARE_ARRAY),
            "sensor": {"pixels": [8, 8], "pixel_mm": 0.25},
        },
        "targets": [wall, sheet],
        "lights": [],
        "transport": {"split": "both" if REFLECTING & pair else "transmit", "threads": 1},
    }  # fmt: skip
    if {"tank", "glass"} & pair and not LAMPS & pair:
        shines = {"reflectance": 0.0, "radiance_w_m2_sr": 4.0, "sides": "front"}
        panel = {"kind": "plane", "width_mm": 9.0, "height_mm": 9.0}
        tables["targets"].append({"shape": panel, "position_mm": [-9.0, 4.0, -42.0], "rotation_deg": [30.0, 135.0, 0.0],
                                  "material": shines})  # fmt: skip
    elif not LAMPS & pair:
        tables["lights"].append({"kind": "point", "position_mm": [-6.0, 7.0, -42.0], "power_w": 4e-4})
    return tables


def _sheet(tables: Tables) -> Tables:
    return tables["targets"][1]["material"]


# Of the sheet


@feature("gloss")
def _gloss(tables: Tables, pair: Pair) -> None:
    _sheet(tables)["gloss"] = {"index": 1.7, "roughness": 0.3}


@feature("temperature")
def _temperature(tables: Tables, pair: Pair) -> None:
    """A sheet that glows, and one band in which it does; its share of the light is about that of the lamp."""
    del _sheet(tables)["radiance_w_m2_sr"]
    _sheet(tables)["temperature_k"] = 1500.0
    tables["camera"]["sensor"].setdefault("bands", [{"name": "b", "center_nm": 600.0, "fwhm_nm": 20.0}])


@feature("opacity")
def _opacity(tables: Tables, pair: Pair) -> None:
    _sheet(tables)["opacity"] = 0.5


@feature("texture")
def _texture(tables: Tables, pair: Pair) -> None:
    _sheet(tables)["texture"] = "charts/chart.png"


# Where the sheet stands


@feature("tank")
def _tank(tables: Tables, pair: Pair) -> None:
    """Liquid behind a window that the sheet crosses, round the wall in focus."""
    _start_in_air(tables, tables["targets"][:2], FRONT_MM + 3.0)
    tables["tanks"] = [{
        "size_mm": [20.0, 20.0, 14.0], "wall_mm": 1.0, "wall": {"index": 1.5},
        "liquid": {"index": 1.33, "absorption_per_mm": 0.02}, "position_mm": [0.0, 0.0, FRONT_MM - 7.0],
    }]  # fmt: skip


@feature("medium")
def _medium(tables: Tables, pair: Pair) -> None:
    """A cloud that the sheet leaves on two sides; beside a tank it is in the liquid, up to the window and the sides."""
    medium: Tables = {
        "bounds": {"kind": "box", "size_mm": [5.0, 14.0, 10.0]}, "position_mm": [3.0, 0.0, FRONT_MM + 1.0],
        "scattering_per_mm": 0.04, "absorption_per_mm": 0.02, "phase": {"kind": "henyey_greenstein", "g": 0.4},
    }  # fmt: skip
    if "tank" in pair:
        medium["inside"] = "tanks[0] liquid"
    if "temperature" in pair:
        medium["temperature_k"] = 1400.0
    tables["media"] = [medium]


@feature("glass")
def _glass(tables: Tables, pair: Pair) -> None:
    """A block that the sheet cuts; in a tank it cuts the window, too, and before a sheet that emits it stands clear."""
    body: Tables = {"box_mm": [5.0, 6.0, 3.0], "index": 1.6}
    if "tank" in pair:
        body["priority"] = 1
    _start_in_air(tables, tables["targets"][1:2], FRONT_MM - 6.0)
    tables["targets"].append({"refractor": body, "position_mm": [1.0, 0.0, FRONT_MM], "rotation_deg": [0.0, 12.0, 0.0]})


def _start_in_air(tables: Tables, targets: list[Tables], clear_mm: float) -> None:
    """Let some targets reflect alone, and put a hot sheet where it is clear: forward, light starts in air."""
    for target in targets:
        target["material"].pop("radiance_w_m2_sr", None)
    if "temperature_k" in _sheet(tables):
        tables["targets"][1]["position_mm"] = [2.5, 0.0, clear_mm]


@feature("particles")
def _particles(tables: Tables, pair: Pair) -> None:
    tables["particles"] = [{
        "count": 24, "bounds": {"kind": "sphere", "radius_mm": 2.0}, "position_mm": [0.5, 0.0, FRONT_MM], "seed": 3,
        "intensity_w_sr": 2e-8,
    }]  # fmt: skip


# Lamps


@feature("IES lamp")
def _ies_lamp(tables: Tables, pair: Pair) -> None:
    """A lamp beside the beam, in the medium where there is one; polarised where light is."""
    lamp: Tables = {
        "kind": "point", "position_mm": [5.0, 4.0, FRONT_MM + 4.0], "power_w": 3e-4, "profile": str(ies_file()),
        "rotation_deg": [70.0, 0.0, 30.0],
    }  # fmt: skip
    if "polarisation" in pair:
        lamp["polarisation"] = {"kind": "linear", "angle_deg": 20.0}
    tables["lights"].append(lamp)


@feature("line lamp")
def _line_lamp(tables: Tables, pair: Pair) -> None:
    """A tube beside the beam that the face of the medium cuts."""
    start, end = [4.5, -6.0, FRONT_MM + 3.0], [5.8, 3.0, FRONT_MM + 5.0]
    tables["lights"].append({"kind": "line", "start_mm": start, "end_mm": end, "power_w": 3e-4})


@cache
def ies_file() -> Path:
    """Return a file with the angular profile of a lamp, in a folder that is removed with the process."""
    folder = tempfile.TemporaryDirectory()
    _kept.append(folder)
    path = Path(folder.name) / "beam.ies"
    path.write_text(BEAM)
    return path


_kept: list[tempfile.TemporaryDirectory[str]] = []


# Of the camera


@feature("cover")
def _cover(tables: Tables, pair: Pair) -> None:
    tables["camera"]["sensor"]["cover"] = {"thickness_mm": 0.1, "gap_mm": 0.08, "index": 1.6}


@feature("tilt")
def _tilt(tables: Tables, pair: Pair) -> None:
    """Sensor and array, each by angles of its own."""
    tables["camera"]["sensor"]["pose"] = {"tilt_deg": [5.0, -4.0, 3.0]}
    tables["camera"]["mla"]["pose"] = {"tilt_deg": [-1.5, 1.0, 4.0], "shift_mm": [0.05, 0.02, 0.0]}


@feature("hexagons")
def _hexagons(tables: Tables, pair: Pair) -> None:
    tables["camera"]["mla"] |= {"layout": "hexagonal", "count": [6, 6]}


@feature("multi-focus")
def _multi_focus(tables: Tables, pair: Pair) -> None:
    focal = tables["camera"]["mla"]["focal_length_mm"]
    tables["camera"]["mla"]["focal_length_mm"] = [0.85 * focal, focal, 1.2 * focal]


@feature("bands")
def _bands(tables: Tables, pair: Pair) -> None:
    tables["camera"]["sensor"]["bands"] = "rgb"


@feature("polarisation")
def _polarisation(tables: Tables, pair: Pair) -> None:
    """Behind a polariser; windows and glass are then not alike for both states."""
    tables["transport"]["polarisation"] = True
    tables["camera"]["polariser_deg"] = 30.0


@feature("diffraction")
def _diffraction(tables: Tables, pair: Pair) -> None:
    """Behind lenslets of 0.05 mm, whose pattern is as wide as a fifth of a pixel."""
    mla, sensor = tables["camera"]["mla"], tables["camera"]["sensor"]
    shrink = 0.1
    mla |= {"pitch_mm": shrink * mla["pitch_mm"], "thickness_mm": 0.1, "count": [8, 8]}
    focal = mla["focal_length_mm"]
    mla["focal_length_mm"] = [shrink * f for f in focal] if isinstance(focal, list) else shrink * focal
    sensor["pixel_mm"] *= shrink
    for pose in (mla.get("pose"), sensor.get("pose")):
        if pose is not None and "shift_mm" in pose:
            pose["shift_mm"] = [shrink * s for s in pose["shift_mm"]]
    if (cover := sensor.get("cover")) is not None:
        cover |= {"thickness_mm": 0.05, "gap_mm": 0.04}
    tables["transport"]["diffraction"] = "lenslets"
