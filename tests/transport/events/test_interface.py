"""An interface divides power by closed forms, and a packet into children that carry it on: every rule of the split."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.coatings import Stack, coated
from lfmesh.optics.fresnel import fresnel, transmittance
from lfmesh.optics.reflectance_table import read_reflectance
from lfmesh.optics.share_table import looked_up
from lfmesh.transport import choice
from lfmesh.transport.events.interface import shares, splitter
from lfmesh.transport.packets.book import FIXED, ROULETTE_ADDED, ROULETTE_REMOVED, UNFOLLOWED
from lfmesh.transport.packets.packet import (
    BOTH,
    BY_MESH,
    CAMERA_FRAME,
    COUNTERS,
    DEPOSIT,
    E_REFLECTED,
    E_TRANSMITTED,
    END,
    EVENTS,
    LENS,
    MLA_FRAME,
    NODE,
    NODES,
    OBJECT_FRAME,
    PACKET,
    ROULETTE,
    STATIONS,
    TOPS,
    TRANSMIT,
    Flow,
    Options,
    Thinning,
    put,
)
from lfmesh.transport.packets.random import derived, descendant
from lfmesh.transport.paths.automaton import (
    EVERY,
    IN_NO_GHOST,
    ON_IMAGE_PATH,
    REFLECTED_ONCE,
    REFLECTED_TWICE,
    STRAY,
)
from lfmesh.transport.settings import with_thinning
from lfmesh.transport.tables import interfaces as table
from lfmesh.transport.tables.interfaces import coating_errors, interface_tables
from lfmesh.transport.tables.tables import FLAT_ROW, INTERFACE, Interfaces

LEVEL = 1e-3
"""Chance that a statistical test fails though the law holds."""

EPSILON = np.finfo(np.float64).eps

BARE = Interfaces(rows=np.zeros(3, INTERFACE), parameters=np.zeros((0, 2)))


def bare(n_i, n_t, cos_i):
    return shares(BARE, 1, 0, n_i, n_t, cos_i, False)


@pytest.mark.parametrize("n_i", [1.0, 1.33, 1.5, 2.4, 4.0])
@pytest.mark.parametrize("n_t", [1.0, 1.33, 1.5, 2.4, 4.0])
def test_normal_incidence_has_its_closed_form(n_i, n_t):
    R, T, cos_t = bare(n_i, n_t, 1.0)
    assert pytest.approx(((n_i - n_t) / (n_i + n_t)) ** 2, abs=4 * EPSILON) == R
    assert pytest.approx(4.0 * n_i * n_t / (n_i + n_t) ** 2, rel=8 * EPSILON) == T
    assert cos_t == 1.0


def test_oblique_incidence_has_the_sines_and_tangents_of_its_angles():
    draw = np.random.default_rng(3)
    for n_i, n_t, sine in zip(*draw.uniform(1.0, 4.0, (2, 4000)), draw.uniform(0.05, 0.999, 4000), strict=True):
        sine_t = n_i / n_t * sine
        if abs(sine_t - 1.0) < 1e-3 or abs(n_i - n_t) < 1e-3:
            continue
        R, T, cos_t = bare(n_i, n_t, np.sqrt(1.0 - sine * sine))
        if sine_t > 1.0:
            assert (R, T, cos_t) == (1.0, 0.0, 0.0)
            continue
        a, b = np.arcsin(sine), np.arcsin(sine_t)
        s, p = np.sin(a - b) / np.sin(a + b), np.tan(a - b) / np.tan(a + b)
        assert pytest.approx(0.5 * (s * s + p * p), abs=1e-12) == R
        assert pytest.approx(1.0 - R, abs=4 * EPSILON) == T
        assert pytest.approx(np.cos(b), abs=1e-12) == cos_t


def test_grazing_light_passes_in_proportion_to_its_angle():
    # To first order in the angle T = 2 a (1 + 1/n²) n² / √(n² − 1), from thin to dense.
    n = 1.5
    for angle in 10.0 ** np.arange(-5.0, -12.0, -1.0):
        _, T, _ = bare(1.0, n, np.sin(angle))
        assert pytest.approx(2.0 * angle * (1.0 + n * n) / np.sqrt(n * n - 1.0), rel=5.0 * angle + 1e-13) == T


def test_matched_indices_pass_everything_at_every_angle():
    for cos_i in (1.0, 0.7, 1e-3, 1e-12, 0.0):
        assert bare(1.7, 1.7, cos_i) == (0.0, 1.0, cos_i)


@kernel
def of_blocks(n_i, n_t, cos_i, cos_t, T):
    for i in range(len(T)):
        s, p = n_i[i] * cos_i[i] + n_t[i] * cos_t[i], n_i[i] * cos_t[i] + n_t[i] * cos_i[i]
        T[i] = transmittance(n_i[i], n_t[i], cos_i[i], cos_t[i], s, p, 1.0 / (s * p))


def test_a_block_of_rays_passes_what_a_packet_does():
    draw = np.random.default_rng(4)
    n_i, n_t = draw.uniform(1.0, 3.0, (2, 2000))
    cos_i = draw.uniform(0.0, 1.0, 2000)
    _, passes, cos_t = np.array([bare(*row) for row in zip(n_i, n_t, cos_i, strict=True)]).T
    T = np.empty(2000)
    of_blocks(n_i, n_t, cos_i, cos_t, T)
    goes = passes > 0.0
    assert goes.sum() > 1000
    assert np.abs(T[goes] / passes[goes] - 1.0).max() < 8 * EPSILON


@inlined
def send(place, options, flow, frames, packet, refracts, x, y, z, dx, dy, dz, weight, key):
    """Keep the child at the station of the lens; `place` is the space that a refracted one goes to."""
    packet.space = place if refracts else 0
    put(flow, LENS, packet, packet.frame, x, y, z, dx, dy, dz, weight, key, 0.0)


split = splitter(send)


@kernel
def split_all(packets, frames, options, flow, reflectance, transmittance):
    for i in range(len(packets)):
        packet = packets[i]
        split(
            7, options, flow, frames, packet.frame, packet, 5, -1, 9, 1.0, 2.0, 3.0, reflectance, transmittance,
            (0.0, 0.0, -1.0), (0.0, 0.6, 0.8),
        )  # fmt: skip


@dataclass
class Children:
    """What came of some packets: the children, and everything that was written."""

    packets: NDArray[np.void]
    flow: Flow

    @property
    def refracted(self):
        return self.packets[self.packets["dz"] > 0.0]

    @property
    def reflected(self):
        return self.packets[self.packets["dz"] < 0.0]

    @property
    def gained(self):
        """What the book says was added to the packets' energy."""
        return self.flow.book[ROULETTE_ADDED] - self.flow.book[ROULETTE_REMOVED]


