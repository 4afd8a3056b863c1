"""The recipes of `transport/ADDING.md`, put into a copy of the package, make what they promise."""

import json
import math
import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

import lfmesh

PACKAGE = Path(lfmesh.__file__).parent
RECIPES = (PACKAGE / "transport" / "ADDING.md").read_text()

SCRIPT = """
import json
from pathlib import Path

import numpy as np
import trimesh

import lfmesh as lf
from lfmesh.accuracy.hard.outcome import faces_of
from lfmesh.imports import write_lens_file
from lfmesh.scene.media.phase import LinearPhase
from lfmesh.transport.tables.interfaces import coating_lines
from lfmesh.transport.tables.phases import phase_functions
from lfmesh.view.scene3d.describe import describe

found = {}


def camera(front, pixel_mm=3.0, focus_mm=60.0, semi_diameter_mm=8.0):
    lens = [{"radius_mm": 20.0, "thickness_mm": 5.0, "index": 1.5, "semi_diameter_mm": semi_diameter_mm, "stop": True},
            {"radius_mm": -20.0, "semi_diameter_mm": 8.0}]
    return {"lens": {"surfaces": [lens[0] | front, lens[1]]}, "focus_mm": focus_mm,
            "sensor": {"pixels": [1, 1], "pixel_mm": pixel_mm}}


def watts(samples, **scene):
    transport = {"replicates": 32, "threads": 1, "samples": samples, "split": "both", **scene.pop("transport", {})}
    image = lf.render(lf.Scene(**scene, transport=transport).in_folder(Path.cwd()))
    return [float(image.mean[0, 0, 0]), float(image.stderr[0, 0, 0]), float(image.ledger.reached_target)]


def plane(z, size, material, position=(0.0, 0.0), turned=(0.0, 0.0, 0.0)):
    return {"shape": {"kind": "plane", "width_mm": size, "height_mm": size}, "position_mm": [*position, z],
            "rotation_deg": turned, "material": material}


# A coating, and one that absorbs nothing, which is the bare face.
grey = lf.Scene(camera=camera({"coating": "grey"}, focus_mm=500.0), coatings={"grey": {"transmittance": 0.25}})
clear = grey.changed({"coatings.grey.transmittance": 1.0})
bare = grey.changed({"camera.lens.surfaces.0.coating": "none"})
for name, scene in (("grey", grey), ("clear", clear), ("bare", bare)):
    for engine in ("mesh", "sequential"):
        paths = lf.trace(lf.build(scene), [[0.0, 6.0, -5.0]], [[0.0, 0.0, 1.0]], split="transmit", engine=engine)
        straight = paths.weight[paths.status == lf.Status.SENSOR].sum()
        absorbed = paths.ledger.absorbed.get("coating of lens surface 0", 0.0)
        found[f"coating {name} {engine}"] = [float(straight), float(absorbed)]
found["coating shown"] = coating_lines(lf.solved(grey))
lens = grey.camera.lens.model_copy(update={"coatings": grey.coatings})
found["coating written"] = write_lens_file(lens, Path("grey.zmx"))
for name, coating in (("both", {"transmittance": 0.5, "reflectance": 0.1}), ("none", {})):
    try:
        lf.Scene(camera=camera({}), coatings={"grey": coating})
    except lf.LfmeshError as error:
        found["coating refused " + name] = str(error)

# A finish: a block between camera and lamp, and in a furnace.
trimesh.creation.box((10.0, 10.0, 3.0)).export("block.stl")
for finish in ({"kind": "satin", "lobe": 0.5}, {"kind": "satin", "lobe": 0.0}, "diffuse"):
    refractor = {"file": "block.stl", "units": "mm", "index": 1.6, "finish": finish}
    block = {"refractor": refractor, "position_mm": [0.0, 0.0, -50.0], "rotation_deg": [0.0, 15.0, 0.0]}
    lamp = {"kind": "point", "position_mm": [3.0, 1.0, -70.0], "power_w": 1.0}
    name = "finish " + (finish if isinstance(finish, str) else str(finish["lobe"]))
    for method, samples in (("adjoint", 2048), ("forward", 65536)):
        found[f"{name} {method}"] = watts(
            samples, camera=camera({}), targets=[block], lights=[lamp], transport={"method": method})
    if name == "finish 0.5":
        glow = {"reflectance": 0.0, "radiance_w_m2_sr": 1000.0}
        walls = [plane(-350, 400, glow), plane(50, 400, glow), plane(-150, 400, glow, (-200, 0), (0, 90, 0)),
                 plane(-150, 400, glow, (200, 0), (0, 90, 0)), plane(-150, 400, glow, (0, -200), (90, 0, 0)),
                 plane(-150, 400, glow, (0, 200), (90, 0, 0))]
        once = {"max_events": 1000, "split": "transmit", "replicates": 2}
        for what, targets in (("furnace", [*walls, block]), ("empty", walls)):
            found[what] = watts(256, camera=camera({}, 0.5), targets=targets, transport=once)

# A shape: directions behind a saddle and a flat face.
twist, x, y = 0.01, np.array([3.0, -4.0, 2.0, 0.0, 5.0]), np.array([4.0, 3.0, -5.0, 2.0, 5.0])
flat = {"radius_mm": float("inf"), "semi_diameter_mm": 8.0}
lens = {"surfaces": [{"saddle": {"twist_per_mm": twist}, "thickness_mm": 5.0, "index": 1.5, "semi_diameter_mm": 8.0,
                      "stop": True}, flat]}
sensor = {"pixels": [40, 40], "pixel_mm": 1.0, "distance_mm": 20.0}
world = lf.build(lf.Scene(camera={"lens": lens, "sensor": sensor}))
rays = np.column_stack([x, y, np.full(5, -5.0)]), np.tile([0.0, 0.0, 1.0], (5, 1))
n = np.column_stack([-twist * y, -twist * x, np.ones(5)])
n /= np.linalg.norm(n, axis=1, keepdims=True)


def bent(d, n, eta):
    cosine = (d * n).sum(axis=1, keepdims=True)
    return eta * d + (np.sqrt(1.0 - eta**2 * (1.0 - cosine**2)) - eta * cosine) * n


truth = bent(bent(rays[1], n, 1.0 / 1.5), rays[1], 1.5)
for engine in ("mesh", "sequential"):
    paths = lf.trace(world, *rays, split="transmit", engine=engine)
    found["shape " + engine] = float(np.abs(paths.direction - truth).max()) if len(paths.direction) == 5 else 1.0
# Rays that dip a millionth of a millimetre into a saddle, most of them between the vertices of its mesh.
steep, start, twist_mm = np.linspace(0.01, 0.15, 120), -6.0 * 0.5**0.5, 0.05
hollow = {"surfaces": [lens["surfaces"][0] | {"saddle": {"twist_per_mm": twist_mm}, "thickness_mm": 6.0}, flat]}
low = 1e-6 - steep**2 / (2.0 * twist_mm) - 6.0 * steep
ways = np.column_stack([np.full((120, 2), 0.5**0.5), steep])
rays = np.column_stack([np.full((120, 2), start), low]), ways / np.linalg.norm(ways, axis=1, keepdims=True)
paths = lf.trace(lf.build(lf.Scene(camera={"lens": hollow, "sensor": sensor})), *rays, split="transmit", engine="mesh")
found["shape passed by"] = int((np.abs(paths.direction - rays[1][paths.source]).max(axis=1) < 1e-9).sum())
glued = camera({})
glued["lens"]["surfaces"][1] = {"saddle": {"twist_per_mm": twist}, "semi_diameter_mm": 8.0}
found["shape warned"] = lf.first_order(lf.Scene(camera=glued)).warnings
found["shape described"] = dict(describe(world, "lens[0]"))["front"]
stop = {"semi_diameter_mm": 5.0, "stop": True, "thickness_mm": 2.0}
for name, front in (("saddle", {"saddle": {"twist_per_mm": twist}}), ("flat", {})):
    glass = {"radius_mm": 30.0, "thickness_mm": 4.0, "index": 1.5, "semi_diameter_mm": 8.0}
    found["only stops " + name] = lf.Lens(surfaces=[front | stop, glass, flat]).is_pure_stop(0)
try:
    lf.Surface(saddle={"twist_per_mm": twist}, radius_mm=30.0, index=1.5, semi_diameter_mm=8.0)
except lf.LfmeshError as error:
    found["radius refused"] = str(error)
for file in ("lens.seq", "lens.zmx"):
    try:
        write_lens_file(world.scene.camera.lens, Path(file))
    except lf.LfmeshError as error:
        found[file] = str(error)
try:
    faces_of(world.scene)
except NotImplementedError as error:
    found["truth refused"] = str(error)
# Its corners lie above and below: a plate that clears them in one quarter alone must be refused.
thin = [lens["surfaces"][0] | {"thickness_mm": 0.1}, flat]
try:
    lf.Scene(camera={"lens": {"surfaces": thin}, "sensor": sensor})
except lf.LfmeshError as error:
    found["shape refused"] = str(error)

# A light.
cosine = {"kind": "cosine", "position_mm": [60.0, 0.0, -220.0], "direction": [0.0, 0.0, -1.0], "power_w": 1.0}
small = camera({}, 0.01, 300.0, 1.0)
for name, lamp in (("point", {"kind": "point", "position_mm": cosine["position_mm"], "power_w": 1.0}),
                   ("0", cosine | {"exponent": 0.0}), ("3", cosine | {"exponent": 3.0})):
    found["light " + name] = watts(
        64, camera=small, targets=[plane(-300.0, 400.0, {"reflectance": 0.5})], lights=[lamp])
lamps = {"wide": {"direction": [-12.0, -3.0, -20.0], "exponent": 3.0},
         "narrow": {"direction": [-11.0, -3.0, -20.0], "exponent": 4000.0}}
for name, changes in lamps.items():
    near = cosine | {"position_mm": [12.0, 3.0, -30.0]} | changes
    for method, samples in (("adjoint", 16384), ("forward", 262144)):
        found[f"light {name} {method}"] = watts(
            samples, camera=camera({}), targets=[plane(-50.0, 8.0, {"reflectance": 0.9})], lights=[near],
            transport={"method": method})

# A lamp with a size: two halves of a disk, and both methods, in fog as well.
wide = {"kind": "disk", "position_mm": [8.0, 2.0, -38.0], "direction": [-8.0, -2.0, -14.0], "radius_mm": 6.0}
half = wide | {"kind": "sector", "angle_deg": 180.0, "power_w": 2.0}
third = wide | {"kind": "sector", "angle_deg": 120.0, "turn_deg": 50.0, "power_w": 3.0}
cloud = {"bounds": {"kind": "sphere", "radius_mm": 14.0}, "position_mm": [0.0, 0.0, -46.0], "scattering_per_mm": 0.01}
sheet = [plane(-50.0, 8.0, {"reflectance": 0.9})]
full, other_half = wide | {"power_w": 4.0}, half | {"turn_deg": 180.0}
for name, lamp in (("whole", full), ("half", half), ("other half", other_half)):
    found["sized " + name] = watts(16384, camera=camera({}), targets=sheet, lights=[lamp])
for name, media in (("air", []), ("fog", [cloud])):
    for method, samples in (("adjoint", 16384), ("forward", 262144)):
        found[f"sized {name} {method}"] = watts(
            samples, camera=camera({}), targets=sheet, lights=[third], media=media, transport={"method": method})

# A phase function.
sun = {"kind": "directional", "direction": [0.6, 0.0, 0.8], "irradiance_w_m2": 100.0}
for name, phase in (("isotropic", {"kind": "isotropic"}), ("linear", {"kind": "linear", "slope": 0.9})):
    fog = {"bounds": {"kind": "sphere", "radius_mm": 2.0}, "position_mm": [0.0, 0.0, -300.0],
           "scattering_per_mm": 1e-6, "phase": phase}
    found["phase " + name] = watts(256, camera=small, media=[fog], lights=[sun])
found["mean cosine"] = phase_functions(LinearPhase(slope=0.9), (550.0,), grey, "")[0].mean_cosine
print(json.dumps(found))
"""


