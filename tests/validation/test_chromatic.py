"""Dispersion: axial colour of cemented achromats, and the spectrum that a prism casts on the sensor.

The truth takes indices from the coefficients of SCHOTT's data sheets by Sellmeier's formula, written here, and traces
paraxial rays by y and nu, real rays by Snell's law for vectors. Published are the textbook's secondary spectrum of a
thin achromat (W. J. Smith, Modern Optical Engineering, 5.9: f (P₁ − P₂) / (V₁ − V₂), some f / 2000 for ordinary
glasses), nd and Vd on the data sheets, the focal length of the Thorlabs lens AC254-100-A, and the focal shift that
OpticStudio gives for an achromat.
"""

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import Lens, Paraxial, Surface, load_lens
from tests.renders import by_seed
from tests.validation.bodies import prism

F, D, C = 486.13, 587.56, 656.27
"""Fraunhofer's lines, nm."""

LEVEL = 1e-3
"""Chance that a test fails though all is right, its comparisons together (Bonferroni)."""

SELLMEIER = {
    "SCHOTT/N-BK7": ((1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653)),
    "SCHOTT/SF2": ((1.40301821, 0.231767504, 0.939056586), (0.0105795466, 0.0493226978, 112.405955)),
    "SCHOTT/SF5": ((1.46141885, 0.247713019, 0.949995832), (0.0111826126, 0.0508594669, 112.041888)),
}
DATA_SHEET = {"SCHOTT/N-BK7": (1.51680, 64.17), "SCHOTT/SF2": (1.64769, 33.85), "SCHOTT/SF5": (1.67270, 32.21)}
"""nd and Vd."""


def index(glass: str, wavelength_nm: float) -> float:
    b, c = (np.array(values) for values in SELLMEIER[glass])
    squared = (1e-3 * wavelength_nm) ** 2
    return float(np.sqrt(1.0 + np.sum(b * squared / (squared - c))))


@pytest.mark.parametrize("glass", SELLMEIER)
def test_coefficients_written_here_are_those_of_the_data_sheets(glass: str) -> None:
    f, d, c = (index(glass, line) for line in (F, D, C))
    assert d == pytest.approx(DATA_SHEET[glass][0], abs=5.1e-6)
    assert (d - 1.0) / (f - c) == pytest.approx(DATA_SHEET[glass][1], abs=0.006)


def doublet(radii: tuple[float, ...], thicknesses: tuple[float, ...], flint: str, semi_diameter_mm: float) -> Lens:
    """A cemented achromat of N-BK7 and a flint, its stop at the first surface."""
    glasses = ("SCHOTT/N-BK7", flint, None)
    return Lens(
        surfaces=tuple(
            Surface(radius_mm=r, thickness_mm=t, glass=g, semi_diameter_mm=semi_diameter_mm, stop=k == 0)
            for k, (r, t, g) in enumerate(zip(radii, (*thicknesses, None), glasses, strict=True))
        )
    )


def back_focus(lens: Lens, wavelength_nm: float) -> tuple[float, float]:
    """Focal length and back focal length, mm, by the paraxial ray trace: y and nu."""
    y, nu, n = 1.0, 0.0, 1.0
    for k, surface in enumerate(lens.surfaces):
        behind = index(surface.glass, wavelength_nm) if isinstance(surface.glass, str) else 1.0
        nu -= y * (behind - n) / surface.radius_mm
        n = behind
        if k < len(lens.surfaces) - 1:
            y += nu / n * (surface.thickness_mm or 0.0)
    return -1.0 / nu, -y / nu


def refracted(d: np.ndarray, normal: np.ndarray, before: float, behind: float) -> np.ndarray:
    """Directions behind an interface, by Snell's law: the part along the face keeps its length times the index."""
    normal = np.where(np.sum(d * normal, axis=-1, keepdims=True) < 0.0, -normal, normal)
    along = before / behind * (d - np.sum(d * normal, axis=-1, keepdims=True) * normal)
    return along + np.sqrt(1.0 - np.sum(along**2, axis=-1, keepdims=True)) * normal


def real_rays(lens: Lens, p: np.ndarray, d: np.ndarray, wavelength_nm: float) -> tuple[np.ndarray, np.ndarray]:
    """Points on the last surface and directions behind it, of rays through spheres."""
    n, z = 1.0, 0.0
    for surface in lens.surfaces:
        glass = surface.glass
        behind = index(glass, wavelength_nm) if isinstance(glass, str) else surface.index or 1.0
        centre = np.array([0.0, 0.0, z + surface.radius_mm])
        along = np.sum((centre - p) * d, axis=-1, keepdims=True)
        foot = p + along * d - centre
        chord = np.sqrt(surface.radius_mm**2 - np.sum(foot**2, axis=-1, keepdims=True))
        p = p + (along - np.sign(surface.radius_mm) * chord) * d
        d = refracted(d, (p - centre) / surface.radius_mm, n, behind)
        n, z = behind, z + (surface.thickness_mm or 0.0)
    return p, d