def children(count=1, reflectance=0.3, transmittance=0.7, frame=CAMERA_FRAME, path=0, record=False, **thinning):
    """Divide `count` packets of weight 2."""
    packets = np.zeros(count, PACKET)
    packets["weight"], packets["start"], packets["frame"], packets["path"], packets["events"] = (
        2.0,
        2.0,
        frame,
        path,
        3,
    )
    packets["medium"] = 4
    packets["node"], packets["source"] = 11, np.arange(count)
    packets["key"] = [descendant(1, 77, number) for number in range(count)]
    flow = Flow(
        stacks=np.zeros(2 * count * STATIONS, PACKET), begins=2 * count * np.arange(STATIONS),
        tops=np.zeros(TOPS, np.int64),
        book=np.zeros(len(FIXED)), counts=np.zeros(COUNTERS, np.int64), film=np.zeros((0, 1)),
        hits=np.zeros((0, 1), np.uint32), counted=np.zeros(0, np.uint8), deposits=np.zeros(0, DEPOSIT),
        ended=np.zeros(0, END), nodes=np.zeros(2 * count, NODE),
    )  # fmt: skip
    settings = Options(
        surface=0, faces=BY_MESH, thinning=Thinning(BOTH, 0.0, 0.0), max_events=64, adjoint=True, tracing=False,
        record=record, bounce=False, aimed=True, paths=EVERY, importance=True,
    )  # fmt: skip
    still = np.zeros((5, 5, 3, 4))
    still[:, :, range(3), range(3)] = 1.0
    split_all(packets, still, with_thinning(settings, **thinning), flow, reflectance, transmittance)
    assert flow.counts[EVENTS] == count
    return Children(flow.stacks[flow.begins[LENS] :][: flow.tops[LENS]].copy(), flow)


