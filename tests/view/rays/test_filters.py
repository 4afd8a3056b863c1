"""Filter expressions mean what they say, bind as they should, and point at their mistakes."""

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import load_lens
from lfmesh.view.rays.filters import FIELDS, FilterError, parse, places
from lfmesh.view.rays.launch import from_field_point, from_pixels


def camera(**more):
    return lf.Camera(
        lens=load_lens(asset_path("lenses/double_gauss_50mm.toml")),
        focus_mm=500.0,
        sensor=lf.Sensor(pixels=(600, 500), pixel_mm=0.008),
        **more,
    )


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    glass = tmp_path_factory.mktemp("glass") / "ball.stl"
    trimesh.creation.icosphere(3, 3.0).export(glass)
    mla = lf.MicrolensArray(count=(32, 30), pitch_mm=0.125, focal_length_mm=0.5, index=1.5, thickness_mm=0.3)
    pane = lf.Target(name="thin pane", shape=lf.Plane(width_mm=30.0, height_mm=30.0), position_mm=(-20.0, 0.0, -30.0))
    ball = lf.Target(refractor=lf.Refractor(file=str(glass), units="mm", index=1.5), position_mm=(0.0, 9.0, -20.0))
    transport = lf.Transport(wavelengths_nm=(480.0, 650.0), weight_cutoff=0.01)
    return lf.build(lf.Scene(camera=camera(mla=mla), targets=(pane, ball), transport=transport))


@pytest.fixture(scope="module")
def rays(world):
    return from_field_point(world, (0.0, 0.0, -500.0), 400, aim="lens")


@pytest.fixture(scope="module")
def told(rays):
    """Every path as plain Python: its steps (surface, event) after the start, and what else is known of it."""
    paths = []
    for i in range(len(rays)):
        part = range(rays.offsets[i] + 1, rays.offsets[i + 1])
        steps = [(rays.surfaces[rays.surface[v]], lf.Event(rays.event[v])) for v in part]
        camera_reflections = sum(e == lf.Event.REFLECTED and s.startswith(("lens", "mla")) for s, e in steps)
        paths.append(
            {
                "steps": steps,
                "reflections": camera_reflections,
                "power": rays.power[rays.offsets[i + 1] - 1],
                "status": lf.Status(rays.status[i]).name.lower(),
                "pixel": tuple(rays.pixel[i]),
                "source": rays.source[i],
                "wavelength": rays.wavelength_nm[i],
                "path": rays.sequence[i],
            }
        )
    return paths


def hits(path, *beginnings):
    return any(surface.startswith(beginnings) for surface, _ in path["steps"])


def is_ghost(path):
    return path["status"] == "sensor" and path["reflections"] >= 2


INTERFACES = (lf.Event.TRANSMITTED, lf.Event.REFLECTED)

EXAMPLES = {
    "hits(mla) and not ghost": lambda p: hits(p, "mla.", "mla edge", "mla wall") and not is_ghost(p),
    "status == absorbed": lambda p: p["status"] == "absorbed",
    "status != ABSORBED": lambda p: p["status"] != "absorbed",
    "status == lost": lambda p: p["status"] == "lost",
    "events > 12": lambda p: sum(e in INTERFACES for _, e in p["steps"]) > 12,
    "last == sensor": lambda p: p["steps"][-1][0] == "sensor",
    "last != mount": lambda p: p["steps"][-1][0] != "mount",
    "pixel in (200:300, 250:350)": lambda p: 200 <= p["pixel"][0] < 300 and 250 <= p["pixel"][1] < 350,
    "pixel in (:250, 300:)": lambda p: 0 <= p["pixel"][0] < 250 and p["pixel"][1] >= 300,
    "pixel in (249, :)": lambda p: p["pixel"][0] == 249,
    "power < 1e-6": lambda p: p["power"] < 1e-6,
    "power >= .2e-6": lambda p: p["power"] >= 2e-7,
    "power > -1": lambda p: True,
    "reflects(lens[2].front)": lambda p: ("lens[1].back", lf.Event.REFLECTED) in p["steps"],
    "reflects(lens[1].back)": lambda p: ("lens[1].back", lf.Event.REFLECTED) in p["steps"],
    "transmits(L4a)": lambda p: ("lens[3].front", lf.Event.TRANSMITTED) in p["steps"],
    "transmits(targets[1])": lambda p: ("targets[1]", lf.Event.TRANSMITTED) in p["steps"],
    "reflects(lens)": lambda p: any(s.startswith("lens") and e == lf.Event.REFLECTED for s, e in p["steps"]),
    "reflects(lens[3])": lambda p: any(s.startswith("lens[3]") and e == lf.Event.REFLECTED for s, e in p["steps"]),
    "hits('thin pane')": lambda p: hits(p, "thin pane"),
    'hits("thin pane") or hits(targets[1])': lambda p: hits(p, "thin pane", "targets[1]"),
    "hits(targets)": lambda p: hits(p, "thin pane", "targets[1]"),
    "hits(targets[0])": lambda p: hits(p, "thin pane"),
    "hits(stop)": lambda p: hits(p, "stop"),
    "hits('lens[2] edge')": lambda p: hits(p, "lens[2] edge"),
    "ghost": is_ghost,
    "reflections == 2": lambda p: p["reflections"] == 2,
    "wavelength <= 500": lambda p: p["wavelength"] == 480.0,
    "source != 7": lambda p: p["source"] != 7,
    "path == 0": lambda p: p["path"] == 0,
    "path == 3 or path == 5": lambda p: p["path"] in (3, 5),
    "": lambda p: True,
    "  ": lambda p: True,
}


