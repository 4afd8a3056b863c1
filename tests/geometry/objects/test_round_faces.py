"""Rays meet spheres, cylinders and disks themselves: against plain formulas, without a tree, of every face alone."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image as Picture
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.geometry.frame import IDENTITY, frame, inverse, points
from lfmesh.geometry.meshes.mesh import distance_mm, facet_normals
from lfmesh.geometry.objects.primitives import primitive
from lfmesh.geometry.objects.round_body import RoundBody
from lfmesh.geometry.objects.round_faces import (
    FLAT,
    SPHERE,
    RoundFaces,
    first_round,
    parameters_at,
    place_in_picture,
    places_in_picture,
    point_at,
    round_faces,
    round_normal,
)
from lfmesh.geometry.objects.targets import target_body, target_mesh
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import kernel
from lfmesh.scene import Cylinder, Disk, Sphere
from tests.cameras import camera_without_array

Array = NDArray[np.float64]

LEVEL = 1e-3
"""Chance that a test of random numbers fails though all is right."""

WHOLE = np.array([[0.0, 0.0], [1.0, 1.0]])
SHAPES: dict[str, Sphere | Cylinder | Disk] = {
    "sphere": Sphere(radius_mm=2.0),
    "cylinder": Cylinder(radius_mm=1.5, height_mm=4.0),
    "disk": Disk(radius_mm=2.5),
}


def body(kind: str, tilt: Any = (20.0, -30.0, 40.0), place: Any = (5.0, -7.0, -300.0)) -> RoundBody:
    return RoundBody(SHAPES[kind], frame(tilt, place), WHOLE)


def many(count: int) -> list[RoundBody]:
    draw = np.random.default_rng(64)
    kinds = list(SHAPES)
    return [
        body(kinds[i % 3], draw.uniform(-180, 180, 3), draw.uniform(-30, 30, 3) - [0, 0, 300.0]) for i in range(count)
    ]


@kernel
def meet(rounds: RoundFaces, starts: Array, ways: Array, left: NDArray[np.int64], found: Array) -> None:
    for i in range(len(starts)):
        ray = Ray(starts[i, 0], starts[i, 1], starts[i, 2], ways[i, 0], ways[i, 1], ways[i, 2])
        found[i, 0], found[i, 1], found[i, 2] = first_round(rounds, None, ray, left[i], np.inf)


@kernel
def draw_on(rounds: RoundFaces, number: int, shares: Array, found: Array) -> None:
    """Write points of a face by their parameters, those again, the normals, and the places in the picture."""
    face = rounds.faces[number]
    for i in range(len(shares)):
        x, y, z = point_at(face, shares[i, 0], shares[i, 1])
        found[i, 0], found[i, 1], found[i, 2] = x, y, z
        found[i, 3], found[i, 4] = parameters_at(face, x, y, z)
        found[i, 5], found[i, 6], found[i, 7] = round_normal(face, x, y, z)
        found[i, 8], found[i, 9] = place_in_picture(face, x, y, z)


def met(rounds: RoundFaces, starts: Array, ways: Array, left: Any = -1) -> Array:
    found = np.empty((len(starts), 3))
    meet(rounds, starts, ways, np.broadcast_to(np.int64(left), len(starts)).copy(), found)
    return found


def in_tree(bodies: list[RoundBody]) -> RoundFaces:
    rounds = round_faces([each.faces() for each in bodies], IDENTITY, 7)
    assert rounds is not None
    return rounds


def rays(count: int, seed: int) -> tuple[Array, Array]:
    """From anywhere, inside the bodies too, towards where the bodies are."""
    draw = np.random.default_rng(seed)
    starts = draw.uniform(-40, 40, (count, 3)) - [0, 0, 300.0]
    ways = draw.uniform(-30, 30, (count, 3)) - [0, 0, 300.0] - starts
    return starts, ways / np.linalg.norm(ways, axis=1, keepdims=True)


def by_formulas(face: Any, starts: Array, ways: Array) -> Array:
    """Distances at which rays meet a face by the quadratic formula; inf where they do not."""
    own = np.column_stack([face["axes"].T, face["centre"]])
    p, d = points(inverse(own), starts), ways @ own[:, :3]
    t = np.full((2, len(starts)), np.inf)
    if face["kind"] == FLAT:
        t[0] = -p[:, 2] / d[:, 2]
    else:
        axes = 3 if face["kind"] == SPHERE else 2
        a, b = (d[:, :axes] ** 2).sum(axis=1), (p * d)[:, :axes].sum(axis=1)
        room = b**2 - a * ((p[:, :axes] ** 2).sum(axis=1) - face["radius"] ** 2)
        with np.errstate(invalid="ignore"):
            t = np.stack([(-b - np.sqrt(room)) / a, (-b + np.sqrt(room)) / a])
    at = p + t[..., None] * d
    inside = np.isfinite(t) & (t > 0.0)
    if face["kind"] == FLAT:
        inside &= np.hypot(at[..., 0], at[..., 1]) <= face["radius"]
    elif face["kind"] != SPHERE:
        inside &= np.abs(at[..., 2]) <= face["half"]
    return np.where(inside, t, np.inf).min(axis=0)


@pytest.mark.parametrize("count", [1, 2, 3, 200])
def test_the_first_of_many_faces_is_that_of_all_their_formulas(count: int) -> None:
    rounds = in_tree(many(count))
    starts, ways = rays(20_000, count)
    found = met(rounds, starts, ways)
    truth = np.stack([by_formulas(face, starts, ways) for face in rounds.faces])
    meets = np.isfinite(truth.min(axis=0))
    # A ray may pass an outline to rounding: none of so few does.
    np.testing.assert_array_equal(found[:, 0] >= 0, meets)
    np.testing.assert_array_equal(found[meets, 0], truth.argmin(axis=0)[meets])
    np.testing.assert_allclose(found[meets, 1], truth.min(axis=0)[meets], rtol=1e-9)
    assert meets.sum() > 20


@pytest.mark.parametrize("kind", SHAPES)
def test_hits_lie_on_the_surface_and_its_normal_turns_to_rays_from_outside(kind: str) -> None:
    rounds = in_tree([body(kind)])
    draw = np.random.default_rng(5)
    starts = np.array([5.0, -7.0, -300.0]) + 1e3 * draw.normal(size=(2_000, 3))
    aims = np.array([5.0, -7.0, -300.0]) + draw.uniform(-1, 1, (2_000, 3))
    ways = (aims - starts) / np.linalg.norm(aims - starts, axis=1, keepdims=True)
    found = met(rounds, starts, ways)
    hit = found[:, 0] >= 0
    assert hit.sum() > 500
    own = points(inverse(body(kind).place), starts[hit] + found[hit, 1:2] * ways[hit])
    r, z = np.hypot(own[:, 0], own[:, 1]), own[:, 2]
    off = {
        "sphere": np.hypot(r, z) - 2.0,
        "disk": np.hypot(np.maximum(r - 2.5, 0.0), z),
        "cylinder": np.maximum(r - 1.5, np.abs(z) - 2.0),
    }[kind]
    assert np.abs(off).max() < 1e-12 * 1e3
    assert (found[hit, 2] < 0.0).all() or kind == "disk"


@pytest.mark.parametrize("kind", SHAPES)
def test_a_ray_that_leaves_a_face_outwards_never_meets_it_again_and_one_inwards_meets_the_far_side(kind: str) -> None:
    rounds = in_tree([body(kind)])
    draw = np.random.default_rng(9)
    for number, face in enumerate(rounds.faces):
        on = np.empty((5_000, 10))
        draw_on(rounds, number, draw.random((len(on), 2)), on)
        ways = draw.normal(size=(len(on), 3))
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        outwards = np.einsum("ij,ij->i", ways, on[:, 5:8]) > 0.0
        found = met(rounds, on[:, :3], ways, number)
        assert (found[outwards, 0] == -1).all()
        if kind == "sphere":
            chord = -2.0 * np.einsum("ij,ij->i", ways, on[:, 5:8]) * face["radius"]
            np.testing.assert_allclose(found[~outwards, 1], chord[~outwards], rtol=1e-9, atol=1e-12)
        elif kind == "cylinder":
            assert (found[~outwards, 0] >= 0).all()


@pytest.mark.parametrize("kind", SHAPES)
def test_parameters_spread_points_evenly_and_tell_the_place_of_the_picture(kind: str) -> None:
    """Chi-square of the areas between heights and azimuths of each face; places in the picture as those of the mesh."""
    own = body(kind, (0, 0, 0), (0, 0, 0))
    rounds, drawn = in_tree([own]), np.random.default_rng(3).random((40_000, 2))
    assert rounds.faces["area"].sum() == pytest.approx(facet_normals(primitive(SHAPES[kind]).mesh)[1].sum(), rel=2e-3)
    for number, face in enumerate(rounds.faces):
        on = np.empty((len(drawn), 10))
        draw_on(rounds, number, drawn, on)
        np.testing.assert_allclose(on[:, 3:5], drawn, atol=1e-7)
        np.testing.assert_allclose(on[:, 8:10], places_in_picture(face, *drawn.T), atol=1e-7)
        x, y, z = on[:, :3].T
        evenly = {SPHERE: (z / 2.0 + 1.0) / 2.0, FLAT: (x * x + y * y) / face["radius"] ** 2}
        share = evenly.get(int(face["kind"]), z / 4.0 + 0.5)
        turn = np.arctan2(y, x) / (2.0 * np.pi) + 0.5
        count = np.histogram2d(share, turn, 8, [[0, 1], [0, 1]])[0]
        assert stats.chisquare(count.ravel()).pvalue > LEVEL
    mesh, uv = primitive(SHAPES[kind])
    assert uv is not None
    corners, normals = mesh.vertices[mesh.faces], facet_normals(mesh)[0]
    middles = corners.mean(axis=1)
    found = met(rounds, middles + 0.1 * normals, -normals)
    for number in range(len(rounds.faces)):
        mine = found[:, 0] == number
        place = np.array([_place(rounds, number, *point) for point in middles[mine][::37]])
        # Facets lie 1.5° beside the middle of the arc over them at most; at the poles they share one point.
        away = np.ptp(uv[mine][::37, :, 0], axis=1) < 0.05
        off = place - uv[mine].mean(axis=1)[::37]
        assert np.abs(off[away]).max() < 5e-3


@kernel
def _place(rounds: RoundFaces, number: int, x: float, y: float, z: float) -> tuple[float, float]:
    return place_in_picture(rounds.faces[number], x, y, z)


def test_bodies_know_their_boxes_distances_and_insides_from_points_of_their_surface() -> None:
    draw = np.random.default_rng(8)
    for kind in SHAPES:
        own = body(kind)
        mesh = own.meshed().mesh
        hull, box = own.hull(), own.box_mm()
        assert (mesh.vertices >= box[0] - 1e-9).all()
        assert (mesh.vertices <= box[1] + 1e-9).all()
        np.testing.assert_allclose([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], box, atol=2e-2)
        if kind != "disk":
            height = np.einsum(
                "fk,vfk->vf", facet_normals(hull)[0], mesh.vertices[:, None] - hull.vertices[hull.faces[:, 0]]
            )
            assert height.max() <= 1e-12 * 300.0
        assert len(hull.faces) < 600
        for _ in range(20):
            point = own.place[:, 3] + draw.uniform(-4, 4, 3)
            away = np.linalg.norm(mesh.vertices - point, axis=1)
            assert own.farthest_mm(point) == pytest.approx(away.max(), rel=1e-2)
            # Chords of 3° leave 7e-4 of the radius.
            near = distance_mm(mesh.vertices[mesh.faces], point)
            assert own.distance_mm(point) == pytest.approx(near, abs=7e-4 * 2.5)
            local = points(inverse(own.place), point)
            r, z = np.hypot(local[0], local[1]), abs(local[2])
            inside = {"sphere": np.hypot(r, z) < 2.0, "cylinder": r < 1.5 and z < 2.0, "disk": False}[kind]
            assert own.holds(point) == inside


@pytest.mark.parametrize("kind", SHAPES)
def test_a_picture_lies_on_a_round_target_as_on_its_mesh(kind: str) -> None:
    material = {"texture": str(asset_path("charts/chart.png"))}
    scene = lf.Scene(
        camera=camera_without_array(), targets=[{"shape": SHAPES[kind].model_dump(), "material": material}]
    )
    exact, meshed = target_body(scene.targets[0], scene), target_mesh(scene.targets[0], scene)
    assert exact.round is not None
    assert meshed.round is None
    np.testing.assert_array_equal(exact.texture, meshed.texture)
    np.testing.assert_allclose(exact.uv, meshed.uv, atol=1e-14)
    assert (exact.closed, exact.alpha) == (meshed.closed, meshed.alpha)


def test_flat_facets_have_a_mesh_and_a_sheer_target_has_none() -> None:
    scene = lf.Scene(camera=camera_without_array(), targets=[{"shape": SHAPES["sphere"].model_dump()}])
    assert target_body(scene.targets[0], scene).round is not None
    assert target_body(scene.targets[0], scene.changed({"transport.surface": "flat"})).round is None
    sheer = scene.changed({"targets[0].material.opacity": 0.5})
    assert target_body(sheer.targets[0], sheer).round is not None


@pytest.mark.parametrize("kind", SHAPES)
def test_the_alpha_of_a_picture_lies_on_a_round_target_as_on_its_mesh(kind: str, tmp_path: Path) -> None:
    alpha = np.random.default_rng(3).integers(0, 255, (8, 12, 4)).astype(np.uint8)
    Picture.fromarray(alpha).save(tmp_path / "lace.png")
    material = {"texture": "lace.png", "opacity": "texture_alpha"}
    target = {"shape": SHAPES[kind].model_dump(), "material": material}
    scene = lf.Scene(camera=camera_without_array(), targets=[target]).in_folder(tmp_path)
    exact, meshed = target_body(scene.targets[0], scene), target_mesh(scene.targets[0], scene)
    assert exact.round is not None
    np.testing.assert_array_equal(exact.texture, meshed.texture)
    np.testing.assert_array_equal(exact.alpha, meshed.alpha)


def test_the_mesh_of_a_round_body_is_made_once() -> None:
    own = body("sphere")
    assert own.meshed() is own.meshed()
    assert own.meshed() is not body("sphere").meshed()