def test_both_children_go_on_with_their_shares():
    made = children()
    assert made.reflected["weight"] == [0.6]
    assert made.refracted["weight"] == [1.4]
    assert made.packets["weight"].sum() == 2.0
    assert (made.packets["events"] == 4).all()
    assert (made.packets["start"] == 2.0).all()
    assert made.reflected["space"] == [0]
    assert made.refracted["space"] == [7]
    assert made.refracted[["x", "y", "z", "dx", "dy", "dz"]].tolist() == [(1.0, 2.0, 3.0, 0.0, 0.6, 0.8)]


def test_in_object_space_the_refracted_child_goes_on_in_the_medium_beyond():
    made = children(frame=OBJECT_FRAME)
    assert made.reflected["medium"] == [4]
    assert made.refracted["medium"] == [9]


def test_the_refracted_child_keeps_the_key_and_the_reflected_one_has_its_own():
    made = children(count=50)
    before = np.array([descendant(1, 77, number) for number in range(50)])
    assert (made.refracted["key"] == before).all()
    assert (made.reflected["key"] == [derived(key, 4) for key in before]).all()
    assert len(np.unique(made.packets["key"])) == 100


IN_CAMERA = {
    IN_NO_GHOST: STRAY, ON_IMAGE_PATH: REFLECTED_ONCE, REFLECTED_ONCE: REFLECTED_TWICE, REFLECTED_TWICE: STRAY,
    STRAY: STRAY,
}  # fmt: skip
"""What a path becomes by a reflection at a face of lens or array."""


@pytest.mark.parametrize("path", IN_CAMERA)
@pytest.mark.parametrize("frame", [CAMERA_FRAME, MLA_FRAME, OBJECT_FRAME])
def test_a_reflection_turns_off_the_image_path_and_refraction_does_not(frame, path):
    made = children(frame=frame, path=path)
    assert made.reflected["path"] == [STRAY if frame == OBJECT_FRAME else IN_CAMERA[path]]
    assert made.refracted["path"] == [path]


@pytest.mark.parametrize("path", IN_CAMERA)
@pytest.mark.parametrize("frame", [CAMERA_FRAME, MLA_FRAME, OBJECT_FRAME])
def test_total_reflection_is_the_image_paths_own_way_in_object_space_only(frame, path):
    made = children(frame=frame, path=path, reflectance=1.0, transmittance=0.0)
    assert len(made.packets) == 1
    expected = {CAMERA_FRAME: IN_CAMERA[path], MLA_FRAME: IN_CAMERA[path], OBJECT_FRAME: path}
    assert made.reflected["path"] == [expected[frame]]


def test_every_child_has_a_vertex_of_its_own_from_its_parents():
    made = children(record=True)
    nodes = made.flow.nodes[: made.flow.tops[NODES]]
    assert nodes["event"].tolist() == [E_REFLECTED, E_TRANSMITTED]
    assert (nodes["parent"] == 11).all()
    assert (nodes["surface"] == 5).all()
    assert (nodes["beyond"] == 9).all()
    assert nodes["weight"].tolist() == [0.6, 1.4]
    assert nodes["position"].tolist() == [[1.0, 2.0, 3.0]] * 2
    assert made.reflected["node"] == [0]
    assert made.refracted["node"] == [1]


