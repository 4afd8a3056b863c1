"""Phases in a scene: their keys, their faults, their orders, and their files."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.scene.camera.phase import AnyPhase
from lfmesh.scene.inputs import files_of

RADIAL = {"kind": "radial", "coefficients_rad": [-120.0, 3.5], "radius_mm": 5.0}
SENSOR = {"pixels": [8, 8], "pixel_mm": 0.01}
METALENS = {"kind": "metalens", "focal_length_mm": 0.5, "design_nm": 550.0}


def phase_of(keys: Mapping[str, Any]) -> AnyPhase:
    phase = lf.Surface(semi_diameter_mm=1.0, index=1.5, phase=keys).phase
    assert phase is not None
    return phase


def scene_of(surface: Mapping[str, Any], folder: Path | None = None, **keys: Any) -> lf.Scene:
    """A lens of a curved and a flat face, with further keys of the flat one."""
    transport = keys.pop("transport", {})
    scene = lf.Scene(
        camera={
            "lens": {
                "surfaces": [
                    {"radius_mm": 40.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 4.0, "stop": True},
                    {"semi_diameter_mm": 4.0, **surface},
                ]
            },
            "focus_mm": 500.0,
            "sensor": SENSOR,
            **keys,
        },
        transport=transport,
    )
    return scene if folder is None else scene.in_folder(folder)


def write_grid(path: Path, **arrays: Any) -> Path:
    x = np.linspace(-5.0, 5.0, 21)
    y = np.linspace(-6.0, 6.0, 31)
    phase = -10.0 * x[:, None] ** 2 - 20.0 * y**2 + 3.0 * x[:, None]
    np.savez(path, **({"phase_rad": phase, "spacing_mm": [0.5, 0.4]} | arrays))
    return path


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"order": 1, "orders": [{"order": 0, "share": 0.5}]}, r"phase.order = 1: orders is given too"),
        ({"orders": [{"order": 0, "share": 0.6}, {"order": 1, "share": 0.6}]}, r"orders: the shares sum to 1.2"),
        (
            {"orders": [{"order": 2, "share": 0.1}, {"order": 2, "share": 0.1}]},
            r"orders\[1\].order = 2: is listed twice",
        ),
        ({"orders": [{"order": 2}]}, r"orders\[0\].share: missing"),
        ({"reflected_orders": [{"order": 1}]}, r"reflected_orders\[0\].share: missing"),
        ({"efficiency": "blaze"}, r"phase.design_nm: missing"),
        (
            {"efficiency": "blaze", "design_nm": 550.0, "orders": [{"order": 1, "share": 1.0}]},
            r'orders\[0\].share = 1.0: omit it: efficiency = "blaze"',
        ),
        ({"efficiency": "blaze", "design_nm": 550.0, "blaze_order": 0}, r"blaze_order = 0: must not be 0"),
        ({"levels": 1, "efficiency": "blaze", "design_nm": 550.0}, r"phase.levels = 1: must be 2 or more"),
        ({"levels": 4}, r"phase.levels = 4: omit it"),
        ({"design_nm": 550.0}, r"phase.design_nm = 550.0: omit it"),
        ({"efficiency": 1.2}, r"phase.efficiency = 1.2: must be 1 or less"),
        ({"efficiency": "D65"}, r"phase.efficiency = \"D65\": must be 'ideal' or 'blaze'"),
        ({"efficiency": {"blackbody_k": 3000.0}}, r"efficiency: give wavelengths_nm with values"),
        ({"efficiency": {"wavelengths_nm": [400.0, 700.0], "values": [0.5, 2.0]}}, r"efficiency: value 2"),
        ({"coefficients_rad": []}, r"coefficients_rad = \[\]: must not be empty"),
        ({"kind": "metalens"}, r"phase.focal_length_mm: missing"),
    ],
)
def test_contradictions_are_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(lf.SceneError, match=said):
        phase_of(RADIAL | keys)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"kind": "metalens", "focal_length_mm": 5.0}, "design_nm: missing"),
        ({"kind": "metalens", "focal_length_mm": 0.0, "design_nm": 500.0}, "focal_length_mm = 0.0: must not be 0"),
        (
            {"kind": "xy", "coefficients_rad": [[1, 0, 2.0], [1, 0, 1.0]], "radius_mm": 1.0},
            r"coefficients_rad\[1\]: the powers \[1, 0\] are given twice",
        ),
        ({"kind": "xy", "coefficients_rad": [[-1, 0, 2.0]], "radius_mm": 1.0}, r"must be 0 or more"),
        (
            {
                "kind": "hologram",
                "point_1_mm": [0.0, 1.0, 0.0],
                "point_2_mm": [0.0, 0.0, 9.0],
                "construction_nm": 500.0,
            },
            "point_1_mm = .*: must not lie in the vertex plane",
        ),
        ({"kind": "lens"}, "valid kinds are radial, xy, grating, metalens, grid, hologram"),
    ],
)
def test_each_kind_refuses_its_own_faults(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(lf.SceneError, match=said):
        phase_of(keys)


@pytest.mark.parametrize(
    ("surface", "said"),
    [
        ({"finish": "diffuse"}, r'phase: omit it: the face has finish = "diffuse"'),
        ({"paraxial": True, "focal_length_mm": 30.0}, r"phase: omit it: a paraxial surface is a flat thin lens"),
        (
            {"refractor": {"file": "a.stl", "units": "mm", "index": 1.5}},
            r"phase: omit it: the refractor is a whole element",
        ),
        ({"mesh": {"file": "a.stl", "units": "mm", "side": "back"}}, r"phase: omit it: a phase needs an exact surface"),
    ],
)
def test_surfaces_that_take_no_phase_say_so(surface: dict[str, Any], said: str) -> None:
    with pytest.raises(lf.SceneError, match=said):
        lf.Surface(semi_diameter_mm=4.0, phase=RADIAL, **surface)


@pytest.mark.parametrize(
    ("transport", "said"),
    [
        ({"polarisation": True}, r"surfaces\[1\].phase: omit it: transport.polarisation"),
        ({"surface": "patch"}, r"surfaces\[1\].phase: needs transport.surface = \"exact\""),
    ],
)
def test_settings_that_exclude_a_phase_say_so(transport: dict[str, Any], said: str) -> None:
    with pytest.raises(lf.SceneError, match=said):
        scene_of({"phase": RADIAL}, transport=transport)


def test_a_blaze_needs_two_media() -> None:
    blazed = RADIAL | {"efficiency": "blaze", "design_nm": 550.0}
    with pytest.raises(lf.SceneError, match=r"phase.efficiency = \"blaze\": needs different media on both sides"):
        scene_of({"phase": blazed, "index": 1.5})
    with pytest.raises(lf.SceneError, match=r"phase.efficiency = \"blaze\": needs different media on both sides"):
        scene_of({"phase": blazed}, image_medium={"index": 1.5})
    scene_of({"phase": blazed})


def test_an_efficiency_covers_the_wavelengths_of_the_scene() -> None:
    table = RADIAL | {"efficiency": {"wavelengths_nm": [500.0, 600.0], "values": [0.9, 0.7]}}
    with pytest.raises(lf.SceneError, match=r"efficiency: its table extends from 500 to 600 nm, without 650 nm"):
        scene_of({"phase": table}, transport={"wavelengths_nm": [550.0, 650.0]})
    assert phase_of(table).orders_of(550.0, None, 1.5) == ((1, pytest.approx(0.8)),)


def test_a_flat_surface_with_a_phase_is_no_pure_stop() -> None:
    """It stays an interface, marked as the stop or not."""
    lens = lf.Lens(surfaces=[{"stop": True, "semi_diameter_mm": 4.0, "phase": RADIAL}])
    assert not lens.is_pure_stop(0)
    assert not lens.surfaces[0].is_plain_stop
    assert lens.last_interface == 0
    with pytest.raises(lf.SceneError, match="only a stop"):
        lf.Lens(surfaces=[{"stop": True, "semi_diameter_mm": 4.0}])


def test_orders_have_their_shares() -> None:
    assert phase_of(RADIAL).orders_of(500.0, None, 1.5) == ((1, 1.0),)
    assert phase_of(RADIAL | {"order": -2}).orders_of(500.0, None, 1.5) == ((-2, 1.0),)
    several = [{"order": 0, "share": 0.1}, {"order": 3, "share": 0.8}]
    phase = phase_of(RADIAL | {"orders": several, "efficiency": 0.5})
    assert phase.orders_of(500.0, None, 1.5) == ((0, 0.05), (3, 0.4))
    assert phase.main_order == 3
    assert not phase.has_one_order
    assert phase.reflected() == ((0, 1.0),)


def test_a_blaze_follows_wavelength_and_dispersion() -> None:
    """α = b (λ₀/λ)(n − n')/(n₀ − n₀')."""
    blazed = phase_of(RADIAL | {"efficiency": "blaze", "design_nm": 550.0, "blaze_order": 2})
    assert blazed.orders_of(550.0, None, 1.5) == ((2, 1.0),)
    glass = "SCHOTT/N-BK7"
    from lfmesh.optics.glass import refractive_index

    n, design = (refractive_index(glass, each) for each in (480.0, 550.0))
    alpha = 2.0 * 550.0 / 480.0 * (n - 1.0) / (design - 1.0)
    wanted = (math.sin(math.pi * (alpha - 2.0)) / (math.pi * (alpha - 2.0))) ** 2
    for media in ((None, glass), (glass, None)):
        assert blazed.orders_of(480.0, *media) == ((2, pytest.approx(wanted, rel=1e-12)),)


def test_the_main_order_of_a_blaze_is_the_one_that_it_is_blazed_for() -> None:
    blazed = RADIAL | {"efficiency": "blaze", "design_nm": 550.0, "levels": 2}
    listed = [{"order": 0}, {"order": -1}, {"order": 3}]
    assert phase_of(blazed | {"orders": listed}).main_order == -1
    assert phase_of(blazed | {"orders": [*listed, {"order": 1}]}).main_order == -1
    assert phase_of(blazed | {"levels": 3, "orders": [*listed, {"order": 1}]}).main_order == 1


def test_reflected_orders_exclude_a_single_order() -> None:
    phase = phase_of(RADIAL | {"reflected_orders": [{"order": 0, "share": 0.5}, {"order": 1, "share": 0.3}]})
    assert phase.reflected() == ((0, 0.5), (1, 0.3))
    assert not phase.has_one_order
    assert phase_of(RADIAL).has_one_order


@pytest.mark.parametrize(
    "keys",
    [
        RADIAL,
        METALENS,
        {"kind": "grating", "lines_per_mm": 20.0, "direction_deg": 30.0},
        {"kind": "xy", "coefficients_rad": [[2, 0, -3.0], [0, 1, 0.5]], "radius_mm": 2.0},
        {
            "kind": "hologram", "point_1_mm": [0.0, 1.0, -50.0], "point_2_mm": [0.0, 0.0, 40.0], "point_2": "virtual",
            "construction_nm": 500.0,
        },
        RADIAL | {"orders": [{"order": 0, "share": 0.2}], "reflected_orders": [{"order": 1, "share": 0.1}]},
    ],
)  # fmt: skip
def test_a_scene_with_a_phase_is_written_and_read_again(keys: dict[str, Any]) -> None:
    scene = scene_of({"phase": keys})
    assert lf.loads(scene.dump_toml()) == scene
    assert lf.solved(lf.solved(scene)) == lf.solved(scene)


def test_a_phase_of_another_programs_file_keeps_its_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scene takes the keys of a lens that a reader has made."""
    lens = scene_of({"phase": RADIAL}).camera.lens
    monkeypatch.setattr("lfmesh.scene.files.reader_of", lambda path: lambda *_: (lens, ()))
    text = """schema_version = 1
    camera = { lens = { file = "lens.zmx" }, focus_mm = 500.0, sensor = { pixels = [8, 8], pixel_mm = 0.01 } }"""
    assert lf.loads(text, tmp_path).camera.lens == lens


