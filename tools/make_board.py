"""Make the circuit board of assets/scenes/circuit_board.toml: assets/meshes/board.glb, of about a hundred parts.

Every part is a node of its own, as a CAD program exports an assembly; parts of one kind share their mesh and material.
The board stands where the camera sees it, tilted, so that its parts lie at many depths. Its picture holds traces, pads
and outlines. The file is deterministic: run it again and it does not change. Needs the `dev` extra.
"""

import math
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from trimesh.visual.material import PBRMaterial

Array = NDArray[np.float64]

FILE = Path(__file__).resolve().parent.parent / "assets" / "meshes" / "board.glb"

BOARD_MM = (58.0, 46.0, 1.6)
CENTRE_MM = (0.0, 0.0, -500.0)
TILT_DEG = -38.0
"""About x: the upper edge leans away from the camera."""

TABLE_MM, TABLE_Z_MM = (150.0, 120.0), -522.0
"""Size of the table behind the board, and its place: square to the camera's axis, it receives the board's shadow."""

PX_PER_MM = 10
MASK, TRACE, SILK, GOLD = (10, 74, 40), (18, 112, 60), (226, 230, 222), (214, 168, 72)
"""sRGB colours of the board's picture: solder mask, traces under it, print, pads."""

MATERIALS = {
    "plastic": ((0.022, 0.022, 0.025), 0.0, 0.45),
    "laminate": ((0.30, 0.27, 0.13), 0.0, 0.6),
    "tin": ((0.80, 0.79, 0.77), 1.0, 0.55),
    "gold": ((1.0, 0.76, 0.33), 1.0, 0.4),
    "copper": ((0.95, 0.45, 0.27), 1.0, 0.45),
    "aluminium": ((0.88, 0.89, 0.90), 1.0, 0.5),
    "ceramic": ((0.48, 0.31, 0.17), 0.0, 0.5),
    "black anodised": ((0.03, 0.03, 0.035), 0.0, 0.5),
    "blue": ((0.03, 0.09, 0.33), 0.0, 0.4),
    "red": ((0.50, 0.03, 0.02), 0.0, 0.3),
    "table": ((0.22, 0.24, 0.28), 0.0, 0.8),
}
"""Base colour (linear), metallic, roughness."""


def box(x: float, y: float, z: float, up: float = 0.0) -> trimesh.Trimesh:
    """Return a box that stands at a height, mm."""
    mesh = trimesh.creation.box((x, y, z))
    mesh.apply_translation((0.0, 0.0, up + 0.5 * z))
    return mesh


def tapered(x: float, y: float, z: float, bevel: float, up: float) -> trimesh.Trimesh:
    """Return a moulded body: a box with bevelled upper edges."""
    low, high = box(x, y, z - bevel, up), box(x - 2.0 * bevel, y - 2.0 * bevel, z, up)
    return trimesh.util.concatenate([low, high]).convex_hull


def lead(length: float, width: float, thick: float, top: float) -> trimesh.Trimesh:
    """Return a gull-wing lead that leaves a body along +x at a height and stands on the board."""
    foot, knee = box(0.45 * length, width, thick), box(thick, width, top)
    foot.apply_translation((0.775 * length, 0.0, 0.0))
    knee.apply_translation((0.55 * length, 0.0, 0.0))
    arm = box(0.6 * length, width, thick, top - thick)
    arm.apply_translation((0.3 * length, 0.0, 0.0))
    return trimesh.util.concatenate([foot, knee, arm])