def test_transmit_follows_the_refracted_child_and_books_the_rest():
    made = children(split=TRANSMIT)
    assert made.packets["weight"].tolist() == [1.4]
    assert made.packets["dz"] > 0.0
    assert made.flow.book[UNFOLLOWED] == 0.6
    total = children(split=TRANSMIT, reflectance=1.0, transmittance=0.0)
    assert total.packets["weight"].tolist() == [2.0]
    assert total.packets["dz"] < 0.0


def test_roulette_takes_one_child_with_all_the_weight_as_often_as_its_share_says():
    count, share = 20_000, 0.3
    made = children(count=count, split=ROULETTE)
    assert len(made.packets) == count
    assert (made.packets["weight"] == 2.0).all()
    assert stats.binomtest(len(made.reflected), count, share).pvalue > LEVEL


def test_a_weight_window_keeps_the_light_in_the_mean_and_the_books_to_the_last_digit():
    # The reflected child of 0.2 is below the floor of 0.5, the refracted one of 1.8 above it.
    count = 20_000
    made = children(count=count, reflectance=0.1, transmittance=0.9, cutoff=0.25)
    assert len(made.refracted) == count
    assert (made.reflected["weight"] == 0.5).all()
    assert stats.binomtest(len(made.reflected), count, 0.4).pvalue > LEVEL
    assert made.packets["weight"].sum() == pytest.approx(2.0 * count + made.gained, rel=1e-13)


