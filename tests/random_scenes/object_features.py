"""What may stand before a drawn camera: targets, lamps, glass, media, particles, one function a feature.

Sizes follow from the width of the beam: that of the field at its distance and of the lens's opening together.
"""

from tests.random_scenes.draft import Dice, Draft, Tables, feature, rounded
from tests.random_scenes.transforms import moved

BALL_RADIUS_MM, WINDOW_HALF_MM = 16.0, 55.0
"""Of the meshes in assets."""


def beam_mm(draft: Draft, share: float) -> float:
    """Half width of all that the sensor sees at a share of the distance to the plane in focus, mm."""
    return draft.half_field_mm * share + draft.semi_mm * abs(1.0 - share)


def place(draft: Draft, dice: Dice, near: float = 0.5, far: float = 0.97) -> tuple[list[float], float]:
    """Draw a place within the beam, and return it with the beam's half width there."""
    share = dice.between(near, far)
    half = beam_mm(draft, share)
    return [*dice.vector(0.6 * half, 0.6 * half), rounded(-share * draft.focus_mm)], half


def surface_of(dice: Dice) -> Tables:
    """Draw a matt material, which may shine."""
    shines = dice.between(0.2, 2.0) if dice.chance(0.4) else 0.0
    return {"reflectance": dice.between(0.0, 0.95), "radiance_w_m2_sr": shines}


def turned(dice: Dice) -> list[float]:
    return dice.vector(180.0, 180.0, 180.0)


def backdrop(draft: Draft) -> Tables:
    """Return the first target: a plane through the focus that is wider than the field."""
    return draft.tables["targets"][0]


def add_target(draft: Draft, dice: Dice, shape: Tables, where: list[float]) -> None:
    draft.add("targets", {"shape": shape, "position_mm": where, "rotation_deg": turned(dice),
                          "material": surface_of(dice)})  # fmt: skip


# Targets


@feature(cameras=0.2, scenes=0.2)
def edge_in_the_field(draft: Draft, dice: Dice) -> bool | None:
    """A sheet before the plane in focus, with its edge in the field."""
    (x, y, z), half = place(draft, dice, 0.9, 0.98)
    size = 4.0 * half
    shape = {"kind": "plane", "width_mm": rounded(size), "height_mm": rounded(size)}
    draft.add("targets", {"shape": shape, "position_mm": [rounded(x + 0.5 * size), y, z], "material": surface_of(dice)})
    return None


@feature(cameras=0.05, scenes=0.25)
def sphere(draft: Draft, dice: Dice) -> bool | None:
    where, half = place(draft, dice)
    add_target(draft, dice, {"kind": "sphere", "radius_mm": rounded(half * dice.between(0.1, 0.5))}, where)
    return None


@feature(scenes=0.2)
def box(draft: Draft, dice: Dice) -> bool | None:
    where, half = place(draft, dice)
    add_target(draft, dice, {"kind": "box", "size_mm": [rounded(half * dice.between(0.1, 0.8)) for _ in "xyz"]}, where)
    return None


@feature(scenes=0.15)
def disk_and_cylinder(draft: Draft, dice: Dice) -> bool | None:
    for kind in ("disk", "cylinder"):
        where, half = place(draft, dice)
        shape = {"kind": kind, "radius_mm": rounded(half * dice.between(0.1, 0.5))}
        if kind == "cylinder":
            shape["height_mm"] = rounded(half * dice.between(0.1, 1.0))
        add_target(draft, dice, shape, where)
    return None


@feature(scenes=0.2)
def glowing_wall(draft: Draft, dice: Dice) -> bool | None:
    """A sheet beside the field, square to the plane in focus, which it lights."""
    half = 1.3 * beam_mm(draft, 0.9)
    side = 2.0 * half
    shape = {"kind": "plane", "width_mm": rounded(side), "height_mm": rounded(side)}
    draft.add("targets", {
        "shape": shape, "position_mm": [rounded(half), 0.0, rounded(-draft.focus_mm + 0.55 * side)],
        "rotation_deg": [0.0, 90.0, 0.0],
        "material": {"reflectance": dice.between(0.0, 0.9), "radiance_w_m2_sr": dice.between(0.5, 3.0)},
    })  # fmt: skip
    return None


