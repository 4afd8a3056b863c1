"""Paths as sequences of faces: each is a connected way through the camera, and all are there once."""

import pytest

from lfmesh.transport.sequences.sequences import (
    Itinerary,
    image_path,
    reflected_at,
    reflected_twice_at,
    two_reflections,
)

FACES = 6
HOLLOW = ((1, False), (4, True))


def spaces(path, faces):
    """The spaces that a path is in, one more than faces that it meets; each face bounds the space it is met from."""
    space = 0 if path.to_sensor else faces
    found = [space]
    for face, mirrors in zip(path.faces, path.reflected, strict=True):
        assert face in (space - 1, space), f"{path}: face {face} does not bound space {space}"
        if not mirrors:
            space = face if space > face else face + 1
        found.append(space)
    return found


@pytest.mark.parametrize("path", list(two_reflections(FACES, HOLLOW)))
def test_a_path_goes_from_space_to_space_across_the_camera(path):
    assert spaces(path, FACES)[-1] == FACES
    assert len(path.mirrors) == 2
    assert spaces(path.reverse, FACES)[-1] == 0
    assert path.reverse.mirrors == path.mirrors[::-1]
    assert path.reverse.reverse == path


def test_every_pair_of_faces_is_there_once_the_one_nearer_to_the_sensor_first():
    paths = list(two_reflections(FACES, HOLLOW))
    assert len(set(paths)) == len(paths) == FACES * (FACES - 1) // 2 + len(HOLLOW)
    pairs = [path.mirrors for path in paths[: -len(HOLLOW)]]
    assert set(pairs) == {(i, j) for i in range(FACES) for j in range(i)}


def connected(faces, reflections, most):
    """All ways across the camera with some reflections, by trying both events at every face, found without formulas."""
    ways, found = [((), (), 0, 1, 0)], set()
    while ways:
        at, mirrored, space, sense, count = ways.pop()
        if space == faces and sense > 0:
            if count == reflections:
                found.add((at, mirrored))
            continue
        if (space == 0 and sense < 0) or len(at) == most:
            continue
        face = space if sense > 0 else space - 1
        ways.append(((*at, face), (*mirrored, False), space + sense, sense, count))
        if count < reflections:
            ways.append(((*at, face), (*mirrored, True), space, -sense, count + 1))
    return found


def test_the_pairs_are_all_ways_on_which_every_reflection_turns_light_back():
    expected = connected(FACES, 2, 3 * FACES)
    assert {(path.faces, path.reflected) for path in two_reflections(FACES)} == expected
    assert {(image_path(FACES).faces, image_path(FACES).reflected)} == connected(FACES, 0, FACES)


def test_a_hollow_side_is_met_twice_before_light_passes_or_after():
    before, after = (reflected_twice_at(3, 1, from_behind=behind) for behind in (False, True))
    assert before == Itinerary((0, 1, 1, 1, 2), (False, True, True, False, False))
    assert after == Itinerary((0, 1, 1, 1, 2), (False, False, True, True, False))


def test_the_lens_part_of_a_path_ends_before_the_array():
    assert reflected_at(6, 3, 1).until(4) == Itinerary((0, 1, 2, 3, 2, 1, 2, 3), reflected_at(4, 3, 1).reflected)
    assert image_path(4).until(9) == image_path(4)