def comb(count: int, pitch: float, aside: float, one: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a row of equal leads along y, at a distance from the middle of their body."""
    rows = [one.copy() for _ in range(count)]
    for k, each in enumerate(rows):
        each.apply_translation((aside, (k - 0.5 * (count - 1)) * pitch, 0.0))
    return trimesh.util.concatenate(rows)


def turned(profile: list[tuple[float, float]], sections: int) -> trimesh.Trimesh:
    """Return a body of revolution about z from its (radius, height), bottom to top."""
    return trimesh.creation.revolve(np.array(profile), sections=sections)


def can(radius: float, height: float) -> trimesh.Trimesh:
    """Return an electrolytic capacitor's can with a groove and a rounded rim."""
    rim = [
        (radius + 0.35 * (math.cos(a) - 1.0), height + 0.35 * (math.sin(a) - 1.0)) for a in np.linspace(0, np.pi / 2, 5)
    ]
    groove = [(radius, 0.9), (0.93 * radius, 1.15), (0.93 * radius, 1.35), (radius, 1.6)]
    return turned([(0.0, 0.6), (radius, 0.6), *groove, *rim, (0.0, height)], 32)


def coil(ring: float, tube: float, turns: int) -> trimesh.Trimesh:
    """Return a wound toroid: a torus with a tube that swells at each turn of its wire."""
    around, across = 6 * turns, 12
    u, v = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.arange(across) * 2 * np.pi / across, indexing="ij")
    swell = tube * (1.0 + 0.16 * np.abs(np.cos(0.5 * turns * u)))
    points = np.stack(
        [(ring + swell * np.cos(v)) * np.cos(u), (ring + swell * np.cos(v)) * np.sin(u), tube + swell * np.sin(v)],
        axis=-1,
    )
    number = np.arange(around * across).reshape(around, across)
    right, up = np.roll(number, -1, axis=0), np.roll(number, -1, axis=1)
    both = np.roll(right, -1, axis=1)
    faces = np.concatenate(
        [np.stack(each, axis=-1).reshape(-1, 3) for each in ((number, right, both), (number, both, up))]
    )
    return trimesh.Trimesh(points.reshape(-1, 3), faces, process=False)


def screw() -> trimesh.Trimesh:
    """Return a screw's head on its washer, with a slot."""
    head = trimesh.creation.cylinder(1.9, 1.2, sections=32)
    slot = trimesh.creation.box((4.0, 0.5, 0.6))
    slot.apply_translation((0.0, 0.0, 0.5))
    washer = trimesh.creation.cylinder(2.7, 0.4, sections=32)
    cut = trimesh.boolean.difference([head, slot], engine="manifold")
    cut.apply_translation((0.0, 0.0, 1.0))
    washer.apply_translation((0.0, 0.0, 0.2))
    return trimesh.util.concatenate([washer, cut])


def heat_sink() -> trimesh.Trimesh:
    """Return a base with fins."""
    fins = [box(0.55, 8.4, 4.6, 1.0) for _ in range(7)]
    for k, fin in enumerate(fins):
        fin.apply_translation(((k - 3) * 1.28, 0.0, 0.0))
    return trimesh.boolean.union([box(8.4, 8.4, 1.4, 0.0), *fins], engine="manifold")


def socket() -> trimesh.Trimesh:
    """Return the shell of a connector, open towards -x."""
    shell, hole = box(9.0, 9.0, 3.4), box(9.0, 8.0, 2.4, 0.5)
    hole.apply_translation((-0.6, 0.0, 0.0))
    return trimesh.boolean.difference([shell, hole], engine="manifold")


def kinds() -> dict[str, tuple[trimesh.Trimesh, str]]:
    """Return meshes and materials of all kinds of parts; each stands on the board at z = 0, mm."""
    pin = box(0.5, 0.5, 7.0, -0.2)
    ends = [box(0.4, 1.25, 0.55), box(0.4, 1.25, 0.55)]
    for end, x in zip(ends, (-0.85, 0.85), strict=True):
        end.apply_translation((x, 0.0, 0.0))
    return {
        "processor": (tapered(12.0, 12.0, 1.6, 0.35, 0.25), "plastic"),
        "processor leads": (comb(14, 0.78, 5.9, lead(1.7, 0.36, 0.16, 0.95)), "tin"),
        "driver": (tapered(4.0, 5.2, 1.5, 0.3, 0.2), "plastic"),
        "driver leads": (comb(4, 1.27, 1.9, lead(1.3, 0.42, 0.18, 0.85)), "tin"),
        "resistor": (box(1.4, 1.2, 0.5), "plastic"),
        "ceramic capacitor": (box(1.4, 1.2, 1.0), "ceramic"),
        "terminals": (trimesh.util.concatenate(ends), "tin"),
        "can": (can(2.6, 6.2), "aluminium"),
        "can foot": (tapered(5.6, 5.6, 0.7, 0.1, 0.0), "plastic"),
        "coil": (coil(3.1, 1.35, 16), "copper"),
        "header": (box(2.5, 20.4, 2.4), "plastic"),
        "pin": (pin, "gold"),
        "crystal": (tapered(4.6, 10.6, 3.2, 0.5, 0.1), "tin"),
        "socket": (socket(), "tin"),
        "heat sink": (heat_sink(), "black anodised"),
        "screw": (screw(), "gold"),
        "tantalum": (tapered(3.4, 6.4, 2.6, 0.25, 0.1), "ceramic"),
        "film capacitor": (tapered(3.2, 7.4, 5.4, 0.3, 0.1), "blue"),
        "fuse": (tapered(2.8, 5.4, 2.2, 0.3, 0.1), "red"),
    }