@feature(scenes=0.12)
def texture(draft: Draft, dice: Dice) -> bool | None:
    material = backdrop(draft)["material"]
    material["texture"] = dice.one_of("charts/chart.png", "charts/siemens.png")
    return None


@feature(scenes=0.15)
def gloss(draft: Draft, dice: Dice) -> bool | None:
    target = dice.one_of(*draft.tables["targets"])
    target["material"]["gloss"] = {"index": dice.between(1.2, 2.0), "roughness": dice.between(0.05, 0.8)}
    return None


@feature(scenes=0.1)
def metal(draft: Draft, dice: Dice) -> bool | None:
    target = dice.one_of(*draft.tables["targets"])
    target["material"]["gloss"] = {"metal": dice.one_of("Al", "Cu", "Ag"), "roughness": dice.between(0.05, 0.8)}
    return None


@feature(scenes=0.1)
def half_opaque(draft: Draft, dice: Dice) -> bool | None:
    dice.one_of(*draft.tables["targets"])["material"]["opacity"] = dice.between(0.2, 0.9)
    return None


@feature(scenes=0.08)
def black_behind(draft: Draft, dice: Dice) -> bool | None:
    sheets = [t for t in draft.tables["targets"] if t["shape"]["kind"] in ("plane", "disk")]
    dice.one_of(*sheets)["material"]["sides"] = "front"
    return None


@feature(scenes=0.15)
def bands(draft: Draft, dice: Dice) -> bool | None:
    draft.transport.pop("wavelengths_nm", None)
    own = [{"name": "b", "center_nm": dice.between(450.0, 650.0), "fwhm_nm": dice.between(5.0, 60.0)}]
    draft.camera["sensor"]["bands"] = dice.one_of("rgb", "xyz", own)
    return None


@feature(scenes=0.1)
def temperature(draft: Draft, dice: Dice) -> bool | None:
    if "bands" not in draft.camera["sensor"]:
        return False
    for target in draft.tables["targets"]:
        material = target["material"]
        if "texture" not in material and material.pop("radiance_w_m2_sr"):
            material["temperature_k"] = dice.between(1500.0, 3000.0)
    return None


# Lamps


def lamp_place(draft: Draft, dice: Dice) -> tuple[list[float], list[float]]:
    """Draw a place beside the beam, and the direction from there to a point of the field."""
    share = dice.between(0.3, 0.9)
    half = beam_mm(draft, share) + 0.2 * (1.0 - share) * draft.focus_mm
    where = [dice.both_signs(1.3, 2.5) * half, dice.both_signs(0.0, 1.5) * half, -share * draft.focus_mm]
    to = [*dice.vector(0.5 * draft.half_field_mm, 0.5 * draft.half_field_mm), -draft.focus_mm]
    return [rounded(w) for w in where], [rounded(t - w) for t, w in zip(to, where, strict=True)]


def power_w(draft: Draft, dice: Dice) -> float:
    """Power of a lamp that is about as bright as targets that shine with 1 W/(m² sr)."""
    return rounded(dice.between(0.5, 4.0) * 4e-5 * (draft.half_field_mm + 0.2 * draft.focus_mm) ** 2)


@feature(cameras=0.06, scenes=0.35)
def point_lamp(draft: Draft, dice: Dice) -> bool | None:
    where, _ = lamp_place(draft, dice)
    draft.add("lights", {"kind": "point", "position_mm": where, "power_w": power_w(draft, dice)})
    return None


