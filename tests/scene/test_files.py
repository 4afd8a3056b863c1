"""Files and Python are the same thing, and a wrong file says everything that is wrong with it."""

import json
import math
import pickle
import tomllib
from pathlib import Path

import numpy as np
import pytest

from lfmesh.errors import SceneError
from lfmesh.scene import (
    ArrayForm,
    Box,
    Cylinder,
    DirectionalLight,
    Disk,
    DiskLight,
    Lens,
    MicrolensArray,
    Pose,
    Scene,
    Sphere,
    Surface,
    Target,
    load,
    loads,
    solved,
    toml,
)


@pytest.fixture
def rich(scene: Scene) -> Scene:
    """A scene that uses every kind of key."""
    return scene.changed(
        {
            "name": 'quotes " and \\ and µ\n',
            "camera.pose": Pose(shift_mm=(1.0, 2.0, 3.0)),
            "camera.lens.name": "singlet",
            "camera.lens.surfaces[1].conic": -0.5,
            "camera.lens.surfaces[1].asphere_mm": (0.0, 1.5e-9),
            "camera.lens.f_number": 5.6,
            "camera.mla.layout": "hexagonal",
            "camera.mla.focal_length_mm": (0.7, -0.9, 1.1),
            "camera.mla.pose": Pose(tilt_deg=(0.0, 0.1, 0.0)),
            "camera.mla.form": ArrayForm(decenter_mm=0.001, seed=7),
            "targets": (
                Target(shape=Disk(radius_mm=3.0), name="disk"),
                Target(shape=Box(size_mm=(1.0, 2.0, 3.0))),
                Target(shape=Sphere(radius_mm=1.0)),
                Target(shape=Cylinder(radius_mm=1.0, height_mm=2.0)),
                Target(file="part.stl", units="inch", rotation_deg=(0.0, 45.0, 0.0)),
            ),
            "lights": (
                DirectionalLight(direction=(0.0, 0.0, -1.0), irradiance_w_m2=3.0),
                DiskLight(direction=(0.0, 1.0, 0.0), position_mm=(1.0, 2.0, 3.0), radius_mm=5.0, power_w=1.0),
            ),
            "transport.wavelengths_nm": (450.0, 550.0, 650.0),
            "transport.split": "roulette",
        }
    )


def test_a_written_scene_loads_to_an_equal_one(rich: Scene, tmp_path: Path) -> None:
    (tmp_path / "part.stl").touch()
    (tmp_path / "scene.toml").write_text(rich.dump_toml(), encoding="utf-8")
    again = load(tmp_path / "scene.toml")
    assert again == rich
    assert again.digest == rich.digest
    assert again.dump_toml() == rich.dump_toml()


def test_written_numbers_keep_every_bit() -> None:
    bits = np.random.default_rng(4).integers(0, 2**64, 2000, dtype=np.uint64)
    numbers = bits.view(np.float64)
    numbers = (*numbers[np.isfinite(numbers)].tolist(), math.inf, -math.inf, -0.0, 5e-324, 1e16, 1e22)
    read = tomllib.loads(toml.dump(Surface.model_construct(semi_diameter_mm=1.0, asphere_mm=numbers)))
    assert np.array(read["asphere_mm"]).tobytes() == np.array(numbers).tobytes()


def test_a_written_surface_is_one_line(rich: Scene) -> None:
    lines = rich.dump_toml().splitlines()
    first = lines.index("surfaces = [") + 1
    surfaces = [tomllib.loads(f"surface = {line.strip().rstrip(',')}") for line in lines[first : lines.index("]")]]
    assert [entry["surface"]["semi_diameter_mm"] for entry in surfaces] == [6.0, 10.0, 10.0]
    assert sum(line.startswith("shape = {") for line in lines) == 4


def test_json_holds_the_keys_of_the_file(rich: Scene) -> None:
    assert json.loads(rich.to_json()) == tomllib.loads(rich.dump_toml())
    assert Scene.model_validate_json(rich.to_json()) == rich


