"""Places, intensities, light sheets and displacements of particles, and what is refused."""

import numpy as np
import pytest
import trimesh
from scipy import stats

import lfmesh as lf
from lfmesh.errors import LfmeshError
from lfmesh.scene.light.particles import Particles, displacements, particle_places, particle_velocities
from tests.cameras import bench_camera

SHEET = {
    "point_mm": (1.0, 2.0, -500.0),
    "normal": (0.0, 0.0, 2.0),
    "direction": (3.0, 0.0, 0.0),
    "thickness_mm": 2.0,
    "width_mm": 30.0,
    "power_w": 0.5,
}
BOX = {"kind": "box", "size_mm": (10.0, 20.0, 4.0)}
DRAWN = {"count": 4000, "bounds": BOX, "position_mm": (5.0, 0.0, -500.0)}

LEVEL = 1e-3


class Folder:
    def __init__(self, path=None):
        self.path = path

    def resolve(self, name):
        return self.path / name


def places(folder=None, **fields):
    return particle_places(Particles(**fields), Folder(folder))


@pytest.mark.parametrize(
    "bounds",
    [BOX, {"kind": "sphere", "radius_mm": 3.0}, {"kind": "cylinder", "radius_mm": 2.0, "height_mm": 9.0}],
)
def test_drawn_places_fill_their_bounds_evenly(bounds):
    """Kolmogorov-Smirnov on each coordinate that is even; 1e-3 for the three of a body together."""
    points, intensity = places(count=4000, bounds=bounds, intensity_w_sr=2.0, seed=3)
    assert (intensity == 2.0).all()
    x, y, z = points.T
    if bounds["kind"] == "box":
        even = [x / 10.0 + 0.5, y / 20.0 + 0.5, z / 4.0 + 0.5]
    elif bounds["kind"] == "sphere":
        r = np.linalg.norm(points, axis=1)
        even = [(r / 3.0) ** 3, 0.5 * (z / r + 1.0), np.arctan2(y, x) / (2.0 * np.pi) + 0.5]
    else:
        even = [(x**2 + y**2) / 4.0, z / 9.0 + 0.5, np.arctan2(y, x) / (2.0 * np.pi) + 0.5]
    for shares in even:
        assert stats.kstest(shares, "uniform").pvalue > LEVEL / 3.0
    again, _ = places(count=4000, bounds=bounds, intensity_w_sr=2.0, seed=3)
    np.testing.assert_array_equal(points, again)
    other, _ = places(count=4000, bounds=bounds, intensity_w_sr=2.0, seed=4)
    assert (other != points).any()


def test_bounds_are_posed_as_targets_are():
    turned = {"rotation_deg": (90.0, 0.0, 20.0)}
    points, _ = places(**DRAWN, intensity_w_sr=1.0, **turned)
    plain, _ = places(**DRAWN, intensity_w_sr=1.0)
    from lfmesh.geometry.frame import rotation

    offset = np.array(DRAWN["position_mm"])
    np.testing.assert_allclose(points, (plain - offset) @ rotation((90.0, 0.0, 20.0)).T + offset, atol=1e-12)


def test_power_of_a_sheet_is_the_integral_of_its_irradiance():
    sheet = Particles(**DRAWN, diameter_um=10.0, sheet=SHEET).sheet
    across, off = np.meshgrid(np.linspace(-20.0, 20.0, 4001), np.linspace(-5.0, 5.0, 1001))
    points = np.stack([np.zeros(across.size), 2.0 + across.ravel(), -500.0 + off.ravel()], axis=1)
    power = sheet.irradiance_w_mm2(points).sum() * 0.01 * 0.01
    assert power == pytest.approx(0.5, rel=1e-3)  # the edge is within half a step of the grid
    middle, edge = sheet.irradiance_w_mm2(np.array([[9.0, 2.0, -500.0], [-7.0, 12.0, -499.0]]))
    assert edge / middle == pytest.approx(np.exp(-2.0), rel=1e-12)


def test_file_gives_places_and_intensities(tmp_path):
    (tmp_path / "p.csv").write_text("intensity_w_sr,x_mm,y_mm,z_mm\n0.5,1,2,-3\n0.25,4,5,-6\n")
    points, intensity = places(tmp_path, file="p.csv", position_mm=(0.0, 0.0, -100.0))
    np.testing.assert_array_equal(points, [[1.0, 2.0, -103.0], [4.0, 5.0, -106.0]])
    np.testing.assert_array_equal(intensity, [0.5, 0.25])


