"""The truth of the accuracy report through phases: against 30 digits, and against the tracer behind lenslets."""

from typing import Any

import mpmath as mp
import numpy as np
import pytest

import lfmesh as lf
from lfmesh.accuracy import analytic
from lfmesh.accuracy.analytic_phases import phase_rad
from lfmesh.accuracy.lens_accuracy import LENS_ALONE, WHOLE_CAMERA, study_lens
from lfmesh.accuracy.report import AccuracyReport
from lfmesh.assets import asset_path
from lfmesh.errors import LfmeshError
from tests.validation.phase_truth import Face, through_faces
from tests.validation.test_phase_surfaces import GAP, NM, PHASES, SHAPES, THICKNESS, camera, rays

FEW_ROUNDINGS_MM = 5e-13


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("kind", [kind for kind in PHASES if kind != "grid"])
def test_truth_through_phases_lands_where_30_digits_do(kind: str, shape: str) -> None:
    keys, phase = PHASES[kind]
    form, sag = SHAPES[shape]
    scene = camera({**form, "phase": keys}, {})
    p, d = rays(10, 0.15, seed=3)
    landed = analytic.Camera.of(scene, NM).land(p, d)
    assert landed.arrives.all()
    with mp.workdps(30):
        faces = [
            Face(mp.mpf(0), sag, mp.mpf(1), mp.mpf(1.5), phase, keys.get("order", 1)),
            Face(mp.mpf(THICKNESS), lambda x, y: mp.mpf(0), mp.mpf(1.5), mp.mpf(1)),
        ]
        true = [through_faces(faces, at, to, NM, THICKNESS + GAP) for at, to in zip(p, d, strict=True)]
    position, weight = (np.array([each[k] for each in true]) for k in (0, 2))
    assert np.abs(landed.position - position[:, :2]).max() < FEW_ROUNDINGS_MM
    np.testing.assert_allclose(landed.weight, weight, rtol=1e-13)
    claimed = analytic.own_error(scene, NM, p, d)
    assert claimed is None or claimed < FEW_ROUNDINGS_MM


TURNED = {"tilt_deg": [1.0, -2.0, 9.0]}
METALENS = {"kind": "metalens", "focal_length_mm": 0.45, "design_nm": 550.0}
TILTED = {"kind": "xy", "coefficients_rad": [[1, 0, 8.0], [1, 1, -6.0], [0, 3, 5.0]], "radius_mm": 0.06, "order": -1}
BLAZED = {"kind": "radial", "coefficients_rad": [-9.0, 1.5], "radius_mm": 0.06, "efficiency": "blaze"}


@pytest.mark.parametrize("side", ["lens", "sensor"])
@pytest.mark.parametrize(
    "mla",
    [
        {"curved_phase": TILTED, "form": {"decenter_mm": 0.003, "radius_error": 0.05, "seed": 2}},
        {"flat_phase": BLAZED | {"design_nm": 550.0}, "layout": "hexagonal"},
        {"focal_length_mm": None, "curved_phase": METALENS},
        {"focal_length_mm": None, "curved_phase": METALENS, "layout": "hexagonal", "pose": TURNED},
        {"curved_phase": BLAZED | {"design_nm": 550.0}, "conic": -1.0, "flat_phase": TILTED},
    ],
    ids=["a phase on bad lenslets", "a blaze behind them", "metalenses", "turned metalenses", "both faces"],
)  # fmt: skip
def test_lenslets_with_phases_land_where_the_tracer_has_them(mla: dict[str, Any], side: str) -> None:
    """Two programs that share no code turn rays at the same faces."""
    changes = {f"camera.mla.{key}": value for key, value in mla.items()} | {"camera.mla.curved_side": side}
    scene = lf.load(asset_path("scenes/focused.toml")).changed(changes | {"targets": [], "lights": []})
    draw = np.random.default_rng(4)
    origins = np.column_stack([draw.uniform(-20.0, 20.0, (1000, 2)), np.full(1000, -300.0)])
    ahead = np.column_stack([draw.uniform(-7.0, 7.0, (1000, 2)), np.full(1000, 10.0)]) - origins
    landing = analytic.Camera.of(scene, NM).land(origins, ahead)
    world = lf.build(scene, aimed=False)
    for engine in ("mesh", "sequential"):
        paths = lf.trace(world, origins, ahead, split="transmit", engine=engine)
        there = np.isin(paths.body, ["sensor", "beside the sensor"])
        both = there & landing.arrives[paths.source]
        assert both.sum() > 300
        # Light that only one of them has at the sensor crosses the layer of faces from cell to cell.
        assert both.sum() > 0.98 * max(there.sum(), landing.arrives.sum())
        assert np.abs(paths.position[both][:, :2] - landing.position[paths.source[both]]).max() < FEW_ROUNDINGS_MM
        assert np.abs(paths.weight[both] - landing.weight[paths.source[both]]).max() < 1e-12


def test_phases_without_a_truth_are_refused_by_their_key(tmp_path: Any) -> None:
    several = {"kind": "grating", "lines_per_mm": 9.0, "orders": [{"order": n, "share": 0.3} for n in (0, 1)]}
    with pytest.raises(LfmeshError, match=r"camera\.lens\.surfaces\[0\]\.phase\.orders: 2 orders"):
        analytic.Camera.of(camera({"phase": several}, {}), NM)
    np.savez(tmp_path / "phase.npz", phase_rad=np.zeros((30, 30)), spacing_mm=0.5)
    grid = camera({"phase": {"kind": "grid", "file": "phase.npz"}}, {}).in_folder(tmp_path)
    with pytest.raises(LfmeshError, match=r"camera\.lens\.surfaces\[0\]\.phase\.kind: .* no phase from a file"):
        analytic.Camera.of(grid, NM)
    unknown = grid.camera.lens.surfaces[0].phase
    with pytest.raises(NotImplementedError, match="grid"):
        phase_rad(unknown, np.zeros(1, complex), np.zeros(1, complex))


def test_a_camera_with_phases_is_measured_at_exact_surfaces_alone(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rays land on the truth whatever the mesh, and the report says nothing of facets."""
    monkeypatch.setattr("lfmesh.accuracy.lens_accuracy.TIMED_RUNS", 1)
    monkeypatch.setattr("lfmesh.accuracy.lens_accuracy.TIMED_SECONDS", 0.0)
    scene = lf.load(asset_path("scenes/metalens_array.toml"))
    study = study_lens(scene, rays=1 << 11)
    assert study.ways == (LENS_ALONE, WHOLE_CAMERA)
    assert {row.surface for row in study.rows} == {"exact"}
    for row in study.rows:
        assert row.rays > 100
        assert row.max_mm <= 1e-9
        assert row.max_weight <= 1e-12
    (page,) = [path for path in AccuracyReport("phases", (study,), None).write(tmp_path) if path.suffix == ".html"]
    assert "facets" not in page.read_text(encoding="utf-8")
