"""Rays as segments: each drawn once, paths left out whole, evenly and honestly."""

from itertools import pairwise

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import LfmeshError
from lfmesh.view.rays import launch
from lfmesh.view.rays.paths import Rays
from lfmesh.view.request import together
from lfmesh.view.scene3d.colours import OF_STATUS, default_colour, ray_colours
from lfmesh.view.scene3d.ray_lines import OPAQUE_SEGMENTS, ray_lines


def segments_of(rays: Rays, path: int) -> set[tuple[bytes, bytes]]:
    """Return the segments with a length of one path, straight from its vertices."""
    vertices = rays.position[rays.offsets[path] : rays.offsets[path + 1]]
    return {(a.tobytes(), b.tobytes()) for a, b in pairwise(vertices) if not np.array_equal(a, b)}


def test_all_segments_are_drawn_and_shared_ones_once(split_rays: Rays) -> None:
    lines = ray_lines(split_rays, most_segments=10**6)
    drawn = [(a.tobytes(), b.tobytes()) for a, b in lines.ends]
    wanted = set().union(*(segments_of(split_rays, path) for path in range(len(split_rays))))
    assert len(set(drawn)) == len(drawn)
    assert set(drawn) == wanted
    assert len(drawn) < int(np.diff(split_rays.offsets).sum()) - len(split_rays), "nothing is shared: no test of it"


def test_a_segment_knows_all_paths_that_share_it(split_rays: Rays) -> None:
    lines = ray_lines(split_rays, most_segments=10**6)
    owned: list[set[tuple[bytes, bytes]]] = [set() for _ in range(len(split_rays))]
    for segment, (a, b) in enumerate(lines.ends):
        for path in lines.paths_of(segment):
            owned[path].add((a.tobytes(), b.tobytes()))
    assert owned == [segments_of(split_rays, path) for path in range(len(split_rays))]


@pytest.mark.parametrize("most", [50, 200, 500])
def test_decimation_keeps_whole_paths_up_to_the_limit(split_rays: Rays, most: int) -> None:
    lines = ray_lines(split_rays, most)
    drawn = {(a.tobytes(), b.tobytes()) for a, b in lines.ends}
    kept = np.flatnonzero(lines.drawn)
    assert 0 < len(kept) < len(split_rays)
    assert drawn == set().union(*(segments_of(split_rays, path) for path in kept))
    assert 0.8 * most < len(lines) <= most


def test_decimation_is_even(split_rays: Rays) -> None:
    kept = np.flatnonzero(ray_lines(split_rays, 300).drawn)
    steps = np.diff(kept)
    assert steps.max() - steps.min() <= 1


def test_the_caption_says_what_is_left_out(split_rays: Rays) -> None:
    lines = ray_lines(split_rays, 300)
    assert lines.caption == f"{lines.drawn.sum():,} of {len(split_rays):,} paths drawn"
    assert ray_lines(split_rays, 10**6).caption == f"{len(split_rays):,} paths"


def test_colours_follow_what_they_stand_for(split_rays: Rays) -> None:
    lines = ray_lines(split_rays, 10**6)
    rgb, legend = ray_colours(split_rays, lines.path, lines.vertex, "status")
    names = dict(legend.entries)
    for status in np.unique(split_rays.status[lines.path]):
        colour = OF_STATUS[lf.Status(status)]
        assert names[lf.Status(status).name.lower()] == colour
        wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
        assert (rgb[split_rays.status[lines.path] == status] == wanted).all()


def test_stronger_rays_are_drawn_less_faint(split_rays: Rays) -> None:
    lines = ray_lines(split_rays, 500)
    mesh, _ = lines.coloured("wavelength", fade=True)
    opacity = mesh.cell_data["rgba"][:, 3].astype(int)
    order = np.argsort(split_rays.power[lines.vertex])
    assert (np.diff(opacity[order]) >= 0).all()
    assert opacity.max() == 255 > opacity.min() > 0


def test_few_rays_are_opaque_and_a_cloud_of_them_lets_the_lens_show(split_rays: Rays) -> None:
    counts, opacity = [], []
    for most in (200, OPAQUE_SEGMENTS, 2 * OPAQUE_SEGMENTS, 10**6):
        lines = ray_lines(split_rays, most)
        shown = lines.coloured("wavelength")[0].cell_data["rgba"][:, 3]
        assert len(set(shown)) == 1, "without `fade` all alike"
        counts.append(len(lines))
        opacity.append(int(shown[0]) / 255.0)
    assert opacity[0] == opacity[1] == 1.0
    # As many as are drawn opaque cover as much as any larger number does.
    for count, each in zip(counts[2:], opacity[2:], strict=True):
        assert count * each == pytest.approx(OPAQUE_SEGMENTS, rel=0.01)


def test_a_pixel_is_one_entry_of_the_legend_wherever_on_it_rays_start(world: lf.World) -> None:
    rays = launch.from_pixel(world, 55, 65, 12, split="transmit")
    _, legend = ray_lines(rays).coloured("field")
    assert (legend.title, [label for label, _ in legend.entries]) == ("from row, column", ["55, 65"])
    many = launch.from_pixels(world, range(54, 58), range(64, 68), 32, split="transmit")
    mesh, legend = ray_lines(many).coloured("field")
    assert [label for label, _ in legend.entries] == ["16 pixels"]
    assert len(np.unique(np.asarray(mesh.cell_data["rgba"]), axis=0)) == 1


def test_the_legend_of_paths_names_the_strongest_first(split_rays: Rays) -> None:
    lines = ray_lines(split_rays, 10**6)
    _, legend = ray_colours(split_rays, lines.path, lines.vertex, "path")
    assert legend.entries[0][0] == "image path"
    assert len({colour for _, colour in legend.entries}) == len(legend.entries)


def test_an_unknown_colour_is_refused(split_rays: Rays) -> None:
    lines = ray_lines(split_rays)
    with pytest.raises(LfmeshError, match=r"colour = 'age': use one of wavelength, power, events, status, path"):
        ray_colours(split_rays, lines.path, lines.vertex, "age")  # type: ignore[arg-type]


def test_with_one_wavelength_colours_tell_field_points_apart(world: lf.World) -> None:
    points = ([0.0, 0.0, -199.0], [2.0, -8.0, -199.0])
    both = together([launch.from_field_point(world, point, 6, split="transmit") for point in points])
    assert default_colour(both) == "field"
    mesh, legend = ray_lines(both, 10**6).coloured("field")
    colours = np.unique(np.asarray(mesh.cell_data["rgba"])[:, :3], axis=0)
    assert len(colours) == 2
    assert [label for label, _ in legend.entries] == ["0, 0, -199 mm", "2, -8, -199 mm"]
    one = launch.from_field_point(world, points[0], 6, split="transmit")
    other = launch.from_field_point(world, points[1], 6, split="transmit", wavelength_nm=450.0)
    assert default_colour(one) == default_colour(together([one, other])) == "wavelength"