def test_digest_follows_every_value(scene: Scene) -> None:
    other = scene.changed({"camera.mla.pitch_mm": 0.1200001})
    assert other != scene
    assert other.digest != scene.digest
    assert scene.changed({"name": "singlet"}).digest == scene.digest


def test_a_digest_is_computed_once_and_never_that_of_another_scene(scene: Scene) -> None:
    assert scene.digest is scene.digest
    named = scene.model_copy(update={"name": "other"})
    assert named.digest == scene.changed({"name": "other"}).digest != scene.digest
    assert scene.in_folder("elsewhere").digest == scene.with_digests({"a": "b"}).digest == scene.digest
    assert pickle.loads(pickle.dumps(scene)).digest == scene.digest


def test_numpy_values_are_plain_numbers() -> None:
    surface = Surface(radius_mm=np.float32(25), thickness_mm=np.int64(3), asphere_mm=np.array([0.0, 1e-6]))
    assert surface == Surface(radius_mm=25.0, thickness_mm=3.0, asphere_mm=(0.0, 1e-6))


def test_paths_start_from_the_scene_file(scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(scene.dump_toml())
    assert load(tmp_path / "scene.toml").resolve("charts/star.png") == tmp_path / "charts" / "star.png"
    assert solved(load(tmp_path / "scene.toml")).folder == tmp_path


def test_a_lens_file_stands_for_its_surfaces(scene: Scene, tmp_path: Path) -> None:
    text = scene.dump_toml()
    start, end = text.index("surfaces = ["), text.index("[camera.mla]")
    (tmp_path / "lens.toml").write_text('name = "held"\nf_number = 9.0\n' + text[start:end])
    (tmp_path / "scene.toml").write_text(text[:start] + 'file = "lens.toml"\nf_number = 4.0\n\n' + text[end:])
    loaded = load(tmp_path / "scene.toml")
    assert loaded.camera.lens.surfaces == scene.camera.lens.surfaces
    assert loaded.camera.lens.name == "held"
    assert loaded.camera.lens.f_number == 4.0

    scripted = scene.changed({"camera.lens": {"file": "lens.toml", "f_number": 4.0}}).in_folder(tmp_path)
    assert solved(scripted) == solved(loaded)


def test_a_fault_in_a_lens_file_names_the_file(scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "lens.toml").write_text("surfaces = [ { radius_mm = 0.0, semi_diameter_mm = 1.0 } ]")
    text = scene.dump_toml()
    start, end = text.index("surfaces = ["), text.index("[camera.mla]")
    (tmp_path / "scene.toml").write_text(text[:start] + 'file = "lens.toml"\n\n' + text[end:])
    with pytest.raises(SceneError, match=r"camera\.lens\.surfaces\[0\]\.radius_mm \(lens\.toml\) = 0\.0: must be"):
        load(tmp_path / "scene.toml")


EVERYTHING_WRONG = """
nam = "x"
[camera]
focus_mm = "500"
[camera.lens]
surfaces = [
  { radius_mm = nan, thickness_mm = -3.76, index = 1.67, semi_diameter_mm = 12.6, conik = 1 },
  { radius_mm = 10, thickness_mm = 0.12, semi_diameter_mm = 12.6 },
  { radius_mm = 10, semi_diameter_mm = 5.0, glass = "SCHOTT/N-BK77" },
]
[camera.mla]
layout = "sqare"
count = [64, 64.5]
pitch_mm = 0.125
focal_length_mm = [0.5, 1, 2, 3]
index = 1.5
thickness_mm = 0.3
[camera.sensor]
pixels = [640]
pixel_mm = inf
[[targets]]
shape = { kind = "plne" }
material = { reflectance = 1.8, texture = "none.png" }
[[targets]]
file = "none.stl"
units = "mm"
[[lights]]
kind = "directional"
direction = [0, 0, 0]
irradiance_w_m2 = 2
[transport]
wavelengths_nm = []
"""

EVERY_FAULT = [
    "nam: unknown key (did you mean 'name'?)",
    'camera.focus_mm = "500": must be a number',
    "camera.lens.surfaces[0].radius_mm = nan: must be a number other than 0",
    "camera.lens.surfaces[0].thickness_mm = -3.76: must be 0 or more",
    "camera.lens.surfaces[0].conik: unknown key (did you mean 'conic'?)",
    "camera.lens.surfaces[1].semi_diameter_mm = 12.6: with radius_mm = 10",
    'camera.lens.surfaces[2].glass = "SCHOTT/N-BK77": not in the catalogue; close to it are SCHOTT/N-BK7',
    "camera.mla.layout = \"sqare\": must be 'square' or 'hexagonal' (did you mean 'square'?)",
    "camera.mla.count[1] = 64.5: must be a whole number",
    "camera.mla.focal_length_mm = [0.5, 1, 2, 3]: may have at most 3 entries",
    "camera.sensor.pixels[1]: missing",
    "camera.sensor.pixel_mm = inf: must be a finite number",
    'targets[0].shape.kind = "plne": valid kinds are plane, disk, sphere, box, cylinder (did you mean',
    "targets[0].material.reflectance = 1.8: must be 1 or less",
    'targets[0].material.texture = "none.png": no such file',
    'targets[1].file = "none.stl": no such file',
    "lights[0].direction = [0.0, 0.0, 0.0]: must not be the zero vector",
    "transport.wavelengths_nm = []: must not be empty",
]


def test_every_fault_is_reported_at_once(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(EVERYTHING_WRONG)
    with pytest.raises(SceneError) as caught:
        load(tmp_path / "scene.toml")
    head, *lines = str(caught.value).splitlines()
    assert head == f"{tmp_path / 'scene.toml'}: {len(EVERY_FAULT)} faults"
    for fault in EVERY_FAULT:
        assert sum(line.strip().startswith(fault) for line in lines) == 1, fault
    assert len(lines) == len(EVERY_FAULT)


def test_a_syntax_error_gives_file_line_and_column(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text("name = 'x'\n[camera\n")
    with pytest.raises(SceneError, match=r"scene\.toml: not valid TOML: .*line 2, column 8"):
        load(tmp_path / "scene.toml")


@pytest.mark.parametrize("content", [None, b"\xff\xfe"])
def test_an_unreadable_file_is_named(content: bytes | None, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "scene.toml").write_bytes(content)
    with pytest.raises(SceneError, match=r"scene\.toml: (cannot be read|byte 0)"):
        load(tmp_path / "scene.toml")


# One change to a good scene each, and what the error must say.
WRONG = [
    ({"camera.lens.surfaces": [{"stop": True, "semi_diameter_mm": 1.0}]}, r"lens\.surfaces: only a stop"),
    ({"camera.lens.surfaces[0].semi_diameter_mm": None}, r"surfaces\[0\]\.semi_diameter_mm: missing"),
    ({"camera.lens.surfaces[1].stop": True}, r"surfaces\[1\]\.stop = true: surfaces\[0\] is already the stop"),
    ({"camera.lens.surfaces[1].glass": "N-BK7"}, r"surfaces\[1\]\.glass.*index = 1\.5 is given too"),
    ({"camera.lens.surfaces[1].thickness_mm": None}, r"surfaces\[1\]\.thickness_mm: missing"),
    ({"camera.image_medium": {"index": 1.6}}, r"mla\.index = 1\.5: .* behind the lens; .* an index above 1\.6"),
    ({"camera.lens.surfaces[2].index": 1.5}, r"mla\.index = 1\.5: .* behind the lens; .* an index above 1\.5"),
    ({"camera.lens.surfaces[2].thickness_mm": 5.0}, r"surfaces\[2\]\.thickness_mm = 5\.0: omit it"),
    ({"camera.lens.surfaces": ()}, r"camera\.lens\.surfaces: missing"),
    ({"camera.lens.f_number": 4.0, "camera.lens.stop_semi_diameter_mm": 2.0}, r"f_number = 4\.0: stop_s"),
    ({"camera.mla.radius_mm": 0.35}, r"focal_length_mm = \[0\.7\]: radius_mm is given too"),
    ({"camera.mla.focal_length_mm": None}, r"focal_length_mm: missing"),
    ({"camera.mla.focal_length_mm": 0.0}, r"focal_length_mm\[0\] = 0\.0: must not be 0"),
    ({"camera.mla.focal_length_mm": 0.16}, r"makes radius_mm = 0\.08 .*does not reach"),
    ({"camera.mla.focal_length_mm": 0.17, "camera.mla.thickness_mm": 0.05}, "more than thickness_mm"),
    ({"camera.mla.glass": "N-BK7"}, r"mla\.glass.*index = 1\.5 is given too"),
    ({"camera.mla.index": None}, r"mla\.index: missing"),
    ({"camera.mla.index": 1.0}, r"mla\.index = 1\.0: must be above 1"),
    ({"camera.mla.conic": (0.0, -1.0)}, r"mla\.conic = \[0.0, -1.0\]: 2 are given for 1 lenslet type; "),
    ({"camera.mla.conic": "flat"}, r"mla\.conic.*: must be a number"),
    ({"camera.mla.conic": ()}, r"mla\.conic.*: must not be empty"),
    ({"camera.mla.conic": float("nan")}, r"mla\.conic.*: must be a finite number"),
    ({"camera.mla.conic": 20.0}, r"makes radius_mm = 0\.35 .*conic = 20 .*end 0\.0763\d* mm from the axis"),
    ({"camera.mla.asphere_mm": [[1.0], [2.0]]}, r"mla\.asphere_mm = .*: 2 are given for 1 lenslet type; "),
    ({"camera.mla.asphere_mm": [1e6]}, r"up to 51\.85\d* mm deep in its cell, more than thickness_mm = 0\.3"),
    ({"camera.mla.asphere_mm": [-1e6]}, r"rises up to 51\.8\d* mm over its apexes, more than pitch_mm = 0\.12"),
    ({"camera.mla.asphere_mm": 3.0}, r"mla\.asphere_mm = 3\.0: must be a list"),
    ({"camera.mla.count": 24}, r"mla\.count = 24: must be a list: Number of lenslets: columns, rows"),
    ({"camera.mla.pitch_mm": 125.0}, r"give a pitch_mm below 125, or here 26042 or more"),
    ({"targets": {}}, r"targets: must be a list of tables: write \[\[targets\]\] above each of them"),
    ({"camera.sensor.bands": {}}, r"sensor\.bands: must be a list of tables: write \[\[\.\.\.bands\]\] above"),
    ({"camera.lens.coating": "ar"}, r"lens\.coating: unknown key; it belongs to a surface: .*lfmesh lens convert lib:"),
    ({"camera.lens.file": "lib:tessar_50mm"}, r"surfaces are given too; .*lens convert lib:tessar_50mm lens\.toml"),
    ({"camera.mla.asphere_mm": [0.0] * 15}, r"mla\.asphere_mm\[0\] = .*may have at most 14 entries"),
    ({"camera.mla.cylinder_axis": "z"}, r"mla\.cylinder_axis = \"z\": must be 'x' or 'y'"),
    ({"camera.mla.cylinder_axis": "y", "camera.mla.layout": "hexagonal"},
     r"mla\.cylinder_axis = \"y\": cylinders need layout = \"square\""),
    ({"camera.mla.count": (10**6, 10**6)}, r"mla\.count = .*the lenslets take 3.2e\+04 GB"),
    ({"camera.sensor.pixels": (10**6, 10**6)}, r"sensor\.pixels = .*the film takes 4\.8e\+04 GB"),
    ({"camera.lens.surfaces[1].index": None, "camera.lens.surfaces[1].glass": "HIKARI/SK16",
      "transport.wavelengths_nm": (900.0,)}, r"surfaces\[1\]\.glass: .*900 nm.*from 400 to 700 nm"),
    ({"targets[0].file": "a.stl"}, r"targets\[0\]\.file = \"a\.stl\": a shape is given too"),
    ({"targets[0].shape": None}, r"targets\[0\]\.shape: missing"),
    ({"targets[0].units": "mm"}, r"targets\[0\]\.units = \"mm\": only for a mesh file"),
    ({"targets[0].shape": None, "targets[0].file": "a.STL"}, r"targets\[0\]\.units: missing: STL files"),
    ({"targets[0].shape": None, "targets[0].file": "a.stk"}, r"must end in one of .*did you mean '\.st"),
    ({"camera.focus_mm": 1e300}, r"focus_mm = 1e\+300: must be 1e\+15 or less, and above 0; inf is"),
    ({"camera.focus_mm": 0.0}, r"focus_mm = 0\.0: must be 1e\+15 or less, and above 0"),
    ({"transport.wavelengths_nm": (500.0, 500.0)}, r"must not contain a wavelength twice"),
    ({"camera.mla.layout": 6}, r"layout = 6: must be 'square' or 'hexagonal'"),
    ({"schema_version": 2}, r"schema_version = 2: must be 1"),
]  # fmt: skip


@pytest.mark.parametrize(("values", "message"), WRONG)
def test_what_does_not_fit_together_is_refused(scene: Scene, values: dict[str, object], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        scene.changed(values)


def test_lenslets_that_diverge_are_said_to_be_why_the_sensor_has_no_place(scene: Scene) -> None:
    with pytest.raises(SceneError, match=r"^camera\.mla: the first lenslet type diverges \(focal length -0\.5 mm\)"):
        solved(scene.changed({"camera.mla.focal_length_mm": -0.5, "camera.sensor.distance_mm": None}))


def test_files_that_carry_units_need_none() -> None:
    assert Target(file="part.glb").units is None


def test_surfaces_may_touch_but_not_cross() -> None:
    """Two spheres of radius 10 bulging towards each other meet at the axis when their gap is 0."""

    def doublet(gap_mm: float) -> Lens:
        return Lens(
            surfaces=(
                Surface(radius_mm=20.0, thickness_mm=5.0, index=1.5, semi_diameter_mm=5.0),
                Surface(radius_mm=10.0, thickness_mm=gap_mm, semi_diameter_mm=5.0),
                Surface(radius_mm=-10.0, thickness_mm=5.0, index=1.5, semi_diameter_mm=5.0),
                Surface(radius_mm=-20.0, semi_diameter_mm=5.0, stop=True),
            )
        )

    # At the rim each is 10 − √75 mm from its vertex plane, and they curve into the gap.
    needed = 2 * (10 - 75**0.5)
    doublet(needed + 1e-6)
    with pytest.raises(SceneError, match=r"surfaces 1 and 2 cross .* at 5 mm from the axis; give 2\.6795 or more"):
        doublet(needed - 1e-6)


def test_an_asphere_enters_the_crossing_test() -> None:
    def lens(bump: float) -> Lens:
        return Lens(
            surfaces=(
                Surface(thickness_mm=1.0, index=1.5, semi_diameter_mm=10.0, asphere_mm=(bump,)),
                Surface(semi_diameter_mm=10.0, stop=True),
            )
        )

    lens(0.9e-4)
    with pytest.raises(SceneError, match="cross"):
        lens(1.1e-4)


def test_an_error_from_python_names_model_and_field() -> None:
    with pytest.raises(SceneError, match=r"^MicrolensArray\.thickness_mm = -1: must be above 0$"):
        MicrolensArray(count=(2, 2), pitch_mm=1.0, focal_length_mm=3.0, index=1.5, thickness_mm=-1)


def test_text_loads_like_a_file(scene: Scene) -> None:
    assert loads(scene.dump_toml()) == scene
    with pytest.raises(SceneError, match="camera: missing"):
        loads("schema_version = 1")


def test_the_schema_describes_every_field() -> None:
    schema = Scene.model_json_schema()
    for model in [schema, *schema["$defs"].values()]:
        assert model["additionalProperties"] is False
        for key, field in model["properties"].items():
            described = field.get("description", "")
            assert described, f"{model['title']}.{key}"
            for suffix, unit in (("_mm", "mm"), ("_nm", "nm"), ("_deg", "degrees"), ("_w", " W")):
                assert not key.endswith(suffix) or unit in described, f"{model['title']}.{key}: {described}"