@feature(scenes=0.2)
def directional_lamp(draft: Draft, dice: Dice) -> bool | None:
    direction = [*dice.vector(1.0, 1.0), -1.0]
    draft.add("lights", {"kind": "directional", "direction": direction, "irradiance_w_m2": dice.between(0.5, 5.0)})
    return None


@feature(scenes=0.2)
def disk_lamp(draft: Draft, dice: Dice) -> bool | None:
    where, direction = lamp_place(draft, dice)
    radius = rounded(draft.half_field_mm * dice.between(0.02, 0.4))
    draft.add("lights", {"kind": "disk", "position_mm": where, "direction": direction, "radius_mm": radius,
                         "power_w": power_w(draft, dice)})  # fmt: skip
    return None


@feature(scenes=0.15)
def spot_lamp(draft: Draft, dice: Dice) -> bool | None:
    where, direction = lamp_place(draft, dice)
    draft.add("lights", {"kind": "spot", "position_mm": where, "direction": direction,
                         "half_angle_deg": dice.between(5.0, 60.0), "edge_deg": dice.between(0.0, 4.0),
                         "power_w": power_w(draft, dice)})  # fmt: skip
    return None


@feature(scenes=0.12)
def line_lamp(draft: Draft, dice: Dice) -> bool | None:
    where, _ = lamp_place(draft, dice)
    half = draft.half_field_mm * dice.between(0.05, 0.4)
    way = dice.vector(half, half, 0.3 * half)
    ends = [[rounded(w + sign * d) for w, d in zip(where, way, strict=True)] for sign in (-1.0, 1.0)]
    draft.add("lights", {"kind": "line", "start_mm": ends[0], "end_mm": ends[1], "power_w": power_w(draft, dice)})
    return None


@feature(scenes=0.12)
def panel_lamp(draft: Draft, dice: Dice) -> bool | None:
    where, direction = lamp_place(draft, dice)
    width, height = (rounded(draft.half_field_mm * dice.log_between(0.02, 0.4)) for _ in range(2))
    draft.add("lights", {"kind": "rectangle", "position_mm": where, "direction": direction, "width_mm": width,
                         "height_mm": height, "turn_deg": dice.between(-180.0, 180.0),
                         "power_w": power_w(draft, dice)})  # fmt: skip
    return None


@feature(scenes=0.12)
def many_lamps(draft: Draft, dice: Dice) -> bool | None:
    """So many small lamps of every kind that points choose among them, their powers over two decades."""
    count = int(dice.draw.integers(12, 60))
    for kind in dice.draw.choice(["point", "spot", "disk", "rectangle"], count).tolist():
        where, direction = lamp_place(draft, dice)
        size = rounded(0.02 * draft.half_field_mm)
        own: dict[str, Tables] = {
            "point": {},
            "spot": {"direction": direction, "half_angle_deg": dice.between(10.0, 60.0)},
            "disk": {"direction": direction, "radius_mm": size},
            "rectangle": {"direction": direction, "width_mm": size, "height_mm": size},
        }
        power = rounded(power_w(draft, dice) * dice.log_between(0.02, 2.0) / count)
        draft.add("lights", {"kind": kind, "position_mm": where, "power_w": power} | own[kind])
    return None


# Glass


def glass_of(draft: Draft, dice: Dice) -> Tables:
    glass: Tables = {"index": dice.between(1.3, 1.8)}
    if dice.chance(0.3):
        glass["absorption_per_mm"] = rounded(dice.between(0.05, 1.0) / draft.half_field_mm)
    return glass


@feature(scenes=0.12)
def glass_block(draft: Draft, dice: Dice) -> bool | None:
    """A box of glass that fills part of the field or all of it, from a plate to a cube."""
    (x, y, z), half = place(draft, dice, 0.3, 0.8)
    width = dice.between(0.5, 4.0) * half
    depth = min(width * dice.log_between(0.02, 1.0), 0.3 * -z)
    body = glass_of(draft, dice) | {"box_mm": [rounded(width), rounded(width * dice.between(0.5, 1.0)), rounded(depth)]}
    draft.add("targets", {"refractor": body, "position_mm": [x, y, z], "rotation_deg": dice.vector(20.0, 20.0, 90.0)})
    return None


