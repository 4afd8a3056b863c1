"""What drawn cameras may have: lens, array, sensor and transport settings, one function a feature."""

import math
from itertools import pairwise

from tests.random_scenes.draft import Dice, Draft, Tables, feature, rounded

GLASSES = ("SCHOTT/N-BK7", "SCHOTT/F2", "SCHOTT/N-SF6", "SCHOTT/N-LAK9")


def array_of(draft: Draft) -> Tables | None:
    """Return the table of the array, None without one."""
    return draft.camera.get("mla")


# Lens


@feature(cameras=0.08, scenes=0.08)
def under_water(draft: Draft, dice: Dice) -> bool | None:
    """A flat port before the lens and a medium beyond it, in which the plane in focus appears where it was."""
    medium, glass = dice.between(1.1, 1.35), dice.between(1.4, 1.9)
    thickness, gap = (rounded(draft.focal_mm * dice.log_between(0.02, 0.3)) for _ in range(2))
    apparent = draft.focus_mm - gap - thickness / glass
    if apparent < 0.5 * draft.focus_mm:
        return False
    draft.focus_mm = rounded(medium * apparent)
    draft.camera.update({"focus_mm": draft.focus_mm, "object_medium": {"index": medium}})
    draft.tables["targets"][0]["position_mm"] = [0.0, 0.0, -draft.focus_mm]
    draft.surfaces[:0] = [{"thickness_mm": thickness, "index": glass}, {"thickness_mm": gap}]
    draft.groups = [[number + 2 for number in group] for group in draft.groups]
    return None


@feature(cameras=0.15, scenes=0.02)
def conic_surface(draft: Draft, dice: Dice) -> bool | None:
    if not draft.curved:
        return False
    dice.one_of(*draft.curved)["conic"] = dice.between(-2.0, 0.8)
    return None


@feature(cameras=0.2, scenes=0.02)
def even_asphere(draft: Draft, dice: Dice) -> bool | None:
    """Terms that move the surface at the marginal ray by up to 3 % of that ray's height, or by nearly nothing."""
    if not draft.curved:
        return False
    h = draft.semi_mm
    moved = [dice.both_signs(0.0, 0.03) * h, dice.both_signs(0.0, 0.01) * h]
    if dice.chance(0.3):
        moved = [1e-9 * h]
    dice.one_of(*draft.curved)["asphere_mm"] = [rounded(s / h ** (4 + 2 * j)) for j, s in enumerate(moved)]
    return None


@feature(cameras=0.03, scenes=0.0, own_kernels=True)
def odd_asphere(draft: Draft, dice: Dice) -> bool | None:
    if not draft.curved:
        return False
    dice.one_of(*draft.curved)["odd_asphere_mm"] = [rounded(dice.both_signs(0.0, 0.01) / draft.semi_mm**2)]
    return None


@feature(cameras=0.04, scenes=0.0, own_kernels=True)
def another_section_in_x(draft: Draft, dice: Dice) -> bool | None:
    plain = [surface for surface in draft.curved if not {"asphere_mm", "odd_asphere_mm"} & surface.keys()]
    if not plain:
        return False
    surface = dice.one_of(*plain)
    radius = surface["radius_mm"]
    other = rounded(radius * dice.between(0.8, 1.3)) if math.isfinite(radius) else draft.focal_mm
    if dice.chance(0.5):
        surface["toroid"] = {"radius_x_mm": dice.one_of(other, math.inf)}
    else:
        surface["biconic"] = {"radius_x_mm": other, "conic_x": dice.between(-1.0, 0.5)}
    return None


@feature(cameras=0.15, scenes=0.03)
def posed_element(draft: Draft, dice: Dice) -> bool | None:
    if not draft.curved:
        return False
    tilt = dice.vector(3.0, 3.0, 0.0)
    shift = dice.vector(0.06 * draft.semi_mm, 0.06 * draft.semi_mm, 0.0)
    draft.camera["lens"]["elements"] = [
        {"surfaces": dice.one_of(*draft.groups), "pose": {"tilt_deg": tilt, "shift_mm": shift}}
    ]
    return None


