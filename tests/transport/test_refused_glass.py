"""Glass that cannot be traced is refused in one line; glass that can be, is not."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.geometry.meshes.mesh import Mesh
from lfmesh.geometry.objects.targets import target_mesh
from lfmesh.transport.refused_glass import cut, cut_bodies
from tests.cameras import camera_without_array

CAMERA = camera_without_array(100.0, 8, 0.5)
PLACE = (0.0, 0.0, -100.0)

Body = Callable[..., dict[str, Any]]


@pytest.fixture
def glass(tmp_path: Path) -> Body:
    """Return what makes a target of glass from meshes, at a place."""
    made: list[dict[str, Any]] = []

    def body(
        *parts: trimesh.Trimesh, at: tuple[float, float, float] = PLACE, surface: str = "flat", priority: int = 0
    ) -> dict[str, Any]:
        path = tmp_path / f"{len(made)}.stl"
        trimesh.util.concatenate(parts).export(path)
        own = {"file": str(path), "units": "mm", "index": 1.5, "surface": surface, "priority": priority}
        made.append({"refractor": own, "position_mm": at})
        return made[-1]

    return body


def ball(radius: float = 8.0, at: tuple[float, float, float] = (0.0, 0.0, 0.0), inwards: bool = False) -> Any:
    """A ball of 320 facets."""
    mesh = trimesh.creation.icosphere(2, radius)
    mesh.apply_translation(at)
    if inwards:
        mesh.invert()
    return mesh


def cube(at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Any:
    """A cube of 10 mm."""
    mesh = trimesh.creation.box((10.0, 10.0, 10.0))
    mesh.apply_translation(at)
    return mesh


LAMP: dict[str, Any] = {"kind": "point", "position_mm": [40.0, 40.0, -40.0], "power_w": 1.0}
EMITTER: dict[str, Any] = {
    "shape": {"kind": "sphere", "radius_mm": 2.0},
    "position_mm": list(PLACE),
    "material": {"radiance_w_m2_sr": 10.0},
}


def scene(*targets: dict[str, Any], lights: tuple[dict[str, Any], ...] = (LAMP,), **transport: Any) -> lf.Scene:
    """The camera in front of targets."""
    return lf.Scene(camera=CAMERA, targets=list(targets), lights=list(lights), transport=transport)


def refused(of: lf.Scene) -> str:
    """Return the one line with which a scene is refused."""
    with pytest.raises(SceneError) as raised:
        lf.build(of)
    assert "\n" not in str(raised.value)
    return str(raised.value)


def test_glass_round_the_camera_is_refused(glass: Body) -> None:
    said = refused(scene(glass(ball(300.0), at=(0.0, 0.0, 0.0))))
    assert said.startswith("targets[0] (")
    assert "the camera's first surface lies inside this glass" in said


def test_glass_that_reaches_over_the_front_vertex_is_refused(glass: Body) -> None:
    """The vertex of a convex front stands out beyond its rim, which is as far as the housing reaches."""
    assert "first surface lies inside" in refused(scene(glass(ball(30.0), at=(0.0, 0.0, -29.8))))
    lf.build(scene(glass(ball(30.0), at=(0.0, 0.0, -30.2))))


def test_a_camera_in_a_hollow_is_not_refused(glass: Body) -> None:
    lf.build(scene(glass(ball(300.0), ball(280.0, inwards=True), at=(0.0, 0.0, 0.0))))


@pytest.mark.parametrize("method", ["adjoint", "forward"])
@pytest.mark.parametrize(
    "lamp",
    [LAMP, {**LAMP, "kind": "disk", "direction": [-1, -1, -1], "radius_mm": 3.0, "position_mm": [40.0, 40.0, -30.0]}],
)
def test_glass_round_a_lamp_is_refused(glass: Body, lamp: dict[str, Any], method: str) -> None:
    """The disk's middle is outside; its rim is inside."""
    said = refused(scene(glass(ball(), at=(40.0, 40.0, -38.5)), lights=(lamp,), method=method))
    assert said.startswith(f"lights[0].position_mm = {lamp['position_mm']}")
    assert "lies inside targets[0]" in said
    lf.build(scene(glass(ball(), at=(40.0, 40.0, -55.0)), lights=(lamp,), method=method))