THORLABS = load_lens(asset_path("lenses/achromat_100mm.toml"))
FLINT_508 = doublet((314.553854, -201.71156, -1230.47658), (11.0236, 8.1534), "SCHOTT/SF2", 42.0)
ACHROMATS = {"AC254-100-A": THORLABS, "N-BK7 and SF2, 508 mm": FLINT_508}


@pytest.mark.parametrize("name", ACHROMATS)
def test_the_focus_of_an_achromat_moves_with_the_line_as_a_paraxial_trace_says(name: str) -> None:
    lens = ACHROMATS[name]
    found = np.array([(p.efl_mm, p.bfl_mm) for p in (Paraxial.of(lens, line) for line in (F, D, C))])
    expected = np.array([back_focus(lens, line) for line in (F, D, C)])
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    # The shifts are no rounding: the lenses are not corrected that well.
    assert np.abs(np.diff(expected[:, 1])).min() > 1e-4 * expected[1, 0]


def test_a_thin_achromat_has_the_textbooks_secondary_spectrum() -> None:
    """f (P₁ − P₂) / (V₁ − V₂) from d to the common focus of F and C, and zero from F to C."""
    focal, flint = 100.0, "SCHOTT/SF2"

    def by(glass: str) -> tuple[float, float, float]:
        f, d, c = (index(glass, line) for line in (F, D, C))
        return (d - 1.0) / (f - c), (d - c) / (f - c), d - 1.0

    (v1, p1, crown_less_1), (v2, p2, flint_less_1) = by("SCHOTT/N-BK7"), by(flint)
    # Powers by the condition of achromatism; the crown equiconvex, all of it as thin as paper.
    one, two = v1 / (v1 - v2) / focal, -v2 / (v1 - v2) / focal
    first = 2.0 * crown_less_1 / one
    last = 1.0 / (-1.0 / first - two / flint_less_1)
    thin = doublet((first, -first, last), (1e-6, 1e-6), flint, 1e-3)
    f, d, c = (Paraxial.of(thin, line).bfl_mm for line in (F, D, C))
    secondary = focal * (p1 - p2) / (v1 - v2)
    assert d == pytest.approx(focal, rel=1e-6)
    assert f == pytest.approx(c, abs=1e-3 * secondary)
    # Second order in the change of power is what the formula leaves out.
    assert f - d == pytest.approx(secondary, rel=2e-3)
    assert secondary == pytest.approx(focal / 2000.0, rel=0.15)


def test_the_focus_of_an_achromat_shifts_as_opticstudio_says() -> None:
    """An achromat of 50 mm whose longitudinal aberration was read off OpticStudio's plot at the middle of the pupil.

    Published to two digits (github.com/raymondngiam/OpticalEngineeringProjects, 03-AchromatDesign): +9.6e-2 mm for C
    and -1.6e-1 mm for F against the focus of d. A value read off a plot may be a step of its last digit away. With
    N-SF10, the flint's successor, C would be 0.0986 mm: dispersion by the wrong glass is seen.
    """
    lens = Lens(
        surfaces=[
            Surface(radius_mm=13.294, thickness_mm=2.0, glass="SCHOTT/N-BAF10", semi_diameter_mm=4.7, stop=True),
            Surface(radius_mm=np.inf, thickness_mm=1.0, glass="SCHOTT/SF10", semi_diameter_mm=4.7),
            Surface(radius_mm=23.973, semi_diameter_mm=4.7),
        ]
    )
    f, d, c = (Paraxial.of(lens, line).bfl_mm for line in (F, D, C))
    assert c - d == pytest.approx(0.096, abs=0.001)
    assert f - d == pytest.approx(-0.16, abs=0.01)