@feature(cameras=0.12, scenes=0.02)
def vignetting_rim(draft: Draft, dice: Dice) -> bool | None:
    """A clear aperture that cuts off part of the beam."""
    rims = [surface for surface in draft.curved if not surface.get("stop")]
    if not rims:
        return False
    dice.one_of(*rims)["semi_diameter_mm"] = rounded(draft.semi_mm * dice.between(0.6, 1.0))
    return None


@feature(cameras=0.08, scenes=0.03)
def catalogue_glass(draft: Draft, dice: Dice) -> bool | None:
    glasses = [surface for surface in draft.curved if "index" in surface]
    if not glasses:
        return False
    for surface in glasses:
        del surface["index"]
        surface["glass"] = dice.one_of(*GLASSES)
    return None


@feature(cameras=0.04, scenes=0.02)
def absorbing_glass(draft: Draft, dice: Dice) -> bool | None:
    if not any("glass" in surface for surface in draft.surfaces) and catalogue_glass(draft, dice) is False:
        return False
    draft.camera["absorption"] = True
    return None


@feature(cameras=0.02, scenes=0.01, own_kernels=True)
def ground_surface(draft: Draft, dice: Dice) -> bool | None:
    if not draft.curved:
        return False
    dice.one_of(*draft.curved)["finish"] = {"kind": "ground", "roughness": dice.between(0.02, 0.3)}
    return None


COATINGS = {
    "film": {"layers": [{"index": 1.38, "thickness_nm": 106.5}]},
    "mirror": {"layers": [{"index": 2.3, "thickness_nm": 63.9}, {"index": 1.46, "thickness_nm": 100.7}]},
    "even": {"reflectance": 0.08},
}
ABSORBING = {
    "sun": {"layers": [{"index": 1.46, "thickness_nm": 60.0}, {"index": 1.8, "extinction": 0.4, "thickness_nm": 45.0}]}
}


def coat(draft: Draft, dice: Dice, coatings: dict[str, Tables]) -> bool | None:
    """Coat some faces of lens, array and cover."""
    faces = [(s, "coating") for s in draft.curved if "finish" not in s and "qbfs" not in s]
    if (mla := array_of(draft)) is not None:
        faces += [(mla, "curved_coating"), (mla, "flat_coating")]
    if (cover := draft.camera["sensor"].get("cover")) is not None:
        faces.append((cover, "coating"))
    some = [face for face in faces if dice.chance(0.6)]
    if not some:
        return False
    used = {}
    for table, key in some:
        table[key] = dice.one_of(*coatings)
        used[table[key]] = coatings[table[key]]
    draft.tables.setdefault("coatings", {}).update(used)
    return None


# Array


@feature(cameras=0.4, scenes=0.2)
def hexagonal_array(draft: Draft, dice: Dice) -> bool | None:
    if (mla := array_of(draft)) is None:
        return False
    mla["layout"] = "hexagonal"
    mla["count"][1] = math.ceil(mla["count"][1] * 2.0 / math.sqrt(3.0))
    return None


@feature(cameras=0.4, scenes=0.3)
def curved_side_to_sensor(draft: Draft, dice: Dice) -> bool | None:
    if (mla := array_of(draft)) is None:
        return False
    mla["curved_side"] = "sensor"
    return None


@feature(cameras=0.15, scenes=0.05)
def focused_array(draft: Draft, dice: Dice) -> bool | None:
    """The sensor before or behind the lenslets' focal plane."""
    if array_of(draft) is None:
        return False
    draft.room_mm *= dice.one_of(dice.between(0.5, 0.85), dice.between(1.15, 1.8))
    draft.camera["sensor"]["distance_mm"] = rounded(draft.room_mm)
    return None


@feature(cameras=0.12, scenes=0.02)
def multi_focus_array(draft: Draft, dice: Dice) -> bool | None:
    if (mla := array_of(draft)) is None:
        return False
    mla["radius_mm"] = [rounded(mla["radius_mm"] * k) for k in (1.0, dice.between(1.0, 1.4), dice.between(1.0, 1.4))]
    return None