TUBE = {"kind": "line", "start_mm": [20.0, 40.0, -30.0], "end_mm": [60.0, 40.0, -30.0], "power_w": 1.0}
PANEL = {"kind": "rectangle", "position_mm": [40.0, 40.0, -30.0], "direction": [0.0, 0.0, 1.0], "width_mm": 40.0,
         "height_mm": 1e-3, "power_w": 1.0}  # fmt: skip
WIDE = PANEL | {"height_mm": 40.0}
FLAT = {"kind": "disk", "position_mm": [40.0, 40.0, -30.0], "direction": [0.0, 0.0, 1.0], "radius_mm": 20.0,
        "power_w": 1.0}  # fmt: skip


@pytest.mark.parametrize("lamp", [TUBE, PANEL, WIDE, FLAT], ids=["tube", "narrow panel", "panel", "disk"])
def test_glass_round_any_part_of_a_lamp_is_refused(glass: Body, lamp: dict[str, Any]) -> None:
    """A ball much smaller than the lamp, between its middle and its rim; beside it, or on it, the lamp is in air."""
    for place in ((53.7, 40.0, -30.0), (27.1, 40.0, -30.9)):
        assert "lies inside" in refused(scene(glass(ball(1.0), at=place), lights=(lamp,)))
    for place in ((53.7, 40.0, -28.9), (40.0, 40.0, -31.2), (61.1, 40.0, -30.0), (90.0, 40.0, -30.0)):
        lf.build(scene(glass(ball(1.0), at=place), lights=(lamp,)))


def test_a_lamp_on_a_face_of_glass_is_in_air(glass: Body) -> None:
    """A tube along a face of a cube from outside, and a panel whose edge touches one."""
    block = glass(cube(), at=(40.0, 40.0, -40.0))
    half = float(np.ptp(cube().vertices[:, 0])) / 2.0
    beside = PANEL | {"position_mm": [40.0 + half + 20.0, 40.0, -40.0]}
    lf.build(scene(block, lights=(beside,)))
    assert "lies inside" in refused(scene(block, lights=(beside | {"width_mm": 41.0},)))


def test_a_lamp_in_a_hollow_is_not_refused(glass: Body) -> None:
    lf.build(scene(glass(ball(), ball(6.0, inwards=True), at=(40.0, 40.0, -40.0))))


def test_both_methods_take_what_emits_in_glass_and_across_its_faces(glass: Body) -> None:
    """The forward method looks for the bodies round a starting point only where there may be any."""
    for place, inside in ((PLACE, True), ((7.3, 0.4, -100.2), True), ((12.0, 0.0, -100.0), False)):
        emitter = {**EMITTER, "position_mm": list(place)}
        lf.build(scene(glass(ball()), emitter, method="adjoint"))
        tables = lf.build(scene(glass(ball()), emitter, method="forward")).tables.objects
        np.testing.assert_array_equal(tables.glass.emits_inside, [False, inside])


@pytest.mark.parametrize("step", [(0.0, 0.0, 0.0), (8.0, 0.0, 0.0), (3.1, 2.2, 1.4), (15.0, 0.3, 0.2)])
def test_glass_bodies_that_overlap_need_a_priority(glass: Body, step: tuple[float, float, float]) -> None:
    """In general position, as mirror images that meet vertex on vertex, and all of one in the other."""
    where = tuple(np.add(PLACE, step))
    said = refused(scene(glass(ball(), priority=3), glass(ball(), at=where, priority=3)))
    assert "targets[0]" in said
    assert "targets[1]" in said
    assert "both have priority = 3" in said
    for low, high in ((-1, 0), (4, 2)):
        world = lf.build(scene(glass(ball(), priority=low), glass(ball(), at=where, priority=high)))
        assert world.tables.objects.rank.tolist() == ([1, 2] if low < high else [2, 1])


def test_of_bodies_in_each_other_the_inner_one_has_the_higher_rank(glass: Body) -> None:
    outer, middle, inner = glass(ball(9.0)), glass(ball(6.0)), glass(ball(3.0, at=(1.0, 1.0, 0.0)))
    for order in ((outer, middle, inner), (inner, outer, middle), (middle, inner, outer)):
        rank = lf.build(scene(*order)).tables.objects.rank
        assert [int(rank[order.index(body)]) for body in (outer, middle, inner)] == [1, 2, 3]
    within = glass(cube(), at=PLACE), glass(cube((0.0, 0.0, 30.0)), priority=-5)
    assert lf.build(scene(*within, glass(ball(20.0), priority=-5))).tables.objects.rank[0] == 3