@feature(scenes=0.08)
def glass_ball(draft: Draft, dice: Dice) -> bool | None:
    """The ball in assets, where it has room between the lens and the plane in focus."""
    share = dice.between(0.4, 0.9)
    if min(share, 1.0 - share) * draft.focus_mm < 2.2 * BALL_RADIUS_MM:
        return False
    half = beam_mm(draft, share)
    where = [*dice.vector(half, half), rounded(-share * draft.focus_mm)]
    body = {"file": "meshes/ball.ply", "units": "mm", "index": dice.between(1.3, 1.8)}
    draft.add("targets", {"refractor": body, "position_mm": where})
    return None


@feature(scenes=0.08)
def round_glass(draft: Draft, dice: Dice) -> bool | None:
    """A ball or rod of glass, met exactly, or one of flat facets."""
    (x, y, z), half = place(draft, dice, 0.4, 0.9)
    size = rounded(min(half * dice.between(0.1, 0.6), -0.2 * z))
    shape = dice.one_of(
        {"kind": "sphere", "radius_mm": size}, {"kind": "cylinder", "radius_mm": size, "height_mm": rounded(1.7 * size)}
    )
    body = glass_of(draft, dice) | {"shape": shape} | ({"surface": "flat"} if dice.chance(0.1) else {})
    draft.add("targets", {"refractor": body, "position_mm": [x, y, z], "rotation_deg": turned(dice)})
    return None


@feature(scenes=0.08)
def tank(draft: Draft, dice: Dice) -> bool | None:
    """A tank of liquid with its front before the plane in focus; what stands there may be in it or be cut by it."""
    half = beam_mm(draft, 0.7)
    depth = 0.3 * draft.focus_mm
    draft.add("tanks", {
        "size_mm": [rounded(half * dice.between(2.0, 4.0)), rounded(half * dice.between(2.0, 4.0)), rounded(depth)],
        "wall_mm": rounded(0.1 * min(depth, half)),
        "wall": {"index": dice.between(1.45, 1.6)}, "liquid": glass_of(draft, dice),
        "position_mm": [0.0, 0.0, rounded(-0.7 * draft.focus_mm)],
    } | ({"open": "front"} if dice.chance(0.3) else {}))  # fmt: skip
    return None


# Media and particles


def phase_of(dice: Dice) -> Tables:
    return dice.one_of(
        {"kind": "isotropic"}, {"kind": "rayleigh"}, {"kind": "henyey_greenstein", "g": dice.between(-0.5, 0.9)}
    )


def medium_of(draft: Draft, dice: Dice, length_mm: float) -> Tables:
    """Draw a medium whose optical depth over a length is moderate."""
    medium: Tables = {"absorption_per_mm": rounded(dice.log_between(0.02, 1.0) / length_mm)}
    if dice.chance(0.7):
        medium["scattering_per_mm"] = rounded(dice.log_between(0.05, 1.0) / length_mm)
        medium["phase"] = phase_of(dice)
    if dice.chance(0.4):
        medium["emission_w_mm3_sr"] = rounded(dice.between(0.1, 1.0) * 1e-6 / length_mm)
    return medium


@feature(scenes=0.08)
def fog(draft: Draft, dice: Dice) -> bool | None:
    """A medium without bounds that does not shine."""
    medium = medium_of(draft, dice, draft.focus_mm)
    medium.pop("emission_w_mm3_sr", None)
    draft.add("media", medium)
    return None