@pytest.mark.parametrize("expression", EXAMPLES)
def test_an_expression_keeps_what_it_says(rays, told, expression):
    expected = np.array([bool(EXAMPLES[expression](path)) for path in told])
    np.testing.assert_array_equal(parse(expression, rays), expected)


def test_the_examples_tell_paths_apart(rays):
    """Where an example keeps all or nothing, it tests little: only these may."""
    alike = {e for e in EXAMPLES if parse(e, rays).all() or not parse(e, rays).any()}
    assert alike == {"status == lost", "power > -1", "", "  "}


ATOMS = [e for e in EXAMPLES if e.strip() and " or " not in e and " and " not in e]


def random_expression(draw, depth):
    if depth == 0 or draw.random() < 0.2:
        return str(draw.choice(ATOMS))
    kind = draw.integers(3)
    if kind == 0:
        return f"not ({random_expression(draw, depth - 1)})"
    one, other = (random_expression(draw, depth - 1) for _ in range(2))
    return f"({one}) {'and' if kind == 1 else 'or'} ({other})"


def test_de_morgans_laws_hold(rays):
    draw = np.random.default_rng(0)
    for _ in range(50):
        a, b = random_expression(draw, 2), random_expression(draw, 2)
        np.testing.assert_array_equal(parse(f"not (({a}) and ({b}))", rays), parse(f"not ({a}) or not ({b})", rays))
        np.testing.assert_array_equal(parse(f"not (({a}) or ({b}))", rays), parse(f"not ({a}) and not ({b})", rays))
        np.testing.assert_array_equal(parse(f"not not ({a})", rays), parse(a, rays))


def test_not_binds_closer_than_and_and_and_closer_than_or(rays):
    draw = np.random.default_rng(1)
    told_apart = np.zeros(3, bool)
    for _ in range(80):
        x, y, z = (str(word) for word in draw.choice(ATOMS, 3, replace=False))
        a, b, c = (parse(word, rays) for word in (x, y, z))
        np.testing.assert_array_equal(parse(f"{x} or {y} and {z}", rays), a | (b & c))
        np.testing.assert_array_equal(parse(f"{x} and {y} or {z}", rays), (a & b) | c)
        np.testing.assert_array_equal(parse(f"not {x} and {y}", rays), ~a & b)
        np.testing.assert_array_equal(parse(f"not {x} or {y}", rays), ~a | b)
        np.testing.assert_array_equal(parse(f"({x} or {y}) and {z}", rays), (a | b) & c)
        told_apart |= [
            (a | (b & c) != (a | b) & c).any(), ((a & b) | c != a & (b | c)).any(), (~a & b != ~(a & b)).any()
        ]  # fmt: skip
    assert told_apart.all()


def test_white_space_is_free_within_reason(rays):
    tight = parse("hits(mla)and not(ghost)or pixel in(200:300,250:350)", rays)
    wide = parse("  hits ( mla )\n and not ( ghost ) or\tpixel in ( 200 : 300 , 250 : 350 ) ", rays)
    np.testing.assert_array_equal(tight, wide)