def layout() -> list[tuple[str, str, float, float, float]]:
    """Return all parts: name, kind, place on the board in mm, and turn in degrees."""
    parts = [("processor", "processor", -3.0, 1.0, 0.0)]
    parts += [(f"processor leads {k + 1}", "processor leads", -3.0, 1.0, 90.0 * k) for k in range(4)]
    for k, (x, y) in enumerate([(12.5, 13.2), (12.5, 5.6), (-19.0, -1.0)]):
        parts.append((f"driver {k + 1}", "driver", x, y, 0.0))
        parts += [(f"driver {k + 1} leads {j + 1}", "driver leads", x, y, 180.0 * j) for j in range(2)]
    small = [(-11.0 + 3.2 * k, 11.6, 90.0) for k in range(6)] + [(-11.0 + 3.2 * k, -9.4, 90.0) for k in range(6)]
    small += [(7.2, 7.0 - 3.0 * k, 0.0) for k in range(5)] + [(-12.4, 6.5 - 3.0 * k, 0.0) for k in range(4)]
    for k, (x, y, turn) in enumerate(small):
        what = "resistor" if k % 2 else "ceramic capacitor"
        parts += [(f"{what} {k + 1}", what, x, y, turn), (f"terminals {k + 1}", "terminals", x, y, turn)]
    for k, (x, y) in enumerate([(-21.0, 11.0), (-14.5, 15.8), (21.0, -4.0)]):
        parts += [(f"can {k + 1}", "can", x, y, 0.0), (f"can foot {k + 1}", "can foot", x, y, 0.0)]
    parts += [(f"coil {k + 1}", "coil", x, y, 0.0) for k, (x, y) in enumerate([(14.0, -5.0), (-20.5, -11.0)])]
    parts.append(("header", "header", 1.0, -17.6, 90.0))
    parts += [(f"pin {k + 1}", "pin", 1.0 + 2.0 * (k % 10) - 9.0, -18.2 + 1.2 * (k // 10), 0.0) for k in range(20)]
    parts += [("crystal", "crystal", -2.5, 17.0, 90.0), ("socket", "socket", -24.0, 3.8, 0.0)]
    parts += [("heat sink", "heat sink", 20.5, 10.0, 0.0), ("tantalum", "tantalum", 9.0, -12.6, 90.0)]
    parts += [("film capacitor", "film capacitor", 19.0, -13.8, 90.0), ("fuse", "fuse", 6.8, 18.6, 90.0)]
    corners = [(x, y) for y in (-19.6, 19.6) for x in (-25.6, 25.6)]
    return parts + [(f"screw {k + 1}", "screw", x, y, 25.0 + 40.0 * k) for k, (x, y) in enumerate(corners)]


def picture() -> Image.Image:
    """Return the picture of the board: x to the right, y up."""
    draw_from = np.random.default_rng(60)
    size = [round(side * PX_PER_MM) for side in BOARD_MM[:2]]
    image = Image.new("RGB", size, MASK)
    draw = ImageDraw.Draw(image)

    def at(x: float, y: float) -> tuple[float, float]:
        return (x + 0.5 * BOARD_MM[0]) * PX_PER_MM, (0.5 * BOARD_MM[1] - y) * PX_PER_MM

    def rectangle(x: float, y: float, wide: float, high: float, **how: object) -> None:
        draw.rectangle([at(x - 0.5 * wide, y + 0.5 * high), at(x + 0.5 * wide, y - 0.5 * high)], **how)

    for _ in range(70):
        x, y = draw_from.uniform(-27.0, 27.0), draw_from.uniform(-21.0, 21.0)
        way = draw_from.integers(0, 4) * np.pi / 2
        points = [(x, y)]
        for turn, length in zip((0.0, 0.25 * np.pi, 0.0), draw_from.uniform(2.0, 9.0, 3), strict=True):
            x, y = x + length * math.cos(way + turn), y + length * math.sin(way + turn)
            points.append((x, y))
        for k in range(draw_from.integers(1, 4)):
            draw.line([at(px + 0.6 * k * math.sin(way), py + 0.6 * k * math.cos(way)) for px, py in points], TRACE, 3)
        draw.ellipse([at(x - 0.45, y + 0.45), at(x + 0.45, y - 0.45)], GOLD)
        draw.ellipse([at(x - 0.2, y + 0.2), at(x + 0.2, y - 0.2)], MASK)
    for _, kind, x, y, turn in layout():
        wide, high = OUTLINES.get(kind, (0.0, 0.0))
        if wide and turn % 180.0:
            wide, high = high, wide
        if wide:
            rectangle(x, y, wide, high, outline=SILK, width=2)
        if kind == "screw":
            draw.ellipse([at(x - 3.1, y + 3.1), at(x + 3.1, y - 3.1)], GOLD)
    draw.rectangle([at(-28.4, 22.4), at(28.4, -22.4)], outline=SILK, width=2)
    return image.quantize(16, dither=Image.Dither.NONE).convert("RGB")


OUTLINES = {
    "processor": (16.4, 16.4),
    "driver": (7.8, 6.4),
    "terminals": (3.0, 2.0),
    "can foot": (6.6, 6.6),
    "crystal": (5.6, 11.6),
    "coil": (10.6, 10.6),
    "header": (3.6, 21.6),
    "heat sink": (9.6, 9.6),
    "tantalum": (4.4, 7.4),
    "film capacitor": (4.2, 8.4),
    "fuse": (3.8, 6.4),
}
"""Of the print round parts, mm."""


def board() -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """Return the laminate, and its printed upper face, mm."""
    x, y = 0.5 * BOARD_MM[0], 0.5 * BOARD_MM[1]
    corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
    face = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    look = PBRMaterial(name="print", baseColorTexture=picture(), metallicFactor=0.0, roughnessFactor=0.35)
    face.visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [1, 1], [0, 1]], material=look)
    return box(*BOARD_MM, -BOARD_MM[2] - 0.02), face


def main() -> None:
    stands = trimesh.transformations.rotation_matrix(math.radians(TILT_DEG), (1.0, 0.0, 0.0))
    stands[:3, 3] = CENTRE_MM
    looks = {
        name: PBRMaterial(name=name, baseColorFactor=[*colour, 1.0], metallicFactor=metallic, roughnessFactor=roughness)
        for name, (colour, metallic, roughness) in MATERIALS.items()
    }
    to_metres = np.diag([1e-3, 1e-3, 1e-3, 1.0])
    scene = trimesh.Scene()
    laminate, face = board()
    meshes = {"laminate": (laminate, "laminate"), "print": (face, "")} | kinds()
    for kind, (mesh, look) in meshes.items():
        mesh.apply_transform(to_metres)
        if look:
            mesh.visual = trimesh.visual.TextureVisuals(material=looks[look])
        scene.geometry[kind] = mesh
    parts = [("laminate", "laminate", 0.0, 0.0, 0.0), ("print", "print", 0.0, 0.0, 0.0), *layout()]
    for name, kind, x, y, turn in parts:
        place = trimesh.transformations.rotation_matrix(math.radians(turn), (0.0, 0.0, 1.0))
        place[:2, 3] = x, y
        place = stands @ place
        place[:3, 3] *= 1e-3
        scene.graph.update(frame_to=name, frame_from="world", matrix=place, geometry=kind)
    table = trimesh.Trimesh(
        np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.5e-3 * (*TABLE_MM, 0.0), [[0, 1, 2], [0, 2, 3]]
    )
    table.visual = trimesh.visual.TextureVisuals(material=looks["table"])
    scene.geometry["table"] = table
    away = trimesh.transformations.translation_matrix((0.0, 0.0, 1e-3 * TABLE_Z_MM))
    scene.graph.update(frame_to="table", frame_from="world", matrix=away, geometry="table")
    FILE.write_bytes(scene.export(file_type="glb"))
    facets = sum(len(meshes[kind][0].faces) for _, kind, *_ in parts)
    size = FILE.stat().st_size / 1e3
    print(f"{FILE.name}: {len(parts)} parts of {len(meshes)} kinds on a table, {facets} facets, {size:.0f} kB")


if __name__ == "__main__":
    main()