@feature(scenes=0.15)
def cloud(draft: Draft, dice: Dice) -> bool | None:
    where, half = place(draft, dice, 0.4, 0.9)
    size = rounded(half * dice.between(0.3, 1.5))
    bounds = dice.one_of(
        {"kind": "sphere", "radius_mm": size},
        {"kind": "box", "size_mm": [size, rounded(1.3 * size), rounded(0.8 * size)]},
        {"kind": "cylinder", "radius_mm": size, "height_mm": size},
    )
    medium = medium_of(draft, dice, size)
    draft.add("media", medium | {"bounds": bounds, "position_mm": where, "rotation_deg": turned(dice)})
    return None


@feature(scenes=0.06, own_kernels=True)
def bent_air(draft: Draft, dice: Dice) -> bool | None:
    """A box of warm or cold air, or of a weak lens, that bends light by up to some mrad; no glass reaches into it."""
    glass = any("refractor" in target for target in draft.tables["targets"]) or "tanks" in draft.tables
    if glass or "object_medium" in draft.camera or {"polarisation", "diffraction"} & draft.transport.keys():
        return False
    where, half = place(draft, dice, 0.4, 0.9)
    size = rounded(half * dice.between(0.3, 1.2))
    # The corners of a box as long as wide are √(1/2) of its size from the axis.
    steepest = rounded(dice.log_between(1e-5, 8e-4) * dice.one_of(-2.0, 2.0) / size**2)
    law = dice.one_of(
        {"index": {"kind": "radial_n", "index": 1.0, "coefficients": [steepest]}},
        {"index": {"kind": "axial", "index": 1.0, "coefficients": [rounded(0.5 * size * steepest)]}},
        {"density_kg_m3": dice.between(0.1, 3.0)},
    )
    bounds = {"kind": "box", "size_mm": [size, size, rounded(size * dice.between(0.3, 1.0))]}
    if dice.chance(0.4):
        law |= medium_of(draft, dice, size)
    draft.add("media", law | {"bounds": bounds, "position_mm": where, "rotation_deg": turned(dice)})
    return None


@feature(scenes=0.1)
def shining_particles(draft: Draft, dice: Dice) -> bool | None:
    where, half = place(draft, dice, 0.6, 0.9)
    intensity = rounded(dice.between(0.1, 1.0) * 1e-7 * draft.half_field_mm**2)
    draft.add("particles", {
        "count": int(dice.draw.integers(5, 60)), "bounds": {"kind": "sphere", "radius_mm": rounded(0.6 * half)},
        "position_mm": where, "seed": int(dice.draw.integers(100)), "intensity_w_sr": intensity,
    })  # fmt: skip
    return None


@feature(scenes=0.06)
def particles_in_a_sheet(draft: Draft, dice: Dice) -> bool | None:
    where, half = place(draft, dice, 0.6, 0.9)
    sheet = {
        "point_mm": where, "normal": [0.0, 0.0, 1.0], "direction": [1.0, 0.0, 0.0], "width_mm": rounded(2.0 * half),
        "thickness_mm": rounded(0.3 * half), "power_w": rounded(dice.between(0.1, 1.0) * 1e3 * half**2),
    }  # fmt: skip
    draft.add("particles", {
        "count": int(dice.draw.integers(5, 60)), "position_mm": where, "seed": int(dice.draw.integers(100)),
        "bounds": {"kind": "box", "size_mm": [rounded(half), rounded(half), rounded(0.3 * half)]},
        "sheet": sheet, "phase": phase_of(dice), "diameter_um": dice.between(5.0, 50.0),
    })  # fmt: skip
    return None


# Motion during the exposure


def exposure_of(draft: Draft, dice: Dice) -> float:
    """Give the scene an exposure, and return the end of the last row's window, s."""
    duration, rows = dice.log_between(1e-3, 1.0), draft.camera["sensor"]["pixels"][1]
    exposure: Tables = {"duration_s": duration}
    if dice.chance(0.4):
        exposure["row_time_s"] = rounded(duration * dice.log_between(0.02, 0.5))
        exposure["row_direction"] = dice.one_of("down", "up")
    if dice.chance(0.4):
        times = [0.0, rounded(duration * dice.between(0.1, 0.5)), rounded(duration * dice.between(0.6, 0.9)), duration]
        exposure["shutter"] = [[time, dice.between(0.0, 1.0)] for time in times]
    draft.tables["exposure"] = exposure
    return float(duration + exposure.get("row_time_s", 0.0) * (rows - 1))