def test_a_body_that_shares_a_face_with_the_one_round_it_lies_inside_it(glass: Body) -> None:
    wide = trimesh.creation.box((20.0, 20.0, 10.0))
    assert lf.build(scene(glass(cube()), glass(wide))).tables.objects.rank.tolist() == [2, 1]
    assert lf.build(scene(glass(wide), glass(cube()))).tables.objects.rank.tolist() == [1, 2]


def test_glass_may_lie_three_deep_in_other_glass_and_no_deeper(glass: Body) -> None:
    shells = [glass(ball(radius)) for radius in (9.0, 8.0, 7.0, 6.0)]
    lf.build(scene(*shells))
    assert "targets[4]" in (said := refused(scene(*shells, glass(ball(5.0)))))
    assert "lies inside 4 other glass bodies" in said
    assert "the limit is 3" in said


@pytest.mark.parametrize("priorities", [(0, 1, 2, 3, 4), (0, -1, -2, -3, -4), (0, 0, 1, 1, 2)])
def test_priorities_make_no_room_for_a_fifth_body_in_one_place(glass: Body, priorities: tuple[int, ...]) -> None:
    nested = [glass(ball(9.0 - i), priority=priority) for i, priority in enumerate(priorities)]
    lf.build(scene(*nested[1:]))
    assert "lies inside 4 other glass bodies" in refused(scene(*nested))


def test_a_fifth_body_that_overlaps_four_in_one_place_is_refused(glass: Body) -> None:
    along = [glass(cube((1.5 * i, 0.7 * i, 0.0)), priority=i) for i in range(5)]
    lf.build(scene(*along[:4]))
    assert "lies inside 4 other glass bodies" in refused(scene(*along))


def plate(z: float, x: float = 0.0, width: float = 6.0) -> dict[str, Any]:
    """An opaque square, so far before or behind the middle of the glass."""
    shape = {"kind": "plane", "width_mm": width, "height_mm": width}
    return {"shape": shape, "position_mm": [x, 0.0, PLACE[2] + z], "material": {"radiance_w_m2_sr": 1.0}}


@pytest.mark.parametrize("face", [-5.0, 5.0])
@pytest.mark.parametrize("apart", [0.0, 1e-7, -1e-7, 1e-6, -1e-6, 1e-5, -1e-5])
def test_what_lies_on_a_face_of_glass_is_refused(glass: Body, face: float, apart: float) -> None:
    said = refused(scene(glass(cube()), plate(face + apart)))
    assert said.startswith("targets[1] lies on the glass of targets[0]")
    assert "mm or more between them" in said


def test_a_block_that_shares_a_face_with_glass_is_refused(glass: Body) -> None:
    shape = {"kind": "box", "size_mm": [10.0, 10.0, 10.0]}
    block = {"shape": shape, "position_mm": [PLACE[0], PLACE[1], PLACE[2] - 10.0]}
    assert "targets[1] lies on the glass of targets[0]" in refused(scene(glass(cube()), block))
    assert "targets[1] lies on the glass of targets[0]" in refused(scene(glass(cube()), block | {"position_mm": PLACE}))


@pytest.mark.parametrize("face", [-5.0, 5.0])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_as_far_from_a_face_as_advised_every_ray_meets_a_target(glass: Body, face: float, side: float) -> None:
    said = refused(scene(glass(cube()), plate(face)))
    advised = float(said.split("leave ")[1].split(" mm")[0])
    world = lf.build(scene(glass(cube()), plate(face + side * advised, width=9.0)))
    across = np.random.default_rng(3).uniform(-1.5, 1.5, (500, 2))
    starts = np.column_stack([across, np.full(len(across), -60.0)])
    paths = lf.trace(world, starts, np.tile([0.05, -0.03, -1.0], (len(starts), 1)), split="transmit")
    assert (paths.status == lf.Status.TARGET).all()


def test_targets_beside_a_face_of_glass_in_its_plane_are_not_on_it(glass: Body) -> None:
    lf.build(scene(glass(cube()), plate(5.0, x=8.0), plate(-5.0, x=-8.0)))


def test_a_body_in_the_hollow_of_another_is_not_in_its_glass(glass: Body) -> None:
    world = lf.build(scene(glass(ball(), ball(6.0, inwards=True)), glass(ball(4.0)), glass(ball(3.0))))
    assert world.tables.objects.rank[2] > world.tables.objects.rank[1]


