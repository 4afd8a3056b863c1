"""The lens files that ray-optics ships, against that program; `tools/test --long` installs it.

Those in scope have its focal lengths and its real rays; the others are refused with the right reason. ray-optics is a
program of its own, with readers, glass data and a tracer of its own.
"""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.imports import read_lens_file, write_lens_file
from lfmesh.imports.conditions import Conditions
from lfmesh.optics.glass import D_LINE_NM
from lfmesh.scene import Paraxial, load_lens
from tests.imports.dialects import in_common_words
from tests.imports.test_round_trips import SENSOR_MM, random_lens

SPEC = find_spec("rayoptics")
pytestmark = pytest.mark.skipif(SPEC is None, reason="ray-optics is not there; tools/test --long installs it")
SAMPLES = Path(SPEC.origin).parent if SPEC is not None and SPEC.origin else Path()

IN_SCOPE = [
    "codev/tests/CODV_32327.seq",
    "codev/tests/CODV_49664.seq",
    "codev/tests/CODV_65564.seq",
    "codev/tests/CODV_65988_noDOE.seq",
    "codev/tests/ag_dblgauss.seq",
    "codev/tests/asp46.seq",
    "codev/tests/landscape_lens.seq",
    "codev/tests/singlet.seq",
    "codev/tests/unfolded_lenses_w_ape.seq",
    "zemax/tests/US00583336-2-scaled.zmx",
]
OWN_DISPERSION = {
    "codev/tests/CODV_49664.seq": 1e-8,
    "codev/tests/CODV_65988_noDOE.seq": 5e-8,
    "codev/tests/asp46.seq": 1e-8,
}
"""Files with glass by nd and Vd or a table, between whose lines each program interpolates in a way of its own, and how
far off focal lengths (relative) and landings (mm) may be for that."""
SAME = 1e-12
"""As those of all other files."""
FOR_LITHOGRAPHY = "zemax/tests/US05831776-1.zmx"
"""Read, and compared with nothing here: its object is near, and its light of 248 nm."""
OF_FORMER_GLASS = "zemax/tests/zmax_55278.zmx"
"""Read with the successor of its BK7, and compared with nothing here: ray-optics has a choice of its own for BK7."""
MIRRORS, TILTS = "mirrors are not supported", "the axis is not restored"
REFUSED = {
    "codev/tests/CODV_65988.seq": "diffractive surfaces are not supported",
    "codev/tests/achroMangin.seq": MIRRORS,
    "codev/tests/achroMangin_ok.seq": MIRRORS,
    "codev/tests/dar_test.seq": "holds no lens",
    "codev/tests/dec_rev_tilt_test.seq": "holds no lens",
    "codev/tests/dec_test.seq": TILTS,
    "codev/tests/dec_tilt_test.seq": TILTS,
    "codev/tests/folded_lenses.seq": MIRRORS,
    "codev/tests/lens_reflection_test.seq": MIRRORS,
    "codev/tests/mangin.seq": MIRRORS,
    "codev/tests/paraboloid.seq": MIRRORS,
    "codev/tests/paraboloid_f8.seq": MIRRORS,
    "codev/tests/questar35.seq": "obscurations and holes are not supported",
    "codev/tests/rc_f16.seq": MIRRORS,
    "codev/tests/schmidt.seq": MIRRORS,
    "codev/tests/schmidt_sph.seq": MIRRORS,
    "codev/tests/test.seq": "cut short: it has no image surface SI",
    "codev/tests/threemir.seq": MIRRORS,
    "codev/tests/tilt_test.seq": TILTS,
    "zemax/models/PhotoPrime/US05331467-1.zmx": "a central obscuration is not supported",
    "zemax/tests/354710-C-Zemax(ZMX).zmx": "glass 'D-ZK3M': not in the catalogue; close to it are CDGM/D-ZK3",
    "zemax/tests/ASL5040-UV-Zemax(ZMX).zmx": "glass 'C79-80': not in the catalogue",
    "zemax/tests/HoO-V2C18Ex03.zmx": MIRRORS,
    "zemax/tests/HoO-V2C18Ex27.zmx": MIRRORS,
    "zemax/tests/HoO-V2C18Ex46.zmx": MIRRORS,
    "zemax/tests/HoO-V2C18Ex66.zmx": MIRRORS,
    "zemax/tests/HoO-V2C18Ex66NEW.zmx": MIRRORS,
    "zemax/tests/US08011793-1.zmx": "a decentred aperture is not supported",
    "zemax/tests/US08427765-1.ZMX": "glass 'L-TIM28_MOLD': not in the catalogue; close to it are OHARA/L-TIM28",
    "zemax/tests/zmax_37992.zmx": MIRRORS,
}
START_MM = 100.0


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path, monkeypatch):
    """ray-optics writes logs into the current folder."""
    monkeypatch.chdir(tmp_path)


@dataclass
class Truth:
    """What ray-optics makes of a file."""

    model: object
    wavelength_nm: float
    efl_mm: float
    bfl_mm: float
    track_mm: float
    """From its first surface to the image."""


def truth_of(name):
    from rayoptics.gui.appcmds import open_model

    model = open_model(SAMPLES / name)
    sequence = model.seq_model
    orders = model["analysis_results"]["parax_data"].fod
    track = sum(gap.thi for gap in sequence.gaps[1:])
    return Truth(model, sequence.central_wavelength(), orders.efl, orders.bfl, track)