@pytest.mark.parametrize("line", [F, D, C])
def test_real_rays_of_each_line_cross_the_axis_where_snell_says(line: float) -> None:
    """Every zone of AC254-100-A, infinite object, against the trace above, to 1e-8 mm; the paraxial zone's limit."""
    camera = {"lens": THORLABS, "sensor": {"pixels": [40, 40], "pixel_mm": 1.0, "distance_mm": 60.0}}
    world = lf.build(lf.Scene(camera=camera))
    height = np.array([0.05, 2.0, 5.0, 8.0, 11.0])
    start = np.column_stack([height, np.zeros_like(height), np.full_like(height, -10.0)])
    ahead = np.tile([0.0, 0.0, 1.0], (len(height), 1))
    paths = lf.trace(world, start, ahead, wavelength_nm=line, split="transmit")
    assert (paths.status == lf.Status.SENSOR).all()
    p, d = real_rays(THORLABS, start, ahead, line)
    last = THORLABS.vertices_mm[-1]

    def crossing(p: np.ndarray, d: np.ndarray) -> np.ndarray:
        return np.asarray(p[:, 2] - p[:, 0] / d[:, 0] * d[:, 2] - last)

    # A rounding of 1e-14 mm at the height of 0.05 mm stands for 2e-11 mm of the focus.
    np.testing.assert_allclose(crossing(paths.position, paths.direction), crossing(p, d), atol=1e-8)
    assert crossing(p, d)[0] == pytest.approx(back_focus(THORLABS, line)[1], abs=1e-4)


def against_d(foci: np.ndarray) -> np.ndarray:
    """Foci of F and C with that of d subtracted; that of d stays. The last axis is F, d, C."""
    shifts = foci - foci[..., 1:2]
    shifts[..., 1] = foci[..., 1]
    return shifts