def motion_of(draft: Draft, dice: Dice, centre: list[float], end_s: float) -> Tables:
    """Draw a velocity and a spin about a centre, small beside the field and half a turn."""
    reach = 0.4 * draft.half_field_mm / end_s
    motion: Tables = {"velocity_mm_s": dice.vector(reach, reach, 0.3 * reach)}
    if dice.chance(0.5):
        motion |= {"spin_deg_s": dice.vector(*[30.0 / end_s] * 3), "center_mm": centre}
    return motion


def poses_of(draft: Draft, dice: Dice, body: Tables, end_s: float) -> Tables:
    """Draw poses up to the end of the exposure or beyond, about the body's own place."""
    reach, poses = 0.4 * draft.half_field_mm, [{"time_s": 0.0}]
    for time in (rounded(end_s * dice.between(0.3, 0.7)), rounded(1.01 * end_s)):
        step = dice.vector(reach, reach, 0.3 * reach)
        where = [rounded(w + d) for w, d in zip(body["position_mm"], step, strict=True)]
        turn = [
            rounded(a + d) for a, d in zip(body.get("rotation_deg", [0.0] * 3), dice.vector(*[20.0] * 3), strict=True)
        ]
        poses.append({"time_s": time, "position_mm": where, "rotation_deg": turn})
    return {"center_mm": body["position_mm"], "poses": poses}


@feature(scenes=0.12, own_kernels=True)
def motion(draft: Draft, dice: Dice) -> bool | None:
    """Bodies, lamps, media, particles or the camera move; nothing that stands in a tank, or bends light."""
    bends = any({"index", "density_kg_m3"} & medium.keys() for medium in draft.tables.get("media", []))
    in_tank = "tanks" in draft.tables
    end_s = exposure_of(draft, dice)
    bodies = [*draft.tables["targets"][1:], *(m for m in draft.tables.get("media", []) if "bounds" in m)]
    lamps, clouds = draft.tables.get("lights", []), draft.tables.get("particles", [])
    moving: list[Tables] = [] if in_tank or bends else [body for body in bodies if dice.chance(0.6)]
    for body in moving:
        drawn = poses_of if dice.chance(0.3) else motion_of
        body["motion"] = drawn(draft, dice, body if drawn is poses_of else body["position_mm"], end_s)
    for lamp in [lamp for lamp in lamps[:4] if dice.chance(0.5)]:
        if lamp["kind"] == "directional":
            lamp["motion"] = {"spin_deg_s": dice.vector(*[20.0 / end_s] * 3)}
        else:
            lamp["motion"] = motion_of(draft, dice, lamp.get("position_mm", lamp.get("start_mm")), end_s)
        moving.append(lamp)
    for cloud in [cloud for cloud in clouds if dice.chance(0.7) and not in_tank]:
        step = dice.vector(*[0.3 * draft.half_field_mm] * 3)
        cloud |= {"displacement": {"kind": "uniform", "vector_mm": step}, "frame_time_s": end_s}
        moving.append(cloud)
    if not bends and (dice.chance(0.3) or not moving):
        draft.camera["motion"] = motion_of(draft, dice, [0.0, 0.0, 0.0], end_s)
    return None if moving or not bends else False


# Last, so that everything is moved.


@feature(cameras=0.12, scenes=0.15)
def camera_pose(draft: Draft, dice: Dice) -> bool | None:
    """Camera and world, moved and turned together."""
    far = draft.focus_mm
    draft.tables = moved(draft.tables, dice.vector(180.0, 90.0, 180.0), dice.vector(far, far, far))
    return None