def blocks_of(recipe: str) -> list[str]:
    """Return the blocks of code in a recipe, as they stand in a file."""
    (text,) = (part for part in RECIPES.split("\n## ") if part.startswith(recipe + "\n"))
    return [textwrap.dedent(block.partition("\n")[2]).rstrip() for block in text.split("```python")[1:]
            for block in [block.partition("```")[0]]]  # fmt: skip


def put(tree: Path, file: str, before: str, block: str, indent: int) -> None:
    """Put a block of a recipe before a line of a file."""
    path = tree / "lfmesh" / file
    source = path.read_text()
    assert source.count(before) == 1, (file, before)
    path.write_text(source.replace(before, textwrap.indent(block, " " * indent) + "\n" + before))


def change(tree: Path, file: str, *pairs: tuple[str, str]) -> None:
    """Replace words of a file that a recipe tells to change."""
    path = tree / "lfmesh" / file
    source = path.read_text()
    for old, new in pairs:
        assert source.count(old) == 1, (file, old)
        source = source.replace(old, new)
    path.write_text(source)


def run_in(tree: Path, script: str) -> str:
    environment = os.environ | {"PYTHONPATH": str(tree)}
    done = subprocess.run([sys.executable, "-c", script], env=environment, cwd=tree, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def add_coating(tree: Path) -> None:
    field, absorbs, passed = blocks_of("A coating")
    file, tables = "scene/materials/coatings.py", "transport/tables/coatings.py"
    put(tree, file, "    @property\n    def kind(self)", field + "\n", 4)
    put(tree, tables, "    return any(stack_of(coating.layers or (), wavelength).absorbs", absorbs, 4)
    put(tree, tables, "        return np.stack([from_thin, from_dense, passed])\n", passed, 8)


def add_finish(tree: Path) -> None:
    field, parameters, direction, density = blocks_of("A finish")
    file, events = "scene/materials/finishes.py", "transport/events/interface.py"
    put(tree, file, "    roughness: Roughness | None = None\n", field, 4)
    change(
        tree, file, ('Literal["polished", "diffuse", "ground"]', 'Literal["polished", "diffuse", "ground", "satin"]')
    )
    change(tree, "transport/tables/tables.py", ('"diffuse", "ground")', '"diffuse", "ground", "satin")'))
    change(tree, "transport/tables/tables.py", ("DIFFUSE, GROUND = range", "DIFFUSE, GROUND, SATIN = range"))
    put(tree, "transport/tables/interfaces.py", "    if kind == GROUND:\n        return [[", parameters, 4)
    change(tree, "transport/tables/interfaces.py", ("    ROUGH,\n", "    ROUGH,\n    SATIN,\n"))
    put(tree, events, GROUND_TURN + "    key = derived(packet.key, IN_WALK", direction, 4)
    put(tree, events, GROUND_TURN + "    to_a, to_b", density, 4)
    change(tree, events, ("DIFFUSE, ROUGH, THIN_LENS,", "DIFFUSE, ROUGH, SATIN, THIN_LENS,"))
    change(tree, events, ("import lambertian, tangents", "import lambertian, near, tangents"))


GROUND_TURN = """    px, py, pz, qx, qy, qz = tangents(-nx, -ny, -nz)
    a, b, c = dx * px + dy * py + dz * pz, dx * qx + dy * qy + dz * qz, -(dx * nx + dy * ny + dz * nz)
"""


def add_shape(tree: Path) -> None:
    form, field, fills, height, heights, bends = blocks_of("A shape of surface")
    model, surface, bounds = "scene/camera/surface.py", "geometry/surfaces/surface.py", "geometry/surfaces/bends.py"
    put(tree, "scene/camera/sections.py", "@lru_cache(maxsize=256)\n", form + "\n\n", 0)
    put(tree, model, "    paraxial: Flag = False\n", field, 4)
    change(tree, model, ("import Biconic, Toroid", "import Biconic, Saddle, Toroid"))
    change(tree, surface, ("BICONIC, TOROID = range(4)", "BICONIC, TOROID, SADDLE = range(5)"))
    put(tree, surface, "    ]\n)\n\nNEWTON_STEPS", '("twist", "f8"),', 8)
    put(tree, surface, "    if of.toroid is not None:\n        record", fills, 4)
    put(tree, surface, "    if s.kind == TOROID:\n", height, 4)
    put(tree, bounds, "    # Outward from the axis a biconic is", heights, 4)
    put(tree, bounds, '    if surface["kind"] == BICONIC:\n        return extremes', bends, 4)
    change(tree, bounds, ("import BICONIC, TOROID, is_revolved", "import BICONIC, SADDLE, TOROID, is_revolved"))


def add_light(tree: Path) -> None:
    cosine, law, intensity, drawn, sector, area, angle, places, holds = blocks_of("A light")
    models, tables, kernels = "scene/light/lights.py", "transport/tables/lights.py", "transport/lights/intensity.py"
    put(tree, models, "Light = Annotated[", cosine + "\n\n\n" + sector + "\n\n", 0)
    change(
        tree,
        models,
        ("    PointLight | DirectionalLight", "    CosineLight | SectorLight | PointLight | DirectionalLight"),
    )
    change(tree, models, ('"sine", "profile"]', '"sine", "profile", "cosine"]'))
    change(tree, tables, ("SINE, PROFILED = range(5)", "SINE, PROFILED, COSINE = range(6)"))
    change(tree, tables, ('"profile": PROFILED}', '"profile": PROFILED, "cosine": COSINE}'))
    put(tree, tables, "    ]\n)\n", '("exponent", "f8"),\n("sector", "f8"),', 8)
    put(tree, tables, '    elif light.emission == "lambert":', law, 4)
    put(tree, kernels, "    return light.power * _profile_at", intensity, 4)
    put(tree, kernels, PROFILE_CELLS, drawn, 4)
    change(tree, kernels, ("import CONE, EVEN", "import CONE, COSINE, EVEN"))
    change(tree, "scene/light/region.py", ('"straight", "round"]', '"straight", "round", "sector"]'))
    put(tree, "scene/light/region.py", "\n    @property\n    def is_round", "angle_deg: float = 360.0", 4)
    put(tree, "scene/light/region.py", "        return float(one * other)", area, 8)
    change(tree, tables, ("STRAIGHT, ROUND = range(2)", "STRAIGHT, ROUND, SECTOR = range(3)"))
    change(tree, tables, ('"round": ROUND}', '"round": ROUND, "sector": SECTOR}'))
    put(tree, tables, "\n\ndef _set_emission", angle, 4)
    put(tree, "transport/lights/places.py", "    if light.shape == ROUND:\n        r, phi", places, 4)
    put(tree, "transport/lights/places.py", "    return px * px + py * py + pz * pz <=", holds, 4)
    change(tree, "transport/lights/places.py", ("import ROUND, STRAIGHT", "import ROUND, SECTOR, STRAIGHT"))


PROFILE_CELLS = """    row = profiles.rows[light.profile]
    vertical = profiles.angles[row[0] : row[0] + row[1]]
    horizontal = profiles.angles[row[2] : row[2] + row[3]]
    until"""


def add_phase(tree: Path) -> None:
    model, case = blocks_of("A medium")
    file, tables = "scene/media/phase.py", "transport/tables/phases.py"
    put(tree, file, "Phase = Annotated[\n", model + "\n\n", 0)
    change(tree, file, ("MiePhase | TabulatedPhase,", "MiePhase | TabulatedPhase | LinearPhase,"))
    put(tree, tables, "        case IsotropicPhase():", case, 8)
    change(tree, tables, ("rayleigh, read_phase", "rayleigh, read_phase, tabulated"))
    change(tree, tables, ("    IsotropicPhase,\n", "    IsotropicPhase,\n    LinearPhase,\n"))


def add_detector(tree: Path) -> None:
    field, check, effect, option = blocks_of("A sensor")
    detector, command = "lightfield/detector.py", "cli/lightfield.py"
    put(tree, detector, "\n    def __post_init__", field, 4)
    put(tree, detector, '        _refuse("bits"', check, 8)
    put(tree, detector, "        lit = np.minimum(", effect, 8)
    put(tree, command, "    full_well_e: Annotated[", option + ",", 4)
    put(tree, command, "        full_well_e=full_well_e,", "prnu=prnu,", 8)


def add_command(tree: Path) -> None:
    file, example = blocks_of("A command")
    (tree / "lfmesh" / "cli" / "lamps.py").write_text(file + "\n")
    change(tree, "cli/__init__.py", ("            frames,\n", "            frames,\n            lamps,\n"))
    put(tree, "cli/tasks.py", '        "schema": ', example, 8)


def test_every_file_that_a_recipe_names_is_there() -> None:
    named = set(re.findall(r"`([\w/]+\.(?:py|md|toml))`", RECIPES))
    lone = {"test_generator.py", "examine.py"}
    assert lone <= named
    beside = [PACKAGE, PACKAGE.parent]
    assert [name for name in named - lone if not any((folder / name).is_file() for folder in beside)] == []


QUICK = """
import json
from types import SimpleNamespace

import numpy as np

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.geometry.surfaces.bends import height_range, set_bends
from lfmesh.geometry.surfaces.surface import form_at, surface_of
from lfmesh.scene.light.lights import SectorLight
from lfmesh.transport.lights.places import _holds, point_of_light
from lfmesh.transport.tables.lights import LIGHT, _set_region

found = {}

# A shape: the height and the second derivative in all directions are within their bounds, which are as close as can be.
twist, rim = -0.03, 4.0
saddle = surface_of(lf.Surface(saddle={"twist_per_mm": twist}, index=1.5, semi_diameter_mm=rim), semi_diameter=rim)
set_bends(saddle, rim)
height, _, _ = form_at(saddle, rim * 0.5**0.5, rim * 0.5**0.5)
found["bends"] = [float(saddle["least_bend"]), float(saddle["most_bend"])]
found["heights"] = [height_range(saddle, rim), float(height)]

# A lamp with a size: its points fill it evenly, and it holds them.
dice = np.random.default_rng(7)
given = {"position_mm": [1.0, 2.0, 3.0], "direction": [0.0, 0.6, -0.8], "radius_mm": 2.0, "power_w": 1.0}
for angle in (90.0, 300.0, 360.0):
    sector = SectorLight(**given, angle_deg=angle, turn_deg=20.0)
    axes, row = sector.axes, np.zeros(1, LIGHT)
    row["direction"] = axes[2]
    _set_region(row[0], sector.region, np.eye(3, 4))
    drawn = [point_of_light(row[0], *dice.random(2)) for _ in range(400)]
    rest = np.array(drawn) - given["position_mm"]
    around = [axes[:2].T @ dice.uniform(-2.0, 2.0, 2) for _ in range(4000)]
    found[f"sector {angle:g}"] = {
        "held": all(_holds(row[0], *(point * (1.0 - 1e-12))) for point in rest),
        "off plane": float(np.abs(rest @ axes[2]).max()),
        "middle": (rest @ axes[:2].T).mean(axis=0).tolist(),
        "area": [16.0 * np.mean([_holds(row[0], *point) for point in around]), float(row["area"][0])],
    }

# A detector: the pattern stays from exposure to exposure, and has the spread that is given.
camera = {"lens": {"surfaces": [{"radius_mm": 50.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 5.0},
                                {"radius_mm": -50.0, "semi_diameter_mm": 5.0, "stop": True}]},
          "focus_mm": 500.0, "sensor": {"pixels": [64, 64], "pixel_mm": 0.01}}
image = SimpleNamespace(scene=lf.Scene(camera=camera), mean=np.full((64, 64, 1), 1e-9), wavelengths_nm=(550.0,))
shots = [lf.Detector(prnu=0.05, seed=seed).expose(image).expected_e for seed in (1, 2)]
found["pattern"] = [bool((shots[0] == shots[1]).all()), float(shots[0].std() / shots[0].mean())]
found["no pattern"] = float(np.ptp(lf.Detector().expose(image).expected_e))
try:
    lf.Detector(prnu=1.5)
except lf.LfmeshError as error:
    found["no such pattern"] = str(error)

# A command.
head = ["[camera]", "focus_mm = 500.0", "[camera.sensor]", "pixels = [4, 4]", "pixel_mm = 0.01", "[camera.lens]",
        "surfaces = [{ radius_mm = 50.0, thickness_mm = 3.0, index = 1.5, semi_diameter_mm = 5.0 },",
        "            { radius_mm = -50.0, semi_diameter_mm = 5.0, stop = true }]"]
lamps = ["[[lights]]", 'kind = "point"', "position_mm = [1.0, 2.0, -300.0]", "power_w = 1.0",
         "[[lights]]", 'kind = "directional"', "direction = [0.0, 0.0, 1.0]", "irradiance_w_m2 = 5.0"]
for name, lines in (("lit.toml", head + lamps), ("dark.toml", head)):
    with open(name, "w") as file:
        file.write("schema_version = 1\\n" + "\\n".join(lines))
    found[name] = main(["lamps", name])
found["help"] = main(["lamps", "--help"])
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], str]:
    """Return what a copy of the package shows with few kernels, and the lines that it printed before."""
    tree = tmp_path_factory.mktemp("copy")
    shutil.copytree(PACKAGE, tree / "lfmesh", ignore=shutil.ignore_patterns("*.nb?"))
    for add in (add_shape, add_light, add_detector, add_command):
        add(tree)
    printed, _, last = run_in(tree, QUICK).strip().rpartition("\n")
    return json.loads(last), printed


def test_bounds_of_a_saddle_are_its_own(quick: tuple[dict[str, Any], str]) -> None:
    """Second derivatives lie between −c and c, the height within c r² / 2, in either case as close as can be."""
    found, _ = quick
    assert found["bends"] == [-0.03, 0.03]
    (least, most), height = found["heights"]
    assert (least, most) == (pytest.approx(-0.24), pytest.approx(0.24))
    assert height == pytest.approx(least)


@pytest.mark.parametrize("angle", [90, 300, 360])
def test_points_of_a_sector_lamp_fill_it_evenly(angle: int, quick: tuple[dict[str, Any], str]) -> None:
    """It holds them, they lie about its centroid, and its area is that of the points that it holds, to 4 errors."""
    found = quick[0][f"sector {angle}"]
    assert found["held"]
    assert found["off plane"] < 1e-14
    counted, area = found["area"]
    share = math.radians(angle) / 2.0 * 4.0 / 16.0
    assert area == pytest.approx(16.0 * share)
    assert abs(counted - area) < 4.0 * 16.0 * (share * (1.0 - share) / 4000) ** 0.5
    half = math.radians(angle) / 2.0
    error = 2.0 / 400**0.5  # at most, as no point is farther than 2 mm from the centre
    assert abs(found["middle"][0] - 2.0 * 2.0 * math.sin(half) / (3.0 * half)) < 4.0 * error
    assert abs(found["middle"][1]) < 4.0 * error


def test_a_pattern_of_pixels_is_added_as_its_recipe_says(quick: tuple[dict[str, Any], str]) -> None:
    """It is the same in each exposure, of the spread that is given, to 4 errors; without it pixels are alike."""
    found, _ = quick
    same, spread = found["pattern"]
    assert same
    assert abs(spread - 0.05) < 4.0 * 0.05 / (2.0 * 64 * 64) ** 0.5
    assert found["no pattern"] == 0.0
    assert found["no such pattern"] == "prnu = 1.5: must be 0 or more and below 1"


def test_a_command_is_added_as_its_recipe_says(quick: tuple[dict[str, Any], str]) -> None:
    """It prints a line for each lamp, refuses a scene without any, and has its example in its help."""
    found, printed = quick
    assert (found["lit.toml"], found["dark.toml"], found["help"]) == (0, 2, 0)
    assert printed.splitlines()[:2] == [
        "lights[0]: point, position_mm = [1.0, 2.0, -300.0]", "lights[1]: directional, parallel light"
    ]  # fmt: skip
    assert "Example: lfmesh lamps scene.toml" in printed


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a copy of the package shows with all recipes followed; one copy, as its kernels compile anew."""
    tree = tmp_path_factory.mktemp("copy")
    shutil.copytree(PACKAGE, tree / "lfmesh")
    for add in (add_coating, add_finish, add_shape, add_light, add_phase):
        add(tree)
    return dict(json.loads(run_in(tree, SCRIPT)))


def agree(one: list[float], other: list[float]) -> bool:
    """Tell whether two means of 32 replicates agree to 4 standard errors, and are known to 5 %."""
    assert max(one[1] / one[0], other[1] / other[0]) < 0.05
    return abs(one[0] - other[0]) < 4.0 * (one[1] ** 2 + other[1] ** 2) ** 0.5


@pytest.mark.long  # the copy's kernels compile anew
def test_a_neutral_density_coating_is_added_as_its_recipe_says(found: dict[str, Any]) -> None:
    """A share of the bare face's light passes, at a slant too; the rest is absorbed."""
    for engine in ("mesh", "sequential"):
        passed, _ = found[f"coating bare {engine}"]
        assert 0.9 < passed < 0.96**2
        assert found[f"coating grey {engine}"][0] == pytest.approx(0.25 * passed, abs=1e-7)
        assert 0.75 * passed < found[f"coating grey {engine}"][1] < 0.75 * 0.96
        assert found[f"coating clear {engine}"] == [pytest.approx(passed, abs=1e-7), 0.0]
    (line,) = found["coating shown"]
    assert "grey: reflects 4 % at 0, " in line
    assert "passes 24 % at 0, " in line
    assert found["coating written"] == ["coatings of surfaces 0 are not in the file"]
    assert "coatings.grey.transmittance" in found["coating refused both"]
    assert found["coating refused none"].endswith(
        "a coating needs one of reflectance, table, measured, layers and transmittance"
    )


@pytest.mark.long
def test_a_satin_finish_is_added_as_its_recipe_says(found: dict[str, Any]) -> None:
    """Nothing is lost in a furnace, which needs reciprocity too; what is drawn has the density that lamps are given."""
    furnace, empty = found["furnace"], found["empty"]
    assert furnace[0] / empty[0] == pytest.approx(furnace[2] / empty[2], rel=1e-9)
    assert 0.95 < furnace[2] / empty[2] < 1.0 + 1e-9
    for lobe in ("0.5", "0.0"):
        assert agree(found[f"finish {lobe} adjoint"], found[f"finish {lobe} forward"])
    assert agree(found["finish 0.0 adjoint"], found["finish diffuse adjoint"])
    assert not agree(found["finish 0.5 adjoint"], found["finish diffuse adjoint"])


@pytest.mark.long
def test_a_saddle_is_added_as_its_recipe_says(found: dict[str, Any]) -> None:
    """Both engines refract by Snell's law at z = c x y, and its low quarters count where neighbours are judged."""
    assert found["shape mesh"] < 1e-12
    assert found["shape sequential"] < 1e-12
    assert found["shape passed by"] == 0
    assert "surfaces 0 and 1 cross inside their clear aperture" in found["shape refused"]
    assert "saddle: `hard.truth` has no such surface" in found["truth refused"]
    assert any("surface 1 is a saddle, not symmetric about x and y" in text for text in found["shape warned"])
    assert (found["only stops saddle"], found["only stops flat"]) == (False, True)
    assert found["shape described"] == "surface 0, saddle of twist_per_mm = 0.01, in y flat, semi-diameter 8 mm"
    assert "radius_mm = 30.0: omit it: it does not go with a saddle" in found["radius refused"]
    for file, program in (("lens.seq", "CODE V"), ("lens.zmx", "Zemax")):
        assert found[file].endswith(f"surfaces[0].saddle: not written to {program} files")


@pytest.mark.long
def test_a_cosine_lamp_is_added_as_its_recipe_says(found: dict[str, Any]) -> None:
    """Its intensity is P (m + 1) cosᵐ θ / 2π, here at cos θ = 0.8, and forward equals adjoint."""
    point = found["light point"][0]
    assert found["light 0"][0] / point == pytest.approx(2.0, rel=1e-12)
    assert found["light 3"][0] / point == pytest.approx(8.0 * 0.8**3, rel=2e-3)
    for name in ("wide", "narrow"):
        assert agree(found[f"light {name} adjoint"], found[f"light {name} forward"])


@pytest.mark.long
def test_a_sector_lamp_is_added_as_its_recipe_says(found: dict[str, Any]) -> None:
    """Two halves are a disk, and give unequal light; forward equals adjoint in air and in fog."""
    (one, error), (other, of_other) = found["sized half"][:2], found["sized other half"][:2]
    assert agree([one + other, (error**2 + of_other**2) ** 0.5], found["sized whole"])
    assert not agree(found["sized half"], found["sized other half"])
    for name in ("air", "fog"):
        assert agree(found[f"sized {name} adjoint"], found[f"sized {name} forward"])


@pytest.mark.long
def test_a_linear_phase_function_is_added_as_its_recipe_says(found: dict[str, Any]) -> None:
    """A thin ball of fog shows (1 + a cos θ) times the light of an isotropic one, here at cos θ = 0.8."""
    assert found["mean cosine"] == pytest.approx(0.3, rel=1e-12)
    assert found["phase linear"][0] / found["phase isotropic"][0] == pytest.approx(1.0 + 0.9 * 0.8, rel=5e-3)