@pytest.mark.parametrize("name", [name for name in IN_SCOPE if "asp46" not in name])
def test_focal_lengths_are_those_of_ray_optics(name):
    truth = truth_of(name)
    lens, _ = read_lens_file(SAMPLES / name)
    paraxial = Paraxial.of(lens, truth.wavelength_nm)
    assert paraxial.efl_mm == pytest.approx(truth.efl_mm, rel=OWN_DISPERSION.get(name, SAME))
    assert paraxial.bfl_mm == pytest.approx(truth.bfl_mm, rel=OWN_DISPERSION.get(name, SAME))


def farthest_mm(path, rays):
    """Largest distance in the image plane between rays here and in ray-optics, on the axis and at two fields.

    They start in a plane 100 mm before the first surface; `rays` of each field.
    """
    from rayoptics.raytr.trace import trace
    from rayoptics.raytr.traceerror import TraceError

    truth = truth_of(path)
    sequence = truth.model.seq_model
    sequence.gaps[0].thi = START_MM
    sequence.update_model()
    lens, report = read_lens_file(SAMPLES / path)
    image_mm = report.conditions.image_mm
    before_mm = START_MM + truth.track_mm - sum(s.thickness_mm or 0.0 for s in lens.surfaces) - image_mm
    scene = lf.solved(
        lf.Scene(
            camera=lf.Camera(lens=lens, sensor=lf.Sensor(pixels=(4000, 4000), pixel_mm=0.05, distance_mm=image_mm)),
            transport=lf.Transport(wavelengths_nm=(truth.wavelength_nm,)),
        )
    )
    world = lf.build(scene)
    draw = np.random.default_rng(3)
    pupil_mm, diameter = Paraxial.of(lens, truth.wavelength_nm).entrance_pupil(lens.aperture_mm(lens.stop_index) or 1.0)
    origins, directions, landed = [], [], []
    for field_deg in (0.0, 2.0, 5.0):
        for _ in range(rays):
            aim = 0.45 * diameter * draw.uniform(-0.7, 0.7, 2)
            direction = np.array([0.0, np.tan(np.radians(field_deg)), 1.0])
            start = np.array([*aim, 0.0]) - direction * (before_mm + pupil_mm)
            direction /= np.linalg.norm(direction)
            try:
                ray = trace(sequence, np.array([start[0], start[1], 0.0]), direction, truth.wavelength_nm)
            except TraceError:
                continue
            origins.append([start[0], start[1], -before_mm])
            directions.append(direction)
            landed.append(ray[0][-1][0])
    paths = lf.trace(world, np.array(origins), np.array(directions), truth.wavelength_nm, split="transmit")
    here = np.isin(paths.body, ["sensor", "beside the sensor"])
    assert here.sum() > 1.5 * rays
    difference = paths.position[here, :2] - np.array(landed)[paths.source[here], :2]
    return np.abs(difference).max()


@pytest.mark.parametrize("name", IN_SCOPE)
def test_real_rays_are_those_of_ray_optics(name):
    assert farthest_mm(name, 40) < OWN_DISPERSION.get(name, SAME)


@pytest.mark.parametrize("ending", [".zmx", ".seq"])
@pytest.mark.parametrize("of", ["edmund_55278_52mm", "double_gauss_100mm", "asphere_100mm", *range(10)])
def test_ray_optics_reads_what_is_written(tmp_path, of, ending):
    lens = load_lens(f"lib:{of}") if isinstance(of, str) else in_common_words(random_lens(of, ending))
    # It reads no odd aspheres, and loses the order of surfaces between coordinate breaks.
    surfaces = tuple(surface.model_copy(update={"odd_asphere_mm": ()}) for surface in lens.surfaces)
    lens = lens.model_copy(update={"surfaces": surfaces, "elements": lens.elements if ending == ".seq" else ()})
    path = tmp_path / f"lens{ending}"
    write_lens_file(lens, path, Conditions(image_mm=SENSOR_MM))
    truth = truth_of(path)
    paraxial = Paraxial.of(lens, truth.wavelength_nm)
    assert truth.wavelength_nm == pytest.approx(D_LINE_NM)
    assert truth.efl_mm == pytest.approx(paraxial.efl_mm, rel=SAME)
    assert truth.bfl_mm == pytest.approx(paraxial.bfl_mm, rel=SAME)
    assert farthest_mm(path, 10) < 10.0 * SAME


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_out_of_scope_is_refused_with_its_reason(name):
    with pytest.raises(SceneError) as error:
        read_lens_file(SAMPLES / name)
    assert REFUSED[name] in str(error.value)


def test_every_sample_is_in_a_table():
    files = {
        path.relative_to(SAMPLES).as_posix() for path in SAMPLES.rglob("*") if path.suffix.lower() in (".zmx", ".seq")
    }
    # This one is read, too, but ray-optics asks the network for its glass.
    assert files == {*IN_SCOPE, *REFUSED, FOR_LITHOGRAPHY, OF_FORMER_GLASS, "elem/tests/ACL3026U-Zemax(ZMX).zmx"}