def test_displacements_are_those_of_their_fields():
    points = np.array([[1.0, 0.0, 5.0], [0.0, 2.0, 5.0], [0.0, 0.0, 0.0]])
    moved = lambda **field: displacements(Particles(**DRAWN, intensity_w_sr=1.0, displacement=field), points, Folder())  # noqa: E731
    np.testing.assert_array_equal(moved(kind="uniform", vector_mm=(1.0, 2.0, 3.0)), np.tile([1.0, 2.0, 3.0], (3, 1)))
    turn = moved(kind="rotation", center_mm=(0.0, 0.0, 0.0), axis=(0.0, 0.0, 3.0), angle_deg=90.0)
    np.testing.assert_allclose(points + turn, [[0.0, 1.0, 5.0], [-2.0, 0.0, 5.0], [0.0, 0.0, 0.0]], atol=1e-15)
    core, circulation = 0.5, 0.3
    vortex = moved(
        kind="vortex", center_mm=(0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0), core_mm=core, circulation_mm2=circulation
    )
    # Along the circle: Γ (1 − exp(−r² / core²)) / (2 π r) of arc, and no way out of it.
    for point, step in zip(points[:2], vortex[:2], strict=True):
        r = np.hypot(*point[:2])
        assert np.hypot(*(point + step)[:2]) == pytest.approx(r, rel=1e-14)
        arc = circulation * (1.0 - np.exp(-((r / core) ** 2))) / (2.0 * np.pi * r)
        assert 2.0 * r * np.arcsin(0.5 * np.linalg.norm(step) / r) == pytest.approx(arc, rel=1e-12)
        assert np.cross(point, step)[2] > 0.0
    np.testing.assert_array_equal(vortex[2], 0.0)


def test_a_field_from_a_file_is_linear_between_its_nodes(tmp_path):
    draw = np.random.default_rng(2)
    nodes = np.array(np.meshgrid([-1.0, 0.5, 2.0], [0.0, 1.0], [-7.0, -5.0, -4.0], indexing="ij")).reshape(3, -1).T
    linear = draw.normal(size=(3, 3))
    table = draw.permutation(np.hstack([nodes, nodes @ linear]))
    np.savetxt(tmp_path / "f.csv", table, delimiter=",", header="x_mm,y_mm,z_mm,dx_mm,dy_mm,dz_mm", comments="")
    group = Particles(**DRAWN, intensity_w_sr=1.0, displacement={"kind": "file", "file": "f.csv"})
    inside = draw.uniform([-1.0, 0.0, -7.0], [2.0, 1.0, -4.0], (50, 3))
    points = np.concatenate([inside, [[2.1, 0.5, -5.0]]])
    found = displacements(group, points, Folder(tmp_path))
    np.testing.assert_allclose(found[:50], inside @ linear, atol=1e-12)
    np.testing.assert_array_equal(found[50], 0.0)


def test_frames_displace_again_and_again():
    field = {"kind": "rotation", "center_mm": (0.0, 0.0, -500.0), "axis": (0.0, 1.0, 0.0), "angle_deg": 30.0}
    start, _ = places(**DRAWN, intensity_w_sr=1.0)
    group = {**DRAWN, "intensity_w_sr": 1.0, "displacement": field}
    three, _ = places(**group, frame=3)
    off = start - [0.0, 0.0, -500.0]
    np.testing.assert_allclose(three - [0.0, 0.0, -500.0], np.stack([off[:, 2], off[:, 1], -off[:, 0]], 1), atol=1e-12)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({}, "give file, or count and bounds"),
        ({"count": 3, "bounds": BOX}, "intensity_w_sr"),
        ({"count": 30_000_000, "bounds": BOX, "intensity_w_sr": 1.0}, "must be 20,000,000 or less"),
        ({"count": 10**12, "bounds": BOX, "intensity_w_sr": 1.0}, "count = 1000000000000: must be 20,000,000 or less"),
        ({"file": "p.csv", "count": 3}, "either read or drawn"),
        ({**DRAWN, "intensity_w_sr": 1.0, "sheet": SHEET, "diameter_um": 1.0}, "one of the two"),
        ({**DRAWN, "sheet": SHEET}, "diameter_um"),
        ({**DRAWN, "intensity_w_sr": 1.0, "diameter_um": 2.0}, "none is given"),
        ({**DRAWN, "intensity_w_sr": float("nan")}, "finite"),
        ({**DRAWN, "intensity_w_sr": -1.0}, "0 or more"),
        ({**DRAWN, "intensity_w_sr": 1.0, "frame": 2}, "needs displacement"),
        ({**DRAWN, "diameter_um": 1.0, "sheet": {**SHEET, "direction": (1.0, 0.0, 1.0)}}, "perpendicular to normal"),
        ({**DRAWN, "diameter_um": 1.0, "sheet": {**SHEET, "normal": (0.0, 0.0, 0.0)}}, "zero vector"),
        ({**DRAWN, "diameter_um": 1.0, "sheet": {**SHEET, "normal": (0.0, 1e-163, 0.0)}}, "a length from 1e-100 to"),
        (
            {**DRAWN, "diameter_um": 1.0, "sheet": SHEET, "phase": {"kind": "mie", "diameter_um": 1.0, "index": 1.5}},
            "belongs in phase",
        ),
    ],
)
def test_what_contradicts_itself_is_refused(fields, said):
    with pytest.raises(LfmeshError, match=said):
        Particles(**fields)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x_mm,y_mm,z_mm\n1,2,-300\n", "no column intensity_w_sr"),
        ("x_mm,y_mm,z_mm,intensity_w_sr\n1,2,nan,1\n", "z_mm of particle 1 is nan"),
        ("x_mm,y_mm,z_mm,intensity_w_sr\n1,2,-300,1\n1,2,-300,-1\n", "intensity_w_sr of particle 2 is -1"),
        ("x_mm,y_mm,z_mm,intensity_w_sr\n1,2,-300\n", "names 4 columns"),
        ("x_mm,y_mm,z_mm,intensity_w_sr\n1,2,-300,one\n", "below its first line"),
        ("x_mm,y_mm,z_mm,intensity_w_sr\n", "no particles"),
        ("", "no column x_mm"),
        ("x_mm,y_mm,z_mm,intensity_w_sr\n1,2,3,1\n", "does not lie before the lens"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, text, said):
    (tmp_path / "p.csv").write_text(text)
    scene = lf.loads(bench_camera(4, 4) + '[[particles]]\nfile = "p.csv"\n', tmp_path)
    with pytest.raises(LfmeshError, match=said) as raised:
        lf.build(scene)
    assert "\n" not in str(raised.value)


