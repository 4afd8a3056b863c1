"""Planes of sharpest focus lie where the ray model of a plenoptic camera puts them.

C. Hahne, A. Aggoun, S. Haxha, V. Velisavljevic, J. C. J. Fernández, "Light field geometry of a standard plenoptic
camera", Opt. Express 22 (2014) 26659, and C. Hahne, A. Aggoun, V. Velisavljevic, S. Fiebig, M. Pesch, "Refocusing
distance of a standard plenoptic camera", Opt. Express 24 (2016) 21521: rays from neighbouring micro-images, a pixel
further in each, meet b' behind the main lens,

    b' = b_U + a p_m / (p_p/f_s − a p_m/d_A'),    d = (1/f_U − 1/b')⁻¹ + b_U + HH,

with the focal length f_U of the main lens, b_U from its rear principal plane to the array, p_m the lenslets' pitch, f_s
their focal length, p_p the pixel, d_A' from the exit pupil to the array, HH between the principal planes, and d the
object's distance from the array.
"""

import math
import warnings
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.lightfield.rays.ray_model import RayModel

Array = NDArray[np.float64]

TOLERANCE = 0.005

SHIFTS = (-0.3, -0.2, -0.1, 0.1, 0.2, 0.3)

PLACES = [(x, y) for y in (-4.6, 4.6) for x in (-8.3, 0.4, 8.6)]
"""Where the point targets stand in the middle view, in lenslets from its middle, one a shift."""

STEPS = 7
"""Photographs round each."""

HALF_WINDOW = 4
"""Lenslets round a point in which its sharpness is measured; the next one is 8 away, and 3 lenslets wide at worst."""


def ray_model_distance_mm(a: float, model: RayModel) -> float:
    """The formula above, as it is published, from the camera's first-order numbers."""
    b_u = model.array_z_mm - model.rear_principal_z_mm
    slope = model.pixel_mm / model.lenslet_to_sensor_mm - a * model.lenslet_pitch_mm / model.pupil_to_array_mm
    b = b_u + a * model.lenslet_pitch_mm / slope
    separation = model.rear_principal_z_mm - model.front_principal_z_mm
    return 1.0 / (1.0 / model.efl_mm - 1.0 / b) + b_u + separation


def camera(stop_mm: float, radius_mm: float) -> lf.Scene:
    """A singlet with its stop behind it before long lenslets: f/27, so slow that it images as first-order optics say.

    Neighbouring views differ little in slope, so the place of the exit pupil weighs heavily.
    """
    lens = {
        "surfaces": [
            {"radius_mm": 75.0, "thickness_mm": 4.0, "index": 1.5, "semi_diameter_mm": 15.0},
            {"radius_mm": -75.0, "thickness_mm": stop_mm, "semi_diameter_mm": 15.0},
            {"stop": True, "semi_diameter_mm": radius_mm},
        ]
    }
    array = {"count": (27, 20), "pitch_mm": 0.125, "focal_length_mm": 2.5, "index": 1.5, "thickness_mm": 0.3}
    return lf.solved(
        lf.Scene(
            camera={"focus_mm": 220.0, "lens": lens, "mla": array, "sensor": {"pixels": (710, 530), "pixel_mm": 0.005}},
            transport={"method": "forward", "split": "transmit", "samples": 2, "replicates": 2, "threads": 2},
        )
    )


def with_points(scene: lf.Scene, model: RayModel, distances_mm: list[float]) -> lf.Scene:
    """Add a glowing square, as wide as a lenslet sees, at each distance."""
    targets: list[dict[str, Any]] = []
    for distance, (x, y) in zip(distances_mm, PLACES, strict=True):
        size = model.lenslet_pitch_mm * model.object_scale(distance)
        targets.append(
            {
                "shape": {"kind": "plane", "width_mm": size, "height_mm": size},
                "position_mm": (x * size, y * size, -distance),
                "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
            }
        )
    return scene.changed({"targets": targets})


def sharpest_shifts(field: lf.LightField, model: RayModel) -> list[float]:
    """The shifts, in lenslets, whose photographs hold most energy of each point, with planes by the published formula.

    By the Fourier slice, which shifts views without blurring them, with an aperture that keeps clear of the rim of the
    micro-images, where pixels are lit in part.
    """
    shifts = np.add.outer(SHIFTS, np.linspace(-0.1, 0.1, STEPS))
    planes = [ray_model_distance_mm(a, model) - model.array_z_mm for a in shifts.flat]
    return sharpest(field, shifts, planes, f_number=40.0)


