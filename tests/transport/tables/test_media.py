"""Every medium of a scene has one number, air the first; tables hold what it does at their wavelengths."""

import lfmesh as lf
from lfmesh.optics.glass import refractive_index
from lfmesh.transport.tables.media import MediumList
from lfmesh.transport.tables.tables import AIR
from lfmesh.transport.trace import at_wavelength

SCENE = lf.Scene(
    camera={
        "focus_mm": 300.0,
        "lens": {"surfaces": [
            {"radius_mm": 50.0, "thickness_mm": 3.0, "glass": "SCHOTT/N-BK7", "semi_diameter_mm": 5.0},
            {"radius_mm": -50.0, "thickness_mm": 2.0, "index": 1.6, "semi_diameter_mm": 5.0},
            {"radius_mm": -70.0, "semi_diameter_mm": 5.0, "stop": True},
        ]},
        "mla": {"count": [4, 4], "pitch_mm": 0.5, "focal_length_mm": 2.6, "glass": "SCHOTT/N-BK7", "thickness_mm": 0.5},
        "sensor": {"pixels": [20, 20], "pixel_mm": 0.1},
    },
    targets=[{"shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 50.0}, "position_mm": [0, 0, -300.0]}],
    transport={"wavelengths_nm": [450.0, 650.0]},
)  # fmt: skip


def test_a_medium_has_one_number_wherever_it_is() -> None:
    known = MediumList.of(SCENE)
    assert known.media == (None, "SCHOTT/N-BK7", 1.6)
    assert known.in_camera(None) == AIR
    tables = lf.build(SCENE).tables
    assert tables.lens.medium.tolist() == [AIR, 1, 2, AIR]
    assert tables.mla.medium == 1


def test_tables_hold_the_indices_of_their_media_at_each_wavelength() -> None:
    world = lf.build(SCENE)
    dispersion = [refractive_index("SCHOTT/N-BK7", wave) for wave in (450.0, 650.0)]
    assert dispersion[0] > dispersion[1]
    for tables in (world.tables.lens, world.tables.mla, world.tables.objects):
        assert tables.media.indices.tolist() == [[1.0, 1.0], dispersion, [1.6, 1.6]]


def test_a_trace_has_the_media_of_its_own_wavelength() -> None:
    tables = at_wavelength(lf.build(SCENE), 550.0)
    index = refractive_index("SCHOTT/N-BK7", 550.0)
    for each in (tables.lens, tables.mla, tables.objects):
        assert each.media.indices[1].tolist() == [index]