def test_spheres_that_one_entry_has_in_air_and_in_glass_are_refused(tmp_path):
    (tmp_path / "p.csv").write_text("x_mm,y_mm,z_mm\n40,0,-300\n1,2,-300\n")
    scene = lf.loads(bench_camera(4, 4) + '[[particles]]\nfile = "p.csv"\nintensity_w_sr = 1.0\n', tmp_path)
    trimesh.creation.box((20.0, 20.0, 20.0)).export(tmp_path / "box.stl")
    glass = {"file": "box.stl", "units": "mm", "surface": "flat", "index": 1.5}
    block = {"refractor": glass, "position_mm": (0.0, 0.0, -300.0)}
    sheet = {"point_mm": (0, 0, -300), "normal": (0, 0, 1), "direction": (1, 0, 0), "thickness_mm": 9.0,
             "width_mm": 99.0, "power_w": 1.0}  # fmt: skip
    mie = {"kind": "mie", "diameter_um": 2.0, "index": 1.6}
    lit = scene.changed(
        {
            "targets": (block,),
            "particles[0].intensity_w_sr": None,
            "particles[0].sheet": sheet,
            "particles[0].phase": mie,
        }
    )
    with pytest.raises(
        LfmeshError, match=r"particles\[0\]: its particles lie in media of the refractive indices 1, 1.5,"
    ):
        lf.build(lit)
    told = lit.changed({"particles[0].phase.surrounding_index": 1.5})
    assert (lf.build(told).particles[0].inside > 0).tolist() == [False, True]


def test_vectors_of_a_pair_lead_from_frame_to_frame(tmp_path):
    field = {"kind": "vortex", "center_mm": (0, 0, -500.0), "axis": (0, 1.0, 0), "core_mm": 5.0, "circulation_mm2": 9.0}
    scene = lf.loads(bench_camera(4, 4)).changed(
        {"particles": ({**DRAWN, "intensity_w_sr": 1.0, "displacement": field}, {**DRAWN, "intensity_w_sr": 1.0})}
    )
    points, steps = lf.particle_vectors(scene)
    later = lf.displaced(scene)
    np.testing.assert_array_equal(lf.particle_vectors(later)[0], points + steps)
    assert np.abs(steps[:4000]).max() > 0.1
    assert not steps[4000:].any()
    np.testing.assert_array_equal(
        lf.particle_vectors(lf.displaced(scene, 2))[0], lf.particle_vectors(lf.displaced(later))[0]
    )
    with pytest.raises(LfmeshError, match="none of the scene's particles moves"):
        lf.displaced(scene.changed({"particles[0].displacement": None}))


def test_particles_move_by_one_displacement_per_frame_time() -> None:
    vortex = {"kind": "vortex", "center_mm": (5, 0, 0), "axis": (0, 0, 1), "core_mm": 3.0, "circulation_mm2": 9.0}
    still = Particles(**DRAWN, intensity_w_sr=1.0, displacement=vortex)  # type: ignore[arg-type]
    moving = still.model_copy(update={"frame_time_s": 0.02})
    points, _ = particle_places(moving, Folder())
    speeds = particle_velocities(moving, points, Folder())
    np.testing.assert_allclose(0.02 * speeds, displacements(moving, points, Folder()), rtol=1e-15)
    assert particle_velocities(still, points, Folder()) is None