@feature(cameras=0.15, scenes=0.02)
def lenslet_form_errors(draft: Draft, dice: Dice) -> bool | None:
    if (mla := array_of(draft)) is None:
        return False
    mla["form"] = {
        "decenter_mm": rounded(dice.between(0.0, 0.02) * mla["pitch_mm"]),
        "radius_error": dice.between(0.0, 0.02),
        "pitch_error": dice.one_of(0.0, dice.both_signs(0.0, 0.01)),
        "seed": int(dice.draw.integers(100)),
    }
    return None


@feature(cameras=0.1, scenes=0.02)
def aspheric_lenslets(draft: Draft, dice: Dice) -> bool | None:
    if (mla := array_of(draft)) is None:
        return False
    mla["conic"] = dice.between(-2.5, 0.2)
    if dice.chance(0.4):
        mla["asphere_mm"] = [[rounded(dice.both_signs(0.0, 0.1) / mla["pitch_mm"] ** 3)]]
    return None


@feature(cameras=0.08, scenes=0.02)
def cylindrical_lenslets(draft: Draft, dice: Dice) -> bool | None:
    mla = array_of(draft)
    if mla is None or "layout" in mla:
        return False
    mla["cylinder_axis"] = dice.one_of("x", "y")
    return None


@feature(cameras=0.06, scenes=0.02)
def lenslets_on_both_faces(draft: Draft, dice: Dice) -> bool | None:
    if (mla := array_of(draft)) is None:
        return False
    radius = mla["radius_mm"]
    first = radius[0] if isinstance(radius, list) else radius
    shift = dice.vector(0.2 * mla["pitch_mm"], 0.2 * mla["pitch_mm"])
    mla["back"] = {"radius_mm": rounded(first * dice.both_signs(1.5, 4.0)), "decenter_mm": shift}
    return None


@feature(cameras=0.15, scenes=0.05)
def posed_array(draft: Draft, dice: Dice) -> bool | None:
    if (mla := array_of(draft)) is None:
        return False
    p = mla["pitch_mm"]
    mla["pose"] = {"tilt_deg": dice.vector(1.5, 1.5, 5.0), "shift_mm": dice.vector(0.5 * p, 0.5 * p, 0.05 * p)}
    return None


# Sensor


@feature(cameras=0.15, scenes=0.08)
def cover(draft: Draft, dice: Dice) -> bool | None:
    room = min(draft.room_mm, 1.0) if array_of(draft) is None else draft.room_mm
    draft.camera["sensor"]["cover"] = {
        "thickness_mm": rounded(room * dice.between(0.05, 0.4)),
        "gap_mm": rounded(room * dice.between(0.05, 0.4)),
        "index": dice.between(1.4, 1.8),
    }
    return None


@feature(cameras=0.12, scenes=0.05)
def reflecting_sensor(draft: Draft, dice: Dice) -> bool | None:
    draft.camera["sensor"]["reflectance"] = dice.between(0.02, 0.6)
    return None


@feature(cameras=0.15, scenes=0.05)
def tilted_sensor(draft: Draft, dice: Dice) -> bool | None:
    """Up to 20 degrees, and so that the sensor stays clear of the array and of its cover."""
    sensor = draft.camera["sensor"]
    half = 0.5 * sensor["pixel_mm"] * math.hypot(*sensor["pixels"])
    most = min(20.0, math.degrees(math.asin(min(0.35, 0.15 * draft.room_mm / half))))
    sensor["pose"] = {"tilt_deg": [*dice.vector(most, most), dice.between(-10.0, 10.0)],
                      "shift_mm": dice.vector(0.3 * half, 0.3 * half, 0.0)}  # fmt: skip
    return None


@feature(cameras=0.08, scenes=0.04)
def immersed_sensor(draft: Draft, dice: Dice) -> bool | None:
    """A medium behind the lens, around the array and the cover. It weakens the last surface and the lenslets."""
    if any(surface.get("paraxial") for surface in draft.surfaces):
        return False
    array = array_of(draft)
    most = 1.35 if array is None else 1.0 + 0.6 * (array["index"] - 1.0)
    draft.camera["image_medium"] = {"index": dice.between(1.03, most)}
    return None


