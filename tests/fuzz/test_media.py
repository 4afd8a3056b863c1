"""Media, tanks and grids of random sizes, poses and numbers: refused in one line, or passed by rays as light is."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import lfmesh as lf
from lfmesh.errors import LfmeshError
from lfmesh.geometry.objects.tanks import with_tanks
from lfmesh.lightfield.volumes.voxel_box import VoxelBox
from tests.cameras import close_up_camera
from tests.transport.events.test_volume import passage, volumes_of

HARSH = [0.0, -0.0, -1.0, 1e-300, 5e-324, 1e-9, 1.0, 1e9, 1e300, 1.7e308, np.nan, np.inf, -np.inf]

lengths = st.one_of(st.floats(1e-3, 300.0), st.sampled_from(HARSH))
coefficients = st.one_of(st.floats(0.0, 5.0), st.just(0.0), st.sampled_from(HARSH))
places = st.tuples(*[st.one_of(st.floats(-40.0, 40.0), st.sampled_from(HARSH))] * 2, st.floats(-500.0, 10.0))
turns = st.tuples(*[st.floats(-400.0, 400.0)] * 3)
phases = st.one_of(
    st.just({"kind": "isotropic"}),
    st.just({"kind": "rayleigh"}),
    st.builds(lambda g: {"kind": "henyey_greenstein", "g": g}, st.one_of(st.floats(-1.0, 1.0), st.sampled_from(HARSH))),
)
bounds = st.one_of(
    st.none(),
    st.builds(lambda *s: {"kind": "box", "size_mm": list(s)}, lengths, lengths, lengths),
    st.builds(lambda r: {"kind": "sphere", "radius_mm": r}, lengths),
    st.builds(lambda r, h: {"kind": "cylinder", "radius_mm": r, "height_mm": h}, lengths, lengths),
    st.builds(
        lambda file, units: {"file": file, "units": units},
        st.sampled_from(["ball.off", "ball.off", "open.off", "none.off", "ball.txt", ""]),
        st.sampled_from(["mm", "mm", "cm", "um", "m", None, "mile"]),
    ),
)
shapes = st.one_of(st.tuples(*[st.integers(1, 4)] * 3), st.sampled_from([(), (3,), (2, 2), (0, 2, 2), (2, 2, 2, 2)]))
grids = st.one_of(
    st.none(),
    st.none(),
    st.fixed_dictionaries(
        {
            "shape": shapes,
            "value": st.one_of(st.floats(0.0, 3.0), st.sampled_from(HARSH)),
            "spacing_mm": st.one_of(lengths, st.tuples(lengths, lengths), st.tuples(lengths, lengths, lengths)),
            "origin_mm": st.one_of(st.none(), places),
            "quantity": st.sampled_from(
                ["absorption_per_mm", "scattering_per_mm", "emission_w_mm3_sr", "temperature_k"]
            ),
            "interpolation": st.sampled_from(["trilinear", "constant", "cubic"]),
        }
    ),
)
media = st.fixed_dictionaries(
    {
        "bounds": bounds,
        "absorption_per_mm": coefficients,
        "scattering_per_mm": coefficients,
        "emission_w_mm3_sr": coefficients,
        "phase": phases,
        "position_mm": places,
        "rotation_deg": turns,
        "grid": grids,
        "inside": st.sampled_from([*[None] * 9, "tanks[0] liquid"]),
    }
)


BALL: str = trimesh.creation.icosahedron().apply_scale(8.0).export(file_type="off")


def in_one_line(error: LfmeshError) -> None:
    lines = str(error).splitlines()
    assert 1 <= len(lines) <= 22
    assert all(len(line) < 1000 for line in lines)


def written(medium: dict[str, Any], folder: Path, number: int) -> dict[str, Any]:
    """Return a medium with its grid in a file."""
    grid = medium["grid"]
    kept = {key: value for key, value in medium.items() if value is not None and key != "grid"}
    if grid is None:
        return kept
    values = np.full(grid["shape"], grid["value"])
    values.flat[::2] = 0.5
    held = {grid["quantity"]: values, "spacing_mm": np.array(grid["spacing_mm"])}
    if grid["origin_mm"] is not None:
        held["origin_mm"] = np.array(grid["origin_mm"])
    np.savez(folder / f"g{number}.npz", **held)
    return kept | {"grid": {"file": f"g{number}.npz", "interpolation": grid["interpolation"]}}


def is_passed_or_refused(drawn: list[dict[str, Any]], seed: int) -> None:
    """Insist on one refusal, or on rays that keep between nothing and all of their light, and see no negative light."""
    draw = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "ball.off").write_text(BALL)
        (folder / "open.off").write_text(BALL.replace("20 0\n", "19 0\n").rsplit("\n", 2)[0] + "\n")
        try:
            volumes = volumes_of(*[written(medium, folder, k) for k, medium in enumerate(drawn)], folder=folder)
        except LfmeshError as error:
            in_one_line(error)
            return
    for _ in range(8):
        d = draw.normal(size=3) * draw.choice([0.0, 1.0], 3)
        if not d.any():
            d = np.array([0.0, 0.0, -1.0])
        start = draw.uniform([-50.0, -50.0, -300.0], [50.0, 50.0, 0.0])
        found = passage(volumes, start, d, float(draw.choice([np.inf, 10.0, 1e-9])))
        assert 0.0 <= found.transmittance <= 1.0
        assert found.light >= 0.0
        assert 0.0 <= found.scattered <= 1.0 - found.transmittance + 1e-12


@settings(max_examples=200, deadline=None, derandomize=True, database=None)
@given(st.lists(media, min_size=1, max_size=3), st.integers(0, 10**6))
def test_random_media_pass_light_or_are_refused(drawn: list[dict[str, Any]], seed: int) -> None:
    is_passed_or_refused(drawn, seed)


@pytest.mark.long
@settings(max_examples=10_000, deadline=None, derandomize=True, database=None)
@given(st.lists(media, min_size=1, max_size=3), st.integers(0, 10**6))
def test_many_random_media_pass_light_or_are_refused(drawn: list[dict[str, Any]], seed: int) -> None:
    is_passed_or_refused(drawn, seed)


indices = st.one_of(st.floats(1.0, 4.0), st.sampled_from(HARSH))
tanks = st.fixed_dictionaries(
    {
        "size_mm": st.tuples(lengths, lengths, lengths),
        "wall_mm": lengths,
        "wall": st.builds(lambda n: {"index": n}, indices),
        "liquid": st.builds(lambda n: {"index": n}, indices),
        "open": st.sampled_from([None, "top", "front", "side"]),
        "position_mm": places,
        "rotation_deg": turns,
    }
)


@settings(max_examples=150, deadline=None, derandomize=True, database=None)
@given(tanks)
def test_random_tanks_are_two_bodies_or_refused(tank: dict[str, Any]) -> None:
    given = {key: value for key, value in tank.items() if value is not None}
    try:
        scene = lf.Scene(camera=close_up_camera(), tanks=[given])  # type: ignore[arg-type, list-item]
        assert len(with_tanks(scene).targets) == 2
    except LfmeshError as error:
        in_one_line(error)


counts = st.tuples(*[st.one_of(st.integers(-2, 5), st.sampled_from([10**6, 2**40, 1.5]))] * 3)


@settings(max_examples=200, deadline=None, derandomize=True, database=None)
@given(counts, st.tuples(lengths, lengths, lengths), places, turns, st.one_of(st.none(), st.floats(), st.integers()))
def test_random_grids_and_thresholds_of_matrices_are_taken_or_refused(
    numbers: Any, size: Any, position: Any, turn: Any, threshold: Any
) -> None:
    scene = lf.Scene(camera=close_up_camera(4, 4), transport={"samples": 1})  # type: ignore[arg-type]
    try:
        grid = VoxelBox.of_size(numbers, size, position, turn)
        assert grid.voxels == np.prod(numbers)
        assert np.isfinite(grid.corners_mm()).all()
        if grid.voxels < 1000 and threshold is not None:
            made = lf.projection_matrix(scene, grid, pixels=[3, 5], threshold=threshold)
            assert (made.matrix.data >= 0.0).all()
    except LfmeshError as error:
        in_one_line(error)