@pytest.mark.parametrize("aside", [0.0, 3.0])
def test_bodies_that_touch_are_not_refused(glass: Body, aside: float) -> None:
    lf.build(scene(glass(cube()), glass(cube(), at=(aside, 0.5 * aside, -110.0))))


@pytest.mark.parametrize("step", [(8.3, 8.1, 8.2), (8.0, 0.0, 0.0)])
def test_a_surface_that_cuts_itself_is_refused(glass: Body, step: tuple[float, float, float]) -> None:
    """Two cubes in one file that share a corner's worth, and two that share most of their length."""
    said = refused(scene(glass(cube(), cube(step))))
    assert said.startswith("targets[0] (")
    assert "cut" in said
    lf.build(scene(glass(cube(), cube((10.5, 0.0, 0.0)))))


def test_a_hollow_must_face_into_itself(glass: Body) -> None:
    lf.build(scene(glass(ball(), ball(5.0, inwards=True))))
    assert "its surface does not have glass behind it and air in front" in refused(scene(glass(ball(), ball(5.0))))


def test_five_rods_through_one_place_are_refused_though_no_middle_of_a_facet_is_there() -> None:
    """Each of another priority, so that they may cut each other; four of them may."""
    rods = [
        {"refractor": {"box_mm": [60.0, 1.0, 1.0], "index": 1.5, "priority": i}, "position_mm": list(PLACE),
         "rotation_deg": [0.0, 0.0, 36.0 * i]}
        for i in range(5)
    ]  # fmt: skip
    assert "lies inside 4 other glass bodies" in refused(scene(*rods))
    lf.build(scene(*rods[:4]))


def test_curved_bodies_that_cut_each_other_are_named_however_little_they_do(glass: Body) -> None:
    """A corner of one pokes through the side of a facet of the other, where no middle of a facet is near."""
    coarse = trimesh.creation.icosphere(1, 8.0)
    corner = coarse.vertices[0] / 8.0
    facet = coarse.vertices[coarse.faces[7]]
    met = np.array([0.6, 0.2, 0.2]) @ facet
    other = coarse.copy()
    normal = np.cross(facet[1] - facet[0], facet[2] - facet[0])
    other.apply_transform(trimesh.geometry.align_vectors(corner, -normal / np.linalg.norm(normal)))
    for depth_mm, named in ((0.1, 1), (-0.1, 0)):
        away = met + (8.0 - depth_mm) * normal / np.linalg.norm(normal)
        bodies = (
            glass(coarse, surface="smooth"),
            glass(other, at=tuple(np.add(PLACE, away)), surface="smooth", priority=1),
        )
        both = scene(*bodies)
        assert len(cut_bodies(both, [target_mesh(target, both) for target in both.targets])) == named


def test_cuts_are_found_wherever_two_tetrahedra_truly_cut() -> None:
    """Against the separating axis theorem: normals of faces and products of edges tell convex bodies apart."""
    draw = np.random.default_rng(4)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    seen = {False: 0, True: 0}
    for _ in range(300):
        a, b = draw.normal(size=(4, 3)), draw.normal(size=(4, 3)) + draw.normal(size=3)
        edges = np.array([v[i] - v[j] for v in (a, b) for i in range(4) for j in range(i)])
        axes = np.cross(edges[:, None], edges[None]).reshape(-1, 3)
        axes = axes[np.abs(axes).max(axis=1) > 1e-9]
        p, q = axes @ a.T, axes @ b.T
        apart = ((p.max(axis=1) < q.min(axis=1)) | (q.max(axis=1) < p.min(axis=1))).any()
        mesh = Mesh(np.concatenate([a, b]), np.concatenate([faces, faces + 4]))
        owner, size = np.repeat([0, 1], 4), np.full(8, 1.0)
        found = cut(mesh, owner, size)
        if apart:
            assert found is None
        elif found is None:
            # The one that is left: all of one lies in the other.
            assert contains(a, b) or contains(b, a)
        seen[found is not None] += 1
    assert min(seen.values()) > 50


def contains(outer: np.ndarray, inner: np.ndarray) -> bool:
    """Tell whether a tetrahedron holds all corners of another, by barycentric coordinates."""
    weights = np.linalg.solve(np.vstack([outer.T, np.ones(4)]), np.vstack([inner.T, np.ones(4)]))
    return bool((weights > 0.0).all())
