"""Small renders of random scenes with everything that a scene may hold: images of finite power, or one refusal."""

import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
import tomlkit
from hypothesis import example, given, settings
from hypothesis import strategies as st

import lfmesh as lf
from lfmesh.errors import LfmeshError
from tests.cameras import close_up_camera

LONGEST_S = 20.0
"""Of processor time, of one render once its kernels are compiled."""
RENDERS = 2_000
"""Of the long run."""

Table = dict[str, Any]


def some(of: dict[str, st.SearchStrategy[Any]]) -> st.SearchStrategy[Table]:
    """Draw a table with any of these keys."""
    return st.fixed_dictionaries({}, optional=of)


def near(z_mm: float, spread_mm: float = 8.0) -> st.SearchStrategy[list[float]]:
    """Draw a place about one on the axis."""
    across = st.floats(-spread_mm, spread_mm)
    return st.builds(lambda x, y, z: [x, y, z_mm + z], across, across, across)


turns = st.lists(
    st.sampled_from([0.0, 0.0, 10.0, 45.0, 90.0, 180.0]) | st.floats(-180.0, 180.0), min_size=3, max_size=3
)
sizes = st.sampled_from([1.0, 10.0]) | st.floats(0.01, 40.0)
shares = st.sampled_from([0.0, 1.0]) | st.floats(0.0, 1.0)
coefficients = st.sampled_from([0.0, 1e-9, 0.01, 3.0]) | st.floats(0.0, 0.2)
indices = st.sampled_from([1.333, 1.5, 2.4]) | st.floats(1.01, 2.0)
phases = st.sampled_from(
    [{"kind": "isotropic"}, {"kind": "rayleigh"}, {"kind": "mie", "diameter_um": 2.0, "index": 1.59}]
) | st.builds(lambda g: {"kind": "henyey_greenstein", "g": g}, st.floats(-0.95, 0.95))

bodies = st.one_of(
    st.builds(lambda r: {"kind": "sphere", "radius_mm": r}, sizes),
    st.builds(lambda *s: {"kind": "box", "size_mm": list(s)}, sizes, sizes, sizes),
    st.builds(lambda r, h: {"kind": "cylinder", "radius_mm": r, "height_mm": h}, sizes, sizes),
)
shapes = bodies | st.builds(lambda w, h: {"kind": "plane", "width_mm": w, "height_mm": h}, sizes, sizes)

coatings = st.one_of(
    st.builds(lambda r: {"reflectance": r}, shares),
    st.builds(
        lambda layers: {"layers": layers},
        st.lists(
            st.builds(
                lambda n, k, d: {"index": n, "extinction": k, "thickness_nm": d},
                st.floats(1.3, 2.5), st.sampled_from([0.0, 0.0, 0.1, 3.0]), st.floats(1.0, 300.0),
            ),
            min_size=1, max_size=3,
        ),
    ),
)  # fmt: skip

materials = some(
    {
        "reflectance": shares,
        "radiance_w_m2_sr": st.sampled_from([0.0, 1.0, 1e6]),
        "sides": st.sampled_from(["both", "front"]),
        "texture": st.sampled_from(["alpha.png", "alpha.png", "plain.png"]),
        "opacity": st.sampled_from([0.5, 0.0, "texture_alpha", "texture_alpha"]),
        "gloss": st.builds(lambda n, a: {"index": n, "roughness": a}, st.floats(1.1, 2.0), st.floats(0.05, 0.8)),
    }
)
targets = st.builds(
    lambda shape, material, place, turn: {
        "shape": shape, "material": material, "position_mm": place, "rotation_deg": turn,
    },
    shapes, materials, near(-62.0), turns,
)  # fmt: skip
glass = st.builds(
    lambda place, turn, more: {
        "refractor": {"file": "ball.off", "units": "mm", **more}, "position_mm": place, "rotation_deg": turn,
    },
    near(-50.0, 3.0), turns,
    st.fixed_dictionaries({"index": indices}, optional={"absorption_per_mm": coefficients, "coating": st.just("thin")}),
)  # fmt: skip

states = st.sampled_from([{"kind": "linear", "angle_deg": 30.0}, {"kind": "circular", "handedness": "right"}])
lights = st.one_of(
    st.builds(lambda p: {"kind": "point", "position_mm": p, "power_w": 1.0}, near(-30.0, 25.0)),
    st.just({"kind": "directional", "direction": [0.3, 0.1, -1.0], "irradiance_w_m2": 5.0}),
    st.builds(
        lambda p, r: {"kind": "disk", "position_mm": p, "direction": [0.0, 0.1, -1.0], "radius_mm": r, "power_w": 1.0},
        near(-30.0, 25.0), st.floats(0.01, 9.0),
    ),
    st.builds(
        lambda p, a: {
            "kind": "spot", "position_mm": p, "direction": [0.0, 0.1, -1.0], "half_angle_deg": a, "power_w": 1.0,
        },
        near(-30.0, 25.0), st.floats(1.0, 89.0),
    ),
)  # fmt: skip