class TestGrids:
    """Phases from files."""

    def test_a_grid_has_the_derivatives_of_its_samples(self, tmp_path: Path) -> None:
        write_grid(tmp_path / "phase.npz")
        scene = lf.solved(scene_of({"phase": {"kind": "grid", "file": "phase.npz"}}, tmp_path))
        phase = scene.camera.lens.surfaces[1].phase
        assert phase is not None
        assert phase.gradient_rad_mm == pytest.approx((3.0, 0.0), abs=1e-11)
        assert phase.curvature_rad_mm2 == pytest.approx((-20.0, 0.0, -40.0), abs=1e-9)
        assert phase.reach_mm == pytest.approx(5.0)

    def test_paths_start_from_the_scenes_folder(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (tmp_path / "elsewhere").mkdir()
        write_grid(tmp_path / "phase.npz")
        monkeypatch.chdir(tmp_path / "elsewhere")
        scene = scene_of({"phase": {"kind": "grid", "file": "phase.npz"}}, tmp_path)
        assert ("camera.lens.surfaces[1].phase.file", "phase.npz") in list(files_of(scene))
        assert lf.solved(scene).camera.lens.surfaces[1].phase is not None
        (tmp_path / "scene.toml").write_text(scene.dump_toml())
        assert lf.load(tmp_path / "scene.toml") == scene

    def test_a_changed_file_changes_the_solved_scene(self, tmp_path: Path) -> None:
        from lfmesh.geometry.lens.solved_camera import solved_camera

        write_grid(tmp_path / "phase.npz")
        scene = scene_of({"phase": {"kind": "grid", "file": "phase.npz"}}, tmp_path)
        before = solved_camera(scene).paraxial.efl_mm
        write_grid(tmp_path / "phase.npz", phase_rad=np.zeros((21, 31)))
        assert solved_camera(scene).paraxial.efl_mm > 1.001 * before

    def test_a_grid_in_a_lens_file_lies_beside_it(self, tmp_path: Path) -> None:
        (tmp_path / "lenses").mkdir()
        write_grid(tmp_path / "lenses" / "phase.npz")
        (tmp_path / "lenses" / "lens.toml").write_text(
            "surfaces = [{ radius_mm = 40.0, thickness_mm = 3.0, index = 1.5, semi_diameter_mm = 4.0, stop = true },\n"
            '{ semi_diameter_mm = 4.0, phase = { kind = "grid", file = "phase.npz" } }]\n'
        )
        scene = lf.Scene(
            camera={
                "lens": {"file": "lenses/lens.toml"},
                "focus_mm": 500.0,
                "sensor": SENSOR,
            }
        )
        phase = lf.solved(scene.in_folder(tmp_path)).camera.lens.surfaces[1].phase
        assert phase is not None
        assert phase.curvature_rad_mm2[2] == pytest.approx(-40.0)

    @pytest.mark.parametrize(
        ("arrays", "said"),
        [
            ({"phase_rad": np.zeros(7)}, r"phase_rad has the shape \(7,\); it must be an array \[x, y\]"),
            ({"phase_rad": np.zeros((3, 9))}, r"at least 4 samples"),
            ({"spacing_mm": [0.1, 0.2, 0.3]}, r"spacing_mm has the shape \(3,\); it must be one or two numbers"),
            ({"spacing_mm": 0.0}, r"spacing_mm must be above 0"),
            ({"origin_mm": 0.0}, r"origin_mm has the shape \(\); it must be two numbers"),
            ({"phase_rad": np.full((5, 5), np.nan)}, r"phase_rad must be finite"),
            ({"phase_rad": np.zeros((5, 5), complex)}, r"phase_rad must hold real numbers"),
            ({"phase": np.zeros((5, 5))}, r"unknown array 'phase'; valid are phase_rad, spacing_mm, origin_mm"),
            ({"phase_rad": np.mod(np.arange(25.0).reshape(5, 5) * 2.5, 2 * np.pi)}, r"phase_rad looks wrapped"),
        ],
    )
    def test_faults_of_a_file_are_named_with_it(self, tmp_path: Path, arrays: dict[str, Any], said: str) -> None:
        write_grid(tmp_path / "phase.npz", **arrays)
        scene = scene_of({"phase": {"kind": "grid", "file": "phase.npz"}}, tmp_path)
        with pytest.raises(lf.FileError, match=rf"phase.npz: .*{said}"):
            lf.solved(scene)
        (tmp_path / "scene.toml").write_text(scene.dump_toml())
        with pytest.raises(lf.SceneError, match=rf"surfaces\[1\].phase.file = .*phase.npz: .*{said}"):
            lf.load(tmp_path / "scene.toml")

    def test_other_files_are_no_grids(self, tmp_path: Path) -> None:
        (tmp_path / "phase.npz").write_text("none")
        scene = scene_of({"phase": {"kind": "grid", "file": "phase.npz"}}, tmp_path)
        with pytest.raises(lf.FileError, match=r"is no .npz file of numpy"):
            lf.solved(scene)
        with pytest.raises(lf.FileError, match=r"a phase grid ends in .npz"):
            lf.solved(scene.changed({"camera.lens.surfaces[1].phase.file": "scene.csv"}))

    def test_a_grid_covers_the_clear_aperture(self, tmp_path: Path) -> None:
        write_grid(tmp_path / "phase.npz")
        wide = {"phase": {"kind": "grid", "file": "phase.npz"}, "semi_diameter_mm": 5.1}
        with pytest.raises(lf.SceneError, match=r"phase: its grid ends 5 mm from the vertex, but .* 5.1 mm"):
            lf.solved(scene_of(wide, tmp_path))


ARRAY: dict[str, Any] = {"count": [8, 8], "pitch_mm": 0.12, "index": 1.5, "thickness_mm": 0.3, "distance_mm": 70.0}


class TestArrays:
    """Phases of lenslets."""

    def test_an_array_with_a_phase_may_be_flat(self) -> None:
        scene = scene_of({}, mla=ARRAY | {"curved_phase": METALENS})
        mla = lf.solved(scene).camera.mla
        assert mla is not None
        assert mla.types == 1
        assert mla.radius_mm == (math.inf,)
        assert lf.loads(scene.dump_toml()) == scene

    @pytest.mark.parametrize(
        ("keys", "said"),
        [
            ({}, "missing: give focal_length_mm, radius_mm, curved_phase or gradient"),
            ({"flat_phase": METALENS}, "missing: give focal_length_mm, radius_mm, curved_phase or gradient"),
            ({"radius_mm": math.inf}, "radius_mm = inf: a flat face bends no light"),
            ({"curved_phase": METALENS, "curved_finish": "diffuse"}, 'curved_phase: omit it: .* "diffuse"'),
            ({"radius_mm": 0.3, "flat_phase": METALENS, "flat_finish": "diffuse"}, 'flat_phase: omit it: .* "diffuse"'),
            ({"curved_phase": METALENS, "conic": [0.0, 1.0]}, "2 are given for 1 lenslet type"),
        ],
    )
    def test_faults_of_arrays(self, keys: dict[str, Any], said: str) -> None:
        with pytest.raises(lf.SceneError, match=said):
            lf.MicrolensArray(**ARRAY | keys)

    def test_settings_that_exclude_a_phase_say_so(self) -> None:
        with pytest.raises(lf.SceneError, match=r"camera.mla.curved_phase: omit it: transport.polarisation"):
            scene_of({}, mla=ARRAY | {"curved_phase": METALENS}, transport={"polarisation": True})

    def test_a_grid_covers_the_cells(self, tmp_path: Path) -> None:
        write_grid(tmp_path / "phase.npz", spacing_mm=[0.005, 0.005])
        keys = ARRAY | {"curved_phase": {"kind": "grid", "file": "phase.npz"}}
        with pytest.raises(lf.SceneError, match=r"curved_phase: its grid ends 0.05 mm .* 0.06 mm"):
            lf.solved(scene_of({}, tmp_path, mla=keys, sensor=SENSOR | {"distance_mm": 0.5}))

    def test_a_changed_file_changes_the_solved_array(self, tmp_path: Path) -> None:
        from lfmesh.geometry.lens.solved_camera import solved_camera

        write_grid(tmp_path / "phase.npz", spacing_mm=[0.01, 0.01])
        keys = ARRAY | {"curved_phase": {"kind": "grid", "file": "phase.npz"}}
        scene = scene_of({}, tmp_path, mla=keys, sensor=SENSOR | {"distance_mm": 0.5})
        found = []
        for bend in (-10.0, -20.0):
            x, y = np.linspace(-0.1, 0.1, 21), np.linspace(-0.15, 0.15, 31)
            write_grid(tmp_path / "phase.npz", phase_rad=bend * (x[:, None] ** 2 + y**2), spacing_mm=0.01)
            mla = solved_camera(scene).scene.camera.mla
            assert mla is not None
            assert mla.curved_phase is not None
            found.append(mla.curved_phase.curvature_rad_mm2[0])
        assert found == pytest.approx([-20.0, -40.0])