MISTAKES = {
    "hits(lens[9])": (5, ["no 'lens[9]'", "lens[0] to lens[5]", "mla", "sensor"]),
    "hits(len[2])": (5, ["did you mean 'lens[2]'"]),
    "hits(sensr)": (5, ["did you mean 'sensor'"]),
    "hits('thin pain')": (5, ["did you mean 'thin pane'", "'thin pane'"]),
    "hits(thin pane)": (5, ["no 'thin'"]),
    "hits()": (5, ["name of a surface is missing"]),
    "hits(mla": (8, ["')' is missing"]),
    "hits mla": (5, ["'(' is missing"]),
    "gost": (0, ["did you mean 'ghost'"]),
    "not gost": (4, ["did you mean 'ghost'"]),
    "statsu == lost": (0, ["did you mean 'status'"]),
    "lens[0]": (0, ["hits(lens[0])"]),
    "status == losst": (10, ["did you mean 'lost'", "sensor, absorbed, escaped"]),
    "status < lost": (7, ["== or !="]),
    "status": (6, ["must be compared"]),
    "last > sensor": (5, ["== or !="]),
    "events > ": (8, ["a number is missing"]),
    "events > many": (9, ["a number is missing"]),
    "events = 3": (7, ["compare with =="]),
    "power < 1e-6x": (8, ["neither a number nor a name"]),
    "power < 1.2.3": (8, ["neither a number nor a name"]),
    "ghost ghost": (6, ["join two with and, or"]),
    "ghost && ghost": (6, ["use and, or, not"]),
    "ghost and": (9, ["a condition is missing"]),
    "and ghost": (0, ["a condition is missing"]),
    "(ghost": (6, ["')' is missing"]),
    "ghost)": (5, ["')' follows"]),
    "()": (1, ["a condition is missing"]),
    "hits('mla)": (5, ["not closed"]),
    "pixel == 3": (9, ["'(' is missing"]),
    "pixel < 3": (6, ["pixel in (row:row, column:column)"]),
    "pixel in (1:2)": (13, ["',' is missing"]),
    "pixel in (5:5, 1:2)": (10, ["row 5:5 is empty", "0 to 499"]),
    "pixel in (500:510, 1:2)": (10, ["row 500:510 is outside", "0 to 499"]),
    "pixel in (1:2, 600)": (15, ["column 600 is outside", "0 to 599"]),
    "pixel in (-1:2, 1)": (10, ["number of a row"]),
    "pixel in (1.5, 1)": (10, ["number of a row"]),
    "pixel == (1, 2:3)": (14, ["')' is missing"]),
    "__import__('os')": (0, ["unknown name '__import__'"]),
    "3 < power": (0, ["a condition is missing"]),
    f"pixel == ({'9' * 5000}, 1)": (10, ["at most 12 digits"]),
    f"pixel in (0:{'9' * 19}, 1)": (12, ["at most 12 digits"]),
    f"power < {'1' * 15_000}x": (8, ["neither a number nor a name"]),
    "(" * 3000: (100, ["more than 100"]),
    "not " * 3000 + "ghost": (400, ["more than 100"]),
}


@pytest.mark.parametrize("expression", MISTAKES, ids=lambda e: e[:24])
def test_a_mistake_is_pointed_at(rays, expression):
    position, words = MISTAKES[expression]
    with pytest.raises(FilterError) as caught:
        parse(expression, rays)
    error = caught.value
    assert error.position == position
    for word in words:
        assert word in error.reason
    reason, quoted, caret = str(error).splitlines()
    assert reason == error.reason
    assert quoted[2:] == expression
    assert caret.index("^") - 2 == position


def test_a_number_of_any_length_is_read_as_a_float(rays):
    assert parse(f"power < {'9' * 5000}", rays).all()
    assert not parse(f"power < -{'9' * 5000}", rays).any()
    np.testing.assert_array_equal(parse(f"events > 3.{'0' * 5000}", rays), parse("events > 3", rays))


def test_an_expression_without_an_end_is_refused(rays):
    with pytest.raises(FilterError, match="an expression of 60005 characters; the limit is 20000") as caught:
        parse("ghost" + " or ghost".ljust(10) * 6000, rays)
    assert len(str(caught.value)) < 300


def test_what_the_scene_has_not_got_is_a_mistake():
    bare = from_field_point(lf.build(lf.Scene(camera=camera())), (0.0, 0.0, -500.0), 20)
    for expression in ("hits(mla)", "hits(mla.curved)", "hits(MLAc)", "hits(targets)"):
        with pytest.raises(FilterError, match="the scene has no"):
            parse(expression, bare)
    assert parse("hits(lens[5])", bare).any()


def test_every_name_that_exists_is_understood(rays):
    for name, numbers in places(rays).items():
        met = np.isin(rays.surface, numbers) & (rays.event != lf.Event.START)
        np.testing.assert_array_equal(parse(f'hits("{name}")', rays), rays.any_vertex(met))
    assert "start" not in places(rays)
    assert FIELDS


def test_pixels_of_rays_from_the_sensor_are_where_they_started(world):
    rays = from_pixels(world, range(200, 202), range(300, 303), 60)
    kept = parse("pixel in (201:202, 300:302)", rays)
    np.testing.assert_array_equal(kept, (rays.pixel[:, 0] == 201) & (rays.pixel[:, 1] < 302))
    assert kept.any()
    assert not kept.all()
    assert parse("pixel == (201, 300)", rays).sum() == ((rays.pixel == [201, 300]).all(axis=1)).sum() > 0