@feature(cameras=0.15, scenes=0.1)
def coatings(draft: Draft, dice: Dice) -> bool | None:
    return coat(draft, dice, COATINGS)


@feature(cameras=0.04, scenes=0.02, own_kernels=True)
def absorbing_coatings(draft: Draft, dice: Dice) -> bool | None:
    return coat(draft, dice, ABSORBING | COATINGS)


# How light is traced


@feature(cameras=0.1, scenes=0.1)
def two_wavelengths(draft: Draft, dice: Dice) -> bool | None:
    draft.transport["wavelengths_nm"] = [486.1, 656.3]
    return None


@feature(cameras=0.3, scenes=0.3)
def reflections(draft: Draft, dice: Dice) -> bool | None:
    """Both children of every split are followed; otherwise the transmitted one alone."""
    draft.transport["split"] = "both"
    return None


@feature(cameras=0.08, scenes=0.08)
def reflections_by_chance(draft: Draft, dice: Dice) -> bool | None:
    draft.transport["split"] = "roulette"
    return None


@feature(cameras=0.03, scenes=0.02, own_kernels=True)
def polarisation(draft: Draft, dice: Dice) -> bool | None:
    draft.transport["polarisation"] = True
    if dice.chance(0.5):
        draft.camera["polariser_deg"] = dice.between(0.0, 180.0)
    return None


@feature(cameras=0.06, scenes=0.0, own_kernels=True)
def lenslet_diffraction(draft: Draft, dice: Dice) -> bool | None:
    mla = array_of(draft)
    rough = {"curved_finish", "flat_finish"} & (mla or {}).keys()
    if mla is None or rough or draft.transport.get("polarisation"):
        return False
    if "cylinder_axis" not in mla and dice.chance(0.3):
        mla["clear_diameter_mm"] = rounded(mla["pitch_mm"] * dice.between(0.7, 0.99))
    draft.transport["diffraction"] = "lenslets"
    return None


# Phases, after all that they do not go with


DESIGN_NM = 587.6


def phase_of(dice: Dice, radius_mm: float, power_per_mm: float) -> Tables:
    """Draw a phase of a beam of a radius that adds a power; a grating turns light by as much as the power at the rim.

    Parameters
    ----------
    dice : Dice
    radius_mm : float
    power_per_mm : float
        Signed, at the design wavelength in the main order.
    """
    order = dice.one_of(-1, 1, 1, 2)
    per_sine = 1.0 / (order * DESIGN_NM * 1e-6)
    turn = power_per_mm * radius_mm * per_sine
    coefficient = -math.pi * turn * radius_mm
    aberration = coefficient * dice.between(-0.2, 0.2)
    kind = dice.one_of("radial", "xy", "grating", "metalens")
    phase: Tables = {"kind": kind, "order": order}
    if kind == "radial":
        phase |= {"coefficients_rad": [rounded(coefficient), rounded(aberration)], "radius_mm": rounded(radius_mm)}
    elif kind == "xy":
        terms = [[2, 0, coefficient], [0, 2, coefficient], [1, 1, aberration], [0, 3, 0.5 * aberration]]
        phase |= {"coefficients_rad": [[i, j, rounded(a)] for i, j, a in terms], "radius_mm": rounded(radius_mm)}
    elif kind == "grating":
        phase |= {"lines_per_mm": rounded(abs(turn)), "direction_deg": dice.between(-180.0, 180.0)}
    else:
        phase |= {"order": 1, "focal_length_mm": rounded(1.0 / power_per_mm), "design_nm": DESIGN_NM}
    return phase