tanks = st.fixed_dictionaries(
    {
        "size_mm": st.lists(st.floats(12.0, 60.0), min_size=3, max_size=3),
        "wall_mm": st.sampled_from([0.5, 2.0]),
        "wall": st.fixed_dictionaries({"index": indices}, optional={"absorption_per_mm": coefficients}),
        "liquid": st.fixed_dictionaries({"index": indices}, optional={"absorption_per_mm": coefficients}),
        "position_mm": near(-65.0),
    },
    optional={"open": st.sampled_from(["top", "front"]), "rotation_deg": turns},
)
media = st.fixed_dictionaries(
    {"position_mm": near(-55.0), "absorption_per_mm": st.sampled_from([1e-9, 3.0]) | st.floats(1e-4, 0.2)},
    optional={
        "bounds": bodies | st.just({"file": "ball.off", "units": "mm"}),
        "scattering_per_mm": coefficients,
        "emission_w_mm3_sr": st.sampled_from([0.0, 1.0]),
        "phase": phases,
        "rotation_deg": turns,
        "inside": st.sampled_from(["tanks[0] liquid"]),
        "grid": st.sampled_from([{"file": "smoke.npz"}, {"file": "flame.npz", "interpolation": "constant"}]),
    },
)
sheets = st.builds(
    lambda t, w: {
        "point_mm": [0.0, 0.0, -60.0], "normal": [0.0, 0.0, 1.0], "direction": [1.0, 0.0, 0.0],
        "thickness_mm": t, "width_mm": w, "power_w": 1.0,
    },
    sizes, sizes,
)  # fmt: skip
particles = st.builds(
    lambda body, place, seed, count, shine: {
        "count": count, "bounds": body, "position_mm": place, "seed": seed, "samples": 2, **shine,
    },
    bodies, near(-60.0, 3.0), st.integers(0, 9), st.sampled_from([1, 5, 40]),
    st.one_of(
        st.just({"intensity_w_sr": 1.0}),
        st.builds(
            lambda sheet, phase: {"sheet": sheet, "phase": phase, **({} if phase["kind"] == "mie" else
                                                                      {"diameter_um": 10.0})},
            sheets, phases,
        ),
    ),
)  # fmt: skip