def test_each_line_is_sharpest_where_its_rays_are() -> None:
    """Best foci of F, d and C in rendered pictures of a spot, from the width of its image at three distances.

    The mean square radius of a spot is a parabola over the distance. Its vertex is compared with that of rays from the
    middle of the spot; the spot is small, and pixels add the same to every width.
    """
    object_mm, places = 1000.0, np.array([-3.0, 0.0, 3.0])
    spot = {"shape": {"kind": "disk", "radius_mm": 0.2}, "position_mm": [0.0, 0.0, -object_mm],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    middle = Paraxial.of(THORLABS, D).image_mm(object_mm)
    pixels, pitch, seeds = 32, 0.03, 8
    axis = (np.arange(pixels) - 0.5 * (pixels - 1)) * pitch
    r2 = axis[:, None] ** 2 + axis[None, :] ** 2
    widths = np.empty((seeds, len(places), 3))
    for k, place in enumerate(places):
        sensor = {"pixels": [pixels, pixels], "pixel_mm": pitch, "distance_mm": middle + place}
        scene = lf.Scene(
            camera={"lens": THORLABS, "sensor": sensor}, targets=[spot],
            transport={"wavelengths_nm": [F, D, C], "method": "forward", "samples": 16, "replicates": 2,
                       "threads": 1, "split": "transmit"},
        )  # fmt: skip
        for seed, each in enumerate(by_seed(scene, range(seeds))):
            image = each.mean
            widths[seed, k] = (image * r2[..., None]).sum(axis=(0, 1)) / image.sum(axis=(0, 1))
    fits = np.array([np.polyfit(places, each, 2) for each in widths])
    foci = against_d(-0.5 * fits[:, 1] / fits[:, 0])
    found, error = foci.mean(axis=0), foci.std(axis=0, ddof=1) / np.sqrt(seeds)
    # Rays through points of equal area of the entrance pupil.
    radius = 11.43 * np.sqrt((np.arange(400) + 0.5) / 400)
    expected = []
    for line in (F, D, C):
        sag = THORLABS.surfaces[0].radius_mm - np.sqrt(THORLABS.surfaces[0].radius_mm ** 2 - radius**2)
        d = np.column_stack([radius, np.zeros_like(radius), object_mm + sag])
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        p, d = real_rays(THORLABS, np.tile([0.0, 0.0, -object_mm], (len(d), 1)), d, line)
        slope = d[:, 0] / d[:, 2]
        height = p[:, 0] + slope * (THORLABS.vertices_mm[-1] + middle - p[:, 2])
        expected.append(-np.sum(height * slope) / np.sum(slope**2))
    expected = against_d(np.array([expected]))[0]
    assert np.abs((found - expected) / error).max() < stats.t.isf(LEVEL / 6.0, seeds - 1), (found, expected, error)
    assert error[[0, 2]].max() < 0.1 * np.abs(expected[[0, 2]]).min()


def test_a_prism_casts_its_spectrum_on_the_sensor_where_snell_says(tmp_path: Path) -> None:
    """The images of a small spot behind a prism of SF5 at F, d and C, against rays by Snell's law for vectors.

    The lens has the same index at every line, so that the spectrum is the prism's.
    """
    apex, height = np.radians(30.0), 40.0
    half = height * np.tan(0.5 * apex)
    # The apex points to +x; the outline is counter-clockwise in (x, z) as seen from −y.
    outline = np.array([[0.5 * height, 0.0], [-0.5 * height, half], [-0.5 * height, -half]])
    depth = -60.0
    body = prism(tmp_path / "prism.obj", outline, 40.0, [0.0, 0.0, depth], glass="SCHOTT/SF5")
    camera = {
        "lens": {"surfaces": [
            {"radius_mm": 40.0, "thickness_mm": 2.0, "index": 1.5, "semi_diameter_mm": 1.0, "stop": True},
            {"radius_mm": -40.0, "semi_diameter_mm": 3.0}]},
        "focus_mm": 200.0,
        "sensor": {"pixels": [160, 24], "pixel_mm": 0.025},
    }  # fmt: skip
    lens = lf.Scene(camera=camera).camera.lens
    faces = []
    for corner, other in ((0, 1), (0, 2)):
        edge = outline[other] - outline[corner]
        normal = np.array([edge[1], 0.0, -edge[0]]) / np.hypot(*edge)
        middle = 0.5 * (outline[corner] + outline[other])
        faces.append((np.array([middle[0], 0.0, middle[1] + depth]), normal))

    def through(p: np.ndarray, d: np.ndarray, line: float) -> tuple[np.ndarray, np.ndarray]:
        """Rays through the prism towards the lens, or from it, whichever face they meet first."""
        n = index("SCHOTT/SF5", line)
        order = sorted(faces, key=lambda face: float(d[0, 2] * face[0][2]))
        for (point, normal), (before, behind) in zip(order, ((1.0, n), (n, 1.0)), strict=True):
            t = np.sum((point - p) * normal, axis=1) / np.sum(d * normal, axis=1)
            p = p + t[:, None] * d
            d = refracted(d, np.broadcast_to(normal, d.shape), before, behind)
        return p, d

    # The spot lies where the camera sees it in the middle, at the d line.
    back_p, back_d = through(np.zeros((1, 3)), np.array([[0.0, 0.0, -1.0]]), D)
    spot_at = (back_p + back_d * (-200.0 - back_p[0, 2]) / back_d[0, 2])[0]
    spot = {"shape": {"kind": "disk", "radius_mm": 0.2}, "position_mm": spot_at.tolist(),
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    scene = lf.Scene(
        camera=camera, targets=[spot, body],
        transport={"wavelengths_nm": [F, D, C], "samples": 64, "replicates": 2, "threads": 1, "split": "transmit"},
    )  # fmt: skip
    seeds, columns = 6, (np.arange(160) - 79.5) * 0.025
    images = [each.mean for each in by_seed(scene, range(seeds))]
    centroids = [(image * columns[None, :, None]).sum(axis=(0, 1)) / image.sum(axis=(0, 1)) for image in images]
    found, error = np.mean(centroids, axis=0), np.std(centroids, axis=0, ddof=1) / np.sqrt(seeds)
    # Rays from the middle of the spot through points of equal area of the stop, which lies in the first vertex's plane.
    radius, turn = np.sqrt((np.arange(6) + 0.5) / 6), np.arange(12) * np.pi / 6.0
    pupil = np.column_stack([np.outer(radius, f(turn)).ravel() for f in (np.cos, np.sin)])
    sensor_z = lens.vertices_mm[-1] + lf.build(scene).scene.camera.sensor.distance_mm
    expected = []
    for line in (F, D, C):

        def towards(slopes: np.ndarray, line: float = line) -> tuple[np.ndarray, np.ndarray]:
            d = np.column_stack([slopes.reshape(-1, 2), np.ones(len(pupil))])
            d /= np.linalg.norm(d, axis=1, keepdims=True)
            return through(np.tile(spot_at, (len(d), 1)), d, line)

        def beside(slopes: np.ndarray) -> np.ndarray:
            p, d = towards(slopes)
            return np.asarray((p - d * (p[:, 2:] / d[:, 2:]))[:, :2] - pupil).ravel()

        slopes = np.tile(back_d[0, :2] / back_d[0, 2], (len(pupil), 1)).ravel()
        for _ in range(20):
            off = beside(slopes)
            step = 1e-6
            both = [
                (beside(slopes + step * np.tile(axis, len(pupil))) - off).reshape(-1, 2) / step
                for axis in ([1.0, 0.0], [0.0, 1.0])
            ]
            jacobian = np.stack(both, axis=2)
            slopes = slopes - np.linalg.solve(jacobian, off.reshape(-1, 2, 1)).ravel()
        assert np.abs(beside(slopes)).max() < 1e-9
        p, d = real_rays(lens, *towards(slopes), line)
        expected.append(np.mean((p + d * ((sensor_z - p[:, 2:]) / d[:, 2:]))[:, 0]))
    expected = np.array(expected)
    assert np.abs((found - expected) / error).max() < stats.t.isf(LEVEL / 6.0, seeds - 1), (found, expected, error)
    assert error.max() < 0.01 * np.ptp(expected)
    assert np.ptp(expected) > 10 * 0.025