def with_light(phase: Tables, dice: Dice, other: int) -> Tables:
    """Draw the light in the orders: all in one, a blaze, or shares of two orders with some light in neither."""
    choice = dice.one_of("ideal", "ideal", "blaze", "two orders")
    if choice == "blaze":
        phase |= {"efficiency": "blaze", "design_nm": DESIGN_NM, "blaze_order": phase["order"]}
        if dice.chance(0.5):
            # Few steps leave higher orders dark.
            phase["levels"] = dice.one_of(2, 4, 8) if abs(phase["order"]) == 1 else 8
    elif choice == "two orders":
        main = phase.pop("order")
        shares = dice.between(0.4, 0.7), dice.between(0.05, 0.3)
        listed = zip((main, other), shares, strict=True)
        phase["orders"] = [{"order": order, "share": share} for order, share in listed]
    return phase


@feature(cameras=0.08, scenes=0.04, own_kernels=True)
def phase_on_the_lens(draft: Draft, dice: Dice) -> bool | None:
    """A weak phase, of up to a fifth of the lens's power, on one of its faces."""
    faces = [s for s in draft.curved if "finish" not in s]
    if not faces or draft.transport.get("polarisation"):
        return False
    surface = dice.one_of(*faces)
    power = dice.both_signs(0.02, 0.2) / draft.focal_mm
    phase = with_light(phase_of(dice, draft.semi_mm, power), dice, dice.one_of(0, 3))
    if phase["kind"] == "grating":
        # Paraxial rays do not tell the beams that it turns.
        if any("radius_mm" not in s and not s.get("stop") for s in draft.surfaces):
            return False
        for s in draft.curved:
            if not s.get("stop"):
                s.setdefault("semi_diameter_mm", rounded(1.1 * draft.semi_mm))
    surface["phase"] = phase
    return None


@feature(cameras=0.08, scenes=0.04, own_kernels=True)
def phase_on_the_array(draft: Draft, dice: Dice) -> bool | None:
    """A weak phase on either face, or metalenses in place of the lenslets."""
    mla = array_of(draft)
    rough = {"curved_finish", "flat_finish"} & (mla or {}).keys()
    if mla is None or rough or draft.transport.get("polarisation") or "diffraction" in draft.transport:
        return False
    face = dice.one_of("curved_phase", "flat_phase")
    shaped = {"conic", "asphere_mm", "cylinder_axis", "back"} & mla.keys()
    radius = mla["radius_mm"]
    first = radius[0] if isinstance(radius, list) else radius
    power = (mla["index"] - 1.0) / first
    if dice.chance(0.4) and not shaped and not isinstance(radius, list):
        del mla["radius_mm"]
        if "form" in mla:
            del mla["form"]["radius_error"]
        mla[face] = {"kind": "metalens", "focal_length_mm": rounded(1.0 / power), "design_nm": DESIGN_NM}
        return None
    weak = power * dice.both_signs(0.05, 0.25)
    mla[face] = with_light(phase_of(dice, 0.5 * mla["pitch_mm"], weak), dice, dice.one_of(0, 3))
    return None


# Gradients, after all that they do not go with


STEEPEST_GRADIENT = 0.08
"""Largest change of a drawn index within the glass."""


def takes_gradient(draft: Draft, face: Tables, coating: str = "coating", finish: str = "finish") -> bool:
    """Tell whether a face may touch gradient-index glass: polished, without a phase, bare or of one reflectance."""
    layered = {name for name, each in draft.tables.get("coatings", {}).items() if "layers" in each}
    return finish not in face and "phase" not in face and face.get(coating) not in layered