transports = some(
    {
        "method": st.sampled_from(["adjoint", "forward"]),
        "split": st.sampled_from(["both", "transmit", "roulette"]),
        "polarisation": st.booleans(),
        "diffraction": st.sampled_from(["none", "lenslets", "stop"]),
        "wavelengths_nm": st.sampled_from([[550.0], [450.0, 650.0]]),
        "engine": st.sampled_from(["mesh", "sequential"]),
        "weight_cutoff": st.sampled_from([1e-2, 1e-4]),
        "seed": st.integers(0, 99),
    }
)
scenes = st.fixed_dictionaries(
    {"targets": st.lists(targets, min_size=1, max_size=3)},
    optional={
        "glass": glass,
        "lights": st.lists(lights, min_size=1, max_size=2),
        "tanks": st.lists(tanks, min_size=1, max_size=2),
        "media": st.lists(media, min_size=1, max_size=2),
        "particles": st.lists(particles, min_size=1, max_size=2),
        "coating": coatings,
        "polariser_deg": st.floats(-90.0, 90.0),
        "state": states,
        "transport": transports,
    },
)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that the scenes name."""
    import trimesh

    folder = tmp_path_factory.mktemp("scenes")
    draw = np.random.default_rng(1)
    PIL.Image.fromarray(draw.integers(0, 256, (7, 5, 4), np.uint8), "RGBA").save(folder / "alpha.png")
    PIL.Image.fromarray(draw.integers(0, 256, (7, 5, 3), np.uint8), "RGB").save(folder / "plain.png")
    ball = trimesh.creation.icosphere(subdivisions=2, radius=8.0)
    (folder / "ball.off").write_text(ball.export(file_type="off"))
    box = {"spacing_mm": np.array([4.0, 4.0, 4.0])}
    np.savez(folder / "smoke.npz", scattering_per_mm=draw.uniform(0.0, 0.1, (3, 4, 5)), **box)
    np.savez(
        folder / "flame.npz", temperature_k=draw.uniform(300.0, 2000.0, (4, 3, 2)),
        absorption_per_mm=draw.uniform(0.0, 0.1, (4, 3, 2)), **box,
    )  # fmt: skip
    return folder


def text_of(drawn: Table) -> str:
    """Return a drawn scene as the text of its file; what needs another part that was not drawn is mostly left out."""
    tables = {key: value for key, value in drawn.items() if key in ("lights", "tanks", "media", "particles")}
    camera = tables["camera"] = close_up_camera(8, 8)
    tables["targets"] = list(drawn["targets"])
    if drawn.get("transport", {}).get("diffraction") == "stop":
        del camera["mla"]
    if "glass" in drawn:
        refractor = {k: v for k, v in drawn["glass"]["refractor"].items() if k != "coating" or "coating" in drawn}
        tables["targets"].append({**drawn["glass"], "refractor": refractor})
    if "coating" in drawn:
        tables["coatings"] = {"thin": drawn["coating"]}
        camera["lens"]["surfaces"][0]["coating"] = "thin"
        camera.get("mla", {})["flat_coating"] = "thin"
    if "media" in drawn and "tanks" not in drawn:
        tables["media"] = [{k: v for k, v in medium.items() if k != "inside"} for medium in drawn["media"]]
    if drawn.get("transport", {}).get("polarisation"):
        if "polariser_deg" in drawn:
            camera["polariser_deg"] = drawn["polariser_deg"]
        if "state" in drawn and "lights" in drawn:
            first, *others = drawn["lights"]
            tables["lights"] = [{**first, "polarisation": drawn["state"]}, *others]
    tables["transport"] = {"samples": 4, "replicates": 2, "max_events": 64} | drawn.get("transport", {})
    return tomlkit.dumps(tables)


def in_few_lines(error: LfmeshError) -> None:
    lines = str(error).splitlines()
    assert 1 <= len(lines) <= 22
    assert all(len(line) < 1000 for line in lines)


def is_valid_or_refused(text: str, folder: Path) -> bool:
    """Insist on an image of finite power whose energy closes, or on one refusal.

    Returns
    -------
    bool
        Whether it was rendered.
    """
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            image = lf.render(lf.loads(text, folder))
        except LfmeshError as error:
            in_few_lines(error)
            return False
    assert image.mean.shape[:2] == (8, 8)
    assert np.isfinite(image.mean).all()
    assert (image.mean >= 0.0).all()
    assert (image.stderr >= 0.0).all()
    assert abs(image.ledger.imbalance) < 1e-9
    assert image.ledger.lost_share <= 1e-7 or any("lost" in str(warning.message) for warning in said)
    assert all(issubclass(warning.category, UserWarning) for warning in said)
    return True


def is_rendered_or_refused(text: str, folder: Path) -> bool:
    """Insist on that in bounded time; of a render that was slow because it compiled kernels, the second one counts."""
    for attempt in range(2):
        began = time.process_time()
        rendered = is_valid_or_refused(text, folder)
        if time.process_time() - began < LONGEST_S:
            return rendered
        assert attempt == 0
    return rendered


BALL_AT_62_MM = {
    "shape": {"kind": "sphere", "radius_mm": 1.0}, "material": {}, "position_mm": [0.0, 0.0, -62.0],
    "rotation_deg": [0.0, 0.0, 0.0],
}  # fmt: skip

# A probe's way without length, on a plane of the particles' bounds.
WITHOUT_LENGTH = {
    "targets": [BALL_AT_62_MM],
    "media": [{"position_mm": [0.0, 0.0, -55.0], "absorption_per_mm": 1e-09}],
    "tanks": [
        {
            "size_mm": [12.0, 12.0, 12.0], "wall_mm": 0.5, "wall": {"index": 1.333}, "liquid": {"index": 1.333},
            "position_mm": [0.0, 0.0, -65.0],
        }
    ],
    "particles": [
        {
            "count": 1, "bounds": {"kind": "sphere", "radius_mm": 1.0}, "position_mm": [0.0, 0.0, -60.0], "seed": 0,
            "samples": 2, "intensity_w_sr": 1.0,
        }
    ],
}  # fmt: skip

# Glass through which probes see next to nothing.
HARDLY_SEEN = {
    "targets": [BALL_AT_62_MM | {"position_mm": [0.0, 4.0, -61.0]}],
    "lights": [{"kind": "point", "position_mm": [0.0, 0.0, -30.0], "power_w": 1.0}],
    "glass": {
        "refractor": {"file": "ball.off", "units": "mm", "index": 1.333}, "position_mm": [0.0, 0.0, -50.0],
        "rotation_deg": [0.0, 0.0, 0.0],
    },
}  # fmt: skip


@settings(max_examples=15, deadline=None, derandomize=True, database=None)
@given(scenes)
@example(drawn=WITHOUT_LENGTH)
@example(drawn=HARDLY_SEEN)
def test_a_random_scene_is_rendered_or_refused(place: Path, drawn: Table) -> None:
    is_rendered_or_refused(text_of(drawn), place)


@pytest.mark.long
@settings(max_examples=RENDERS, deadline=None, derandomize=True, database=None)
@given(scenes)
def test_many_random_scenes_are_rendered_or_refused(place: Path, drawn: Table) -> None:
    is_rendered_or_refused(text_of(drawn), place)