def world_with_everything():
    """Return a scene with lens, array and targets."""
    return lf.Scene(
        camera={
            "focus_mm": 300.0,
            "lens": {"surfaces": [
                {"stop": True, "thickness_mm": 1.0, "semi_diameter_mm": 4.0},
                {"radius_mm": 50.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 5.0},
                {"radius_mm": -50.0, "semi_diameter_mm": 5.0},
            ]},
            "mla": {"count": [4, 4], "pitch_mm": 0.5, "focal_length_mm": 2.6, "index": 1.5, "thickness_mm": 0.5},
            "sensor": {"pixels": [20, 20], "pixel_mm": 0.1},
        },
        targets=[{"shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 50.0}, "position_mm": [0, 0, -300.0]}],
        transport={"split": "transmit", "wavelengths_nm": [450.0, 650.0]},
    )  # fmt: skip


def test_every_surface_face_and_body_has_a_row_and_parameters_lie_one_after_another(monkeypatch):
    def numbered(scene, face, waves):
        own = 2 if face.where == "camera.lens.surfaces[2]" else 1
        return table.InterfaceKind(face.where, 0, tuple(tuple(100.0 * k + w for w in waves) for k in range(own)))

    monkeypatch.setattr(table, "_kind_and_parameters", numbered)
    found = interface_tables(world_with_everything(), (450.0, 650.0))
    # The stop refracts nothing.
    assert found.lens.rows["first"].tolist() == [0, 1]
    assert found.lens.parameters.tolist() == [[450.0, 650.0], [450.0, 650.0], [550.0, 750.0]]
    assert found.mla.rows["first"].tolist() == [0, 1]
    # The target once for air, once for the glass of lens and array.
    assert found.objects.rows["first"].tolist() == [0, 1]


@pytest.mark.parametrize("where", ["camera.lens.surfaces[2]", "camera.mla, its flat face"])
def test_the_sequential_engine_refuses_by_the_table_what_is_not_smooth(monkeypatch, where):
    scene = world_with_everything()
    assert choice.engine_of(scene)[0] == "sequential"
    monkeypatch.setattr(table, "_kind_of", lambda scene, face, waves: table.GROUND * (face.where == where))
    assert choice.engine_of(scene) == ("mesh", f"{where} is ground")
    with pytest.raises(SceneError, match=r"is ground; use"):
        choice.engine_of(scene.changed({"transport.engine": "sequential"}))


LAYERS = {
    "ar": [{"index": 1.38, "thickness_nm": 106.5}],
    "broad": [
        {"index": 1.38, "thickness_nm": 99.6},
        {"index": 2.05, "thickness_nm": 134.1},
        {"index": 1.62, "thickness_nm": 84.9},
    ],
    "dark": [{"index": 1.46, "thickness_nm": 80.0}, {"index": 2.9, "extinction": 3.1, "thickness_nm": 9.0}],
}
COATED = [(name, side, wave) for name in LAYERS for side in ("thin", "dense") for wave in (0, 1)]


def coated_scene(name, **more):
    """Return the scene with everything, with one coating on all its faces."""
    changes = {f"camera.lens.surfaces[{i}].coating": name for i in (1, 2)}
    changes |= {"camera.mla.curved_coating": name, "camera.mla.flat_coating": name}
    changes |= {"coatings": {key: {"layers": layers} for key, layers in LAYERS.items()} | more}
    return world_with_everything().changed(changes)


@pytest.mark.parametrize(("name", "side", "wave"), COATED)
def test_a_coated_surface_has_the_shares_of_its_layers(name, side, wave):
    scene = coated_scene(name)
    wavelengths = scene.transport.wavelengths_nm
    found = interface_tables(scene, wavelengths)
    layers = LAYERS[name]
    stack = Stack(
        tuple(complex(layer["index"], layer.get("extinction", 0.0)) for layer in layers),
        tuple(layer["thickness_nm"] for layer in layers),
    )
    n_i, n_t, seen = (1.0, 1.5, stack) if side == "thin" else (1.5, 1.0, stack.reversed)
    # Just beside the critical angle, too.
    critical = np.sqrt(1.0 - 1.0 / 1.5**2)
    cosines = np.concatenate([np.random.default_rng(8).uniform(0.0, 1.0, 500), critical + np.array([-1e-9, 1e-9])])
    R, T = coated(n_i, n_t, seen, wavelengths[wave], cosines)
    # The first surface meets its coating from the air, the second one from the glass: one name serves both.
    for table_, rows in ((found.lens, (0, 1)), (found.mla, (0, 1))):
        for row in rows:
            shown = np.array([shares(table_, row, wave, n_i, n_t, c, False) for c in cosines])
            np.testing.assert_allclose(shown[:, 0], R, rtol=0.0, atol=1e-7)
            np.testing.assert_allclose(shown[:, 1], T, rtol=0.0, atol=1e-7)
            bends = [fresnel(n_i, n_t, c)[2] for c in cosines]
            np.testing.assert_array_equal(shown[:, 2], bends)
    total = n_i * np.sqrt(1.0 - cosines**2) > n_t
    assert total.any() == (side == "dense")
    # What absorbs does so under total reflection, too.
    assert (R[total] < 1.0 - 1e-3).any() == (name == "dark" and side == "dense")


def test_a_coating_between_two_glasses_is_listed_from_the_object_to_the_sensor():
    surfaces = [
        {"radius_mm": 50.0, "thickness_mm": 3.0, "index": 1.7, "semi_diameter_mm": 5.0},
        {"thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 5.0, "coating": "two"},
        {"radius_mm": -50.0, "semi_diameter_mm": 5.0},
    ]
    two = [{"index": 2.0, "extinction": 0.5, "thickness_nm": 30.0}, {"index": 1.38, "thickness_nm": 90.0}]
    scene = lf.Scene(
        camera={
            "focus_mm": 300.0, "lens": {"surfaces": surfaces, "f_number": 8.0},
            "sensor": {"pixels": [20, 20], "pixel_mm": 0.1},
        },
        coatings={"two": {"layers": two}},
    )  # fmt: skip
    found = interface_tables(scene, (550.0,)).lens
    stack = Stack((2.0 + 0.5j, 1.38 + 0j), (30.0, 90.0))
    for n_i, n_t, seen in ((1.7, 1.5, stack), (1.5, 1.7, stack.reversed)):
        R, T = coated(n_i, n_t, seen, 550.0, np.array([0.8]))
        assert shares(found, 1, 0, n_i, n_t, 0.8, False)[:2] == pytest.approx((R[0], T[0]), abs=1e-7)
    wrong, _ = coated(1.7, 1.5, stack.reversed, 550.0, np.array([0.8]))
    assert abs(shares(found, 1, 0, 1.7, 1.5, 0.8, False)[0] - wrong[0]) > 1e-3


def test_a_fixed_reflectance_holds_at_every_angle_up_to_total_reflection():
    found = interface_tables(coated_scene("half", half={"reflectance": 0.5}), (450.0, 650.0)).lens
    for cosine in (1.0, 0.6, 0.1):
        assert shares(found, 0, 1, 1.0, 1.5, cosine, False)[:2] == (0.5, 0.5)
    assert shares(found, 0, 1, 1.5, 1.0, 0.9, False)[:2] == (0.5, 0.5)
    assert shares(found, 0, 1, 1.5, 1.0, 0.6, False) == (1.0, 0.0, 0.0)


def random_coating(draw):
    """Layers of a random coating on glass; one in three may absorb."""
    absorbs = draw.random() < 0.3
    return [
        {
            "index": draw.uniform(1.2, 2.6), "thickness_nm": draw.uniform(5.0, 250.0),
            "extinction": draw.uniform(0.0, 4.0) if absorbs and draw.random() < 0.5 else 0.0,
        }
        for _ in range(draw.integers(1, 8))
    ]  # fmt: skip


def largest_error(count, seed):
    """Return the largest error of the tables of random coatings at random angles, and the largest that one states."""
    draw = np.random.default_rng(seed)
    worst = stated = 0.0
    for _ in range(count):
        layers, n, wavelength = random_coating(draw), draw.uniform(1.4, 2.0), draw.uniform(380.0, 1000.0)
        scene = world_with_everything().changed(
            {"camera.mla.index": n, "camera.mla.flat_coating": "x", "coatings": {"x": {"layers": layers}}}
        )
        found = interface_tables(scene, (wavelength,)).mla
        stated = max(stated, coating_errors(scene)["x"])
        stack = Stack(
            tuple(complex(layer["index"], layer["extinction"]) for layer in layers),
            tuple(layer["thickness_nm"] for layer in layers),
        )
        cosines = draw.uniform(0.0, 1.0, 40) ** draw.integers(1, 4)
        for n_i, n_t, seen in ((1.0, n, stack), (n, 1.0, stack.reversed)):
            truth = np.transpose(coated(n_i, n_t, seen, wavelength, cosines))
            shown = [shares(found, FLAT_ROW, 0, n_i, n_t, c, False)[:2] for c in cosines]
            worst = max(worst, np.abs(shown - truth).max())
    return worst, stated


def test_tables_of_random_coatings_are_right_to_a_millionth():
    worst, stated = largest_error(12, seed=1)
    assert stated < 1e-6
    assert worst < 1e-6


@pytest.mark.long
def test_tables_of_a_thousand_random_coatings_are_right_to_a_millionth():
    worst, stated = largest_error(1000, seed=2)
    assert stated < 1e-6
    assert worst < 1e-6


def test_a_stack_too_thick_for_a_table_is_refused():
    thick = {"layers": [{"index": 2.0, "thickness_nm": 3e7}]}
    with pytest.raises(SceneError, match=r"coatings\.thick: its reflectance changes too fast"):
        interface_tables(coated_scene("thick", thick=thick), (550.0,))


def test_a_measured_table_is_followed_and_refused_beyond_its_wavelengths(tmp_path):
    angles = np.arange(0.0, 91.0, 5.0)
    rows = [(w, a, 1.0 if a == 90.0 else 0.01 + 0.9 * (a / 90.0) ** 4) for w in (400.0, 700.0) for a in angles.tolist()]
    path = tmp_path / "r.csv"
    path.write_text("wavelength_nm,angle_deg,reflectance\n" + "\n".join(f"{w},{a},{r!r}" for w, a, r in rows))
    scene = coated_scene("measured", measured={"table": str(path)})
    found = interface_tables(scene, (450.0, 650.0)).lens
    measured = read_reflectance(path)
    cosines = np.random.default_rng(1).uniform(0.0, 1.0, 200)
    for wave, wavelength in enumerate((450.0, 650.0)):
        shown = [shares(found, 0, wave, 1.0, 1.5, c, False)[0] for c in cosines]
        np.testing.assert_allclose(shown, measured.at(wavelength, cosines), rtol=0.0, atol=1e-6)
    # From the glass, the angle in the air behind it counts.
    cos_i = 0.9
    cos_t = np.sqrt(1.0 - 2.25 * (1.0 - cos_i**2))
    assert shares(found, 0, 0, 1.5, 1.0, cos_i, False)[0] == pytest.approx(
        measured.at(450.0, np.array([cos_t]))[0], abs=1e-6
    )
    with pytest.raises(SceneError, match=r"table: it extends from 400 to 700 nm, but the scene has 750 nm"):
        interface_tables(scene, (750.0,))


def test_a_changed_file_is_read_again(tmp_path):
    path = tmp_path / "r.csv"
    scene = coated_scene("measured", measured={"table": str(path)}) if path.write_text("") == 0 else None
    for value in (0.1, 0.2):
        rows = [f"{w},{a},{1.0 if a == 90 else value}" for w in (400, 700) for a in (0, 85, 90)]
        path.write_text("\n".join(["wavelength_nm,angle_deg,reflectance", *rows]))
        assert shares(interface_tables(scene, (500.0,)).lens, 0, 0, 1.0, 1.5, 1.0, False)[0] == pytest.approx(
            value, abs=1e-7
        )


@pytest.mark.parametrize("coating", ["broad", "dark"])
def test_the_sequential_engine_takes_coatings_that_absorb_too(coating):
    assert choice.engine_of(coated_scene(coating))[0] == "sequential"


def measured_file(path, wavelengths, angles, values):
    rows = [f"{w},{a!r},{r!r}" for w in wavelengths for a, r in zip(angles.tolist(), values.tolist(), strict=True)]
    path.write_text("\n".join(["wavelength_nm,angle_deg,reflectance", *rows]))
    return {"table": str(path)}


def test_a_measured_table_with_noise_at_many_angles_is_followed_to_a_thousandth(tmp_path):
    draw = np.random.default_rng(4)
    angles = np.arange(0.0, 90.5, 1.0)
    noisy = np.clip(0.02 + 0.9 * (angles / 90.0) ** 6 + 1e-3 * draw.normal(size=len(angles)), 0.0, 1.0)
    noisy[-1] = 1.0
    table = measured_file(tmp_path / "noisy.csv", (400.0, 700.0), angles, noisy)
    found = interface_tables(coated_scene("noisy", noisy=table), (550.0,)).lens
    row, u = found.rows[0], np.sqrt(np.cos(np.radians(angles[:-1])))
    values = [looked_up(found.parameters, row["first"], row["pieces"], 0, each) for each in u]
    np.testing.assert_allclose(values, noisy[:-1], atol=1e-3)


def test_a_measured_table_that_jumps_from_angle_to_angle_is_refused(tmp_path):
    angles = np.append(np.linspace(0.0, 0.05, 52), 90.0)
    table = measured_file(tmp_path / "jumps.csv", (550.0,), angles, np.append(np.tile([0.2, 0.8], 26), 1.0))
    with pytest.raises(SceneError, match=r"coatings\.jumps\.table: its reflectance changes too fast between angles"):
        interface_tables(coated_scene("jumps", jumps=table), (550.0,))