@feature(cameras=0.1, scenes=0.08, own_kernels=True)
def gradient_in_the_lens(draft: Draft, dice: Dice) -> bool | None:
    """A gradient in place of a glass, of up to a fifth of the lens's power."""
    if draft.transport.get("polarisation"):
        return False
    gaps = [
        front
        for front, back in pairwise(draft.surfaces)
        if {"index", "glass"} & front.keys()
        and all("radius_mm" in face and takes_gradient(draft, face) for face in (front, back))
    ]
    if not gaps or (draft.camera.get("absorption") and len(gaps) < 2):
        return False
    front = dice.one_of(*gaps)
    front.pop("glass", None)
    index = front.pop("index", None) or dice.between(1.5, 1.8)
    radius, length, kind = draft.semi_mm, front["thickness_mm"], dice.one_of(*GRADIENT_KINDS)
    across = weak(dice.both_signs(0.02, 0.2) / draft.focal_mm / (2.0 * length), radius)
    along, aberration = dice.both_signs(0.01, STEEPEST_GRADIENT) / length, across * dice.between(-0.2, 0.2) / radius**2
    gradient: Tables = {"kind": kind, "index": index}
    if kind in ("radial_n2", "radial_n"):
        gradient["coefficients"] = [rounded(across), rounded(aberration)]
    elif kind == "xyz":
        gradient["x_coefficients"] = [0.0, rounded(across * dice.between(0.5, 1.0))]
        gradient["y_coefficients"] = [0.0, rounded(across), rounded(aberration * radius)]
    else:
        gradient["coefficients"] = [rounded(along), rounded(along * dice.between(-0.3, 0.3) / length)]
    if kind == "spherical":
        gradient["radius_mm"] = rounded(dice.both_signs(3.0, 10.0) * radius)
    front["gradient"] = gradient
    return None


GRADIENT_KINDS = ("radial_n2", "radial_n", "axial", "spherical", "xyz")


def weak(coefficient: float, radius: float) -> float:
    """Return a coefficient of r², smaller where it would change an index too much."""
    most = STEEPEST_GRADIENT / radius**2
    return max(-most, min(coefficient, most))


@feature(cameras=0.08, scenes=0.04, own_kernels=True)
def gradient_in_the_array(draft: Draft, dice: Dice) -> bool | None:
    """A weak gradient in the plate, or rods in place of the lenslets."""
    mla = array_of(draft)
    if mla is None or draft.transport.get("polarisation") or "diffraction" in draft.transport:
        return False
    phases = {"curved_phase", "flat_phase"} & mla.keys()
    if phases or not all(takes_gradient(draft, mla, f"{f}_coating", f"{f}_finish") for f in ("curved", "flat")):
        return False
    shaped = {"conic", "asphere_mm", "cylinder_axis", "back"} & mla.keys()
    radius, corner = mla["radius_mm"], mla["pitch_mm"] / math.sqrt(2.0)
    first = radius[0] if isinstance(radius, list) else radius
    index = mla.pop("index")
    coefficient = -(index - 1.0) / first / (index * mla["thickness_mm"])
    if dice.chance(0.5) and not shaped and not isinstance(radius, list) and abs(coefficient) * corner**2 < 0.4:
        del mla["radius_mm"]
        if "form" in mla:
            del mla["form"]["radius_error"]
    else:
        coefficient = weak(coefficient * dice.both_signs(0.05, 0.25), corner)
    mla["gradient"] = {"kind": "radial_n2", "index": index, "coefficients": [rounded(coefficient)]}
    if dice.chance(0.4):
        mla["walls"] = "clear"
    return None


# Zones, after the gradients that they do not go with


@feature(cameras=0.03, scenes=0.0, own_kernels=True)
def outer_zone(draft: Draft, dice: Dice) -> bool | None:
    """A kink inside the beam, and another radius and asphere beyond it."""
    excluded = {"odd_asphere_mm", "biconic", "toroid", "gradient"}
    beside = [draft.surfaces[k] for k in range(1, len(draft.surfaces)) if "gradient" in draft.surfaces[k - 1]]
    plain = [s for s in draft.curved if not excluded & s.keys() and not any(s is each for each in beside)]
    if not plain:
        return False
    surface, h = dice.one_of(*plain), draft.semi_mm
    radius = surface["radius_mm"]
    other = rounded(radius * dice.between(0.9, 1.15)) if math.isfinite(radius) else 5.0 * draft.focal_mm
    surface["outer_zone"] = {
        "border_mm": rounded(h * dice.between(0.3, 0.8)),
        "radius_mm": other,
        "asphere_mm": [rounded(dice.both_signs(0.0, 0.01) / h**3)],
    }
    return None