def sharpest(field: lf.LightField, shifts: Array, planes: list[float], f_number: float) -> list[float]:
    """The top of a parabola through the energies of each row's photographs, over the row's shifts."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        stack = lf.focal_stack(field, planes, f_number=f_number, method="fourier")
    pictures = stack.mean.reshape(*shifts.shape, *field.size)
    tops = []
    for near, group, (x, y) in zip(shifts, pictures, PLACES, strict=True):
        column, row = round(0.5 * (field.size[1] - 1) + x), round(0.5 * (field.size[0] - 1) - y)
        window = np.s_[:, row - HALF_WINDOW : row + HALF_WINDOW + 1, column - HALF_WINDOW : column + HALF_WINDOW + 1]
        energy = (group[window] ** 2).sum(axis=(1, 2))
        square, linear, _ = np.polyfit(near, energy / energy.max(), 2)
        tops.append(float(-linear / (2.0 * square)))
    return tops


@pytest.mark.parametrize(
    ("stop_mm", "radius_mm"), [(5.0, 1.9), (60.0, 1.0)], ids=["exit pupil at 109 mm", "exit pupil at 54 mm"]
)
def test_point_targets_are_sharpest_where_the_ray_model_says(stop_mm: float, radius_mm: float) -> None:
    """Three shifts on each side of the focus; moving the exit pupil moves these planes by up to 5 %."""
    scene = camera(stop_mm, radius_mm)
    model = RayModel.of(scene)
    distances = [ray_model_distance_mm(a, model) - model.array_z_mm for a in SHIFTS]
    field = lf.decode(lf.render(with_points(scene, model, distances)))
    for a, top in zip(SHIFTS, sharpest_shifts(field, model), strict=True):
        measured = ray_model_distance_mm(top, model)
        assert measured == pytest.approx(ray_model_distance_mm(a, model), rel=TOLERANCE), f"a = {a}"


def test_a_double_gauss_at_f4_is_sharpest_where_its_real_rays_meet() -> None:
    """Paraxial distances would be 1 to 3 % off: its spherical aberration moves the focus by 0.06 to 0.1 mm."""
    lens = {"file": asset_path("lenses/double_gauss_50mm.toml").as_posix(), "stop_semi_diameter_mm": 4.77}
    array = {"count": (27, 20), "pitch_mm": 0.125, "focal_length_mm": 0.5, "index": 1.5, "thickness_mm": 0.3}
    scene = lf.solved(
        lf.Scene(
            camera={
                "focus_mm": 500.0,
                "lens": lens,
                "mla": array,
                "sensor": {"pixels": (276, 206), "pixel_mm": 0.0125},
            },
            transport={"method": "forward", "split": "transmit", "samples": 8, "replicates": 2, "threads": 2},
        )
    )
    model = RayModel.of(scene)
    distances = [320.0, 380.0, 440.0, 600.0, 800.0, 1200.0]
    field = lf.decode(lf.render(with_points(scene, model, distances)))
    shifts = np.add.outer([model.shift_mm(d) for d in distances], model.lenslet_pitch_mm * np.linspace(-0.25, 0.25, 9))
    planes = [model.distance_mm(shift) for shift in shifts.flat]
    for distance, top in zip(distances, sharpest(field, shifts, planes, f_number=4.5), strict=True):
        assert model.distance_mm(top) == pytest.approx(distance, rel=TOLERANCE), f"{distance:g} mm"


def test_moving_the_exit_pupil_moves_the_planes() -> None:
    """What the test above would not see, were the pupil's place left out: the planes of the two cameras differ."""
    near, far = (RayModel.of(camera(stop, 1.0)) for stop in (60.0, 5.0))
    differences = [ray_model_distance_mm(a, near) / ray_model_distance_mm(a, far) - 1.0 for a in (-0.3, 0.3)]
    assert min(map(abs, differences)) > 3.0 * TOLERANCE


HAHNE = {"efl_mm": 193.2935, "pixel_mm": 0.009, "lenslet_to_sensor_mm": 2.75, "lenslet_pitch_mm": 0.125}
"""The camera of these papers: its 193 mm lens before lenslets of 2.75 mm; HH = −65.5563 mm, d_A' = 111.0324 mm."""

PLENOPTISIGN = [
    # (focused on, d_A', a, distance from the array), mm
    (math.inf, 111.0324, 0.5, 1940.960859639992),
    (math.inf, 111.0324, 1.0, 962.7458944610837),
    (math.inf, 111.0324, 2.0, 473.63841187162893),
    (math.inf, 1e12, 1.0, 1299.2456651415464),
    (3000.0, 111.0324, 1.0, 852.2299320053892),
    (1500.0, 111.0324, -0.5, 2646.203173104369),
    (1500.0, 111.0324, 1.5, 601.1199575059105),
]
"""From PlenoptiSign 1.1.3 (C. Hahne, A. Aggoun, "PlenoptiSign: An optical design tool for plenoptic imaging",
SoftwareX 10 (2019) 100259), whose default camera this is: it cuts the rays themselves, in a linear system."""


@pytest.mark.parametrize(("focus_mm", "pupil_mm", "a", "distance_mm"), PLENOPTISIGN)
def test_the_published_camera_refocuses_where_plenoptisign_says(
    focus_mm: float, pupil_mm: float, a: float, distance_mm: float
) -> None:
    separation, f = -65.5563, HAHNE["efl_mm"]
    # Its focus is counted from the array too, so that b_U solves (1/f − 1/b)⁻¹ + b + HH = focus.
    total = focus_mm - separation
    image = f if math.isinf(focus_mm) else 0.5 * (total - math.sqrt(total * total - 4.0 * total * f))
    model = RayModel(
        **HAHNE,
        front_principal_z_mm=0.0,
        rear_principal_z_mm=separation,
        array_z_mm=separation + image,
        pupil_to_array_mm=pupil_mm,
        f_number=22.0,
    )
    from_array = model.distance_mm(a * model.lenslet_pitch_mm) + model.array_z_mm
    assert from_array == pytest.approx(distance_mm, rel=1e-6)
    assert model.shift_mm(from_array - model.array_z_mm) == pytest.approx(a * model.lenslet_pitch_mm, rel=1e-9)
