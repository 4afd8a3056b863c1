"""A render is a fold of tallies: cut, saved, sent and continued anyhow, it has the bits of one that ran through."""

import io
import pickle
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.errors import LfmeshError
from lfmesh.transport.render import plan
from lfmesh.transport.render.jobs import Job, reduced, traced
from lfmesh.transport.render.plan import Block
from lfmesh.transport.render.render import Renderer
from lfmesh.transport.render.tally import Layout, Piece, RenderState, arrays_of
from lfmesh.transport.render.tracer import Tracer
from tests.cameras import close_up_camera
from tests.instances import instances

CHUNK = 512
"""Packets, so that a small picture has many chunks."""

CAMERA = close_up_camera(20, 16)
PLANE = {"shape": {"kind": "plane", "width_mm": 7.0, "height_mm": 6.0}, "position_mm": [0, 0, -60.0],
         "material": {"reflectance": 0.8, "radiance_w_m2_sr": 100.0}}  # fmt: skip
LAMP = {"kind": "point", "position_mm": [20.0, -15.0, -25.0], "power_w": 1.0}
ADAPTIVE = {"target_error": 0.01, "max_samples": 256}

WAYS: dict[str, dict[str, Any]] = {
    "image path": {"split": "transmit"},
    # Three samples a pixel and replicate: chunks of both parts lie across any border.
    "reflections, three samples": {"split": "both", "samples": 12},
    "forward": {"method": "forward"},
    "two wavelengths, adaptive": {"split": "both", "wavelengths_nm": [500.0, 600.0], **ADAPTIVE},
    "bands, twelve samples": {"split": "both", "samples": 48},
    # Ten replicates of bands are eight groups, two of them of two replicates.
    "bands, adaptive": {"split": "transmit", "samples": 20, "replicates": 10, **ADAPTIVE},
    "bands, forward": {"method": "forward", "samples": 20, "replicates": 10},
    "lamp behind glass, adaptive": {"split": "transmit", **ADAPTIVE},
}


@pytest.fixture(scope="module")
def scene_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], lf.Scene]:
    """Return the scene that is traced in a way named above."""
    folder = tmp_path_factory.mktemp("meshes")
    trimesh.creation.icosphere(2, 1.5).export(folder / "ball.stl")

    def scene(way: str) -> lf.Scene:
        ball = {"refractor": {"file": "ball.stl", "units": "mm", "index": 1.5}, "position_mm": [0, 0, -45.0]}
        sensor = CAMERA["sensor"] | ({"bands": "rgb"} if "bands" in way else {})
        return lf.Scene(
            camera=CAMERA | {"sensor": sensor},
            targets=[PLANE, ball] if "glass" in way else [PLANE],
            lights=[LAMP],
            transport={"samples": 16, "replicates": 4, "threads": 1} | WAYS[way],
        ).in_folder(folder)

    return scene


@pytest.fixture(scope="module")
def whole(scene_of: Callable[[str], lf.Scene]) -> dict[str, lf.Image]:
    """Render every way in one go."""
    images = {way: Renderer(lf.build(scene_of(way)), chunk=CHUNK).image() for way in WAYS}
    assert images["lamp behind glass, adaptive"].ledger.lamps is not None
    assert images["lamp behind glass, adaptive"].ledger.lamps.sensor > 0.0
    assert all((image.refinement is not None) == ("adaptive" in way) for way, image in images.items())
    return images


def assert_same_bits(one: lf.Image, other: lf.Image) -> None:
    for name in ("mean", "stderr", "hits", "error", "upper"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.ledger == other.ledger
    assert (one.refinement, one.blind, one.samples) == (other.refinement, other.blind, other.samples)
    assert (one.replicates, one.complete) == (other.replicates, other.complete)


def posted(do: Callable[[Job], Piece], jobs: Iterable[Job]) -> Iterator[Piece]:
    """Do jobs last first within a replicate's reach, everything sent as bytes; results come in the order of jobs."""
    sent = [pickle.dumps(job) for job in jobs]
    done = [pickle.dumps(do(pickle.loads(job))) for job in reversed(sent)]
    yield from (pickle.loads(piece) for piece in reversed(done))


def in_jobs(scene: lf.Scene, mapped: Callable[..., Iterable[Piece]], blocks: int) -> lf.Image:
    """Render in so many jobs for each replicate, done by a `map`."""
    return reduced(Tracer(lf.build(scene), CHUNK), lambda jobs: mapped(traced, jobs), blocks)


@pytest.mark.parametrize("blocks", instances([1, 3, 7], long=[1, 3]))
@pytest.mark.parametrize("way", WAYS)
def test_any_cut_has_the_bits_of_the_whole(
    way: str, blocks: int, scene_of: Callable[[str], lf.Scene], whole: dict[str, lf.Image],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    if blocks == 7:
        # Borders through the pixels that a second stage sorts together.
        monkeypatch.setattr(plan.Plan, "blocks", lambda self, *_, **__: cut_anywhere(self.pixels))
    assert_same_bits(in_jobs(scene_of(way), posted, blocks), whole[way])


def cut_anywhere(pixels: int) -> list[Block]:
    borders = [0, 1, 45, 46, 171, 255, 300, pixels]
    return [Block(first, last) for first, last in pairwise(borders)]


def test_another_process_has_the_same_bits(scene_of: Callable[[str], lf.Scene], whole: dict[str, lf.Image]) -> None:
    way = "reflections, three samples"
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert_same_bits(in_jobs(scene_of(way), pool.map, 2), whole[way])


def test_a_cut_at_chunks_traces_none_twice(scene_of: Callable[[str], lf.Scene]) -> None:
    # 128 samples of the image path, 16 of the ghosts of the lens, two of other strays.
    tracer = Tracer(
        lf.build(scene_of("image path").changed({"transport.split": "both", "transport.samples": 512})), CHUNK
    )
    blocks = tracer.plan.blocks(3)
    assert [(block.first, block.last) for block in blocks] == [(0, 256), (256, 320)]
    for chunk in tracer.plan.chunks(0):
        assert sum(block.touches(chunk) for block in blocks) == 1


def test_a_replicate_is_not_folded_from_too_little_or_too_much(scene_of: Callable[[str], lf.Scene]) -> None:
    tracer = Tracer(lf.build(scene_of("image path")), CHUNK)
    one, other = (tracer.piece(0, Block(*ends)) for ends in ((0, 128), (128, 320)))
    tracer.layout.tally().merge([other, one])
    for pieces in ([one], [one, other, other], [one, tracer.piece(1, Block(128, 320))]):
        with pytest.raises(ValueError, match="replicate"):
            tracer.layout.tally().merge(pieces)


class Kept:
    """Keeps every state of a render as the bytes of a file."""

    def __init__(self) -> None:
        self.files: list[bytes] = []

    def __call__(self, state: RenderState, *, last: bool) -> None:
        file = io.BytesIO()
        np.savez(file, **arrays_of(state))  # type: ignore[arg-type]
        self.files.append(file.getvalue())


def read(file: bytes) -> dict[str, NDArray[Any]]:
    with np.load(io.BytesIO(file)) as arrays:
        return dict(arrays)


def is_within(file: bytes) -> bool:
    """Tell whether a state was kept within a replicate."""
    return any(name.startswith("partial.") for name in read(file))


@pytest.mark.parametrize(
    "way", instances(WAYS, long=["two wavelengths, adaptive", "bands, twelve samples", "bands, adaptive"])
)
def test_a_render_goes_on_from_any_replicate_and_any_chunk_with_the_same_bits(
    way: str, scene_of: Callable[[str], lf.Scene], whole: dict[str, lf.Image]
) -> None:
    """From seven states, first to last, some of them within a replicate."""
    world, kept = lf.build(scene_of(way)), Kept()
    assert_same_bits(Renderer(world, chunk=CHUNK).image(keep=kept), whole[way])
    stages = 2 if "adaptive" in way else 1
    assert sum(not is_within(file) for file in kept.files) == stages * world.scene.transport.replicates
    some = [kept.files[i] for i in np.linspace(0, len(kept.files) - 1, 7).astype(int)]
    assert is_within(some[0])
    for file in some:
        again = Kept()
        image = Renderer(world, chunk=CHUNK).image(read(file), again)
        assert_same_bits(image, whole[way])
        # What was done is not done again.
        assert len(again.files) == len(kept.files) - 1 - kept.files.index(file)
        assert image.seconds > 0.0


def test_ctrl_c_gives_the_last_whole_state_to_the_keeper(
    scene_of: Callable[[str], lf.Scene], whole: dict[str, lf.Image], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfmesh.transport.render.render.PROGRESS_SECONDS", 0.0)
    way = "two wavelengths, adaptive"
    world, kept = lf.build(scene_of(way)), Kept()

    def interrupt(progress: lf.Progress) -> None:
        if progress.replicate == 2 and progress.stage == "refining":
            raise KeyboardInterrupt

    image = Renderer(world, chunk=CHUNK, progress=interrupt).image(keep=kept)
    assert not image.complete
    # Four of the first stage, two of the second; the last one is within the third.
    assert sum(not is_within(file) for file in kept.files) == 6
    assert is_within(kept.files[-1])
    assert_same_bits(Renderer(world, chunk=CHUNK).image(read(kept.files[-1])), whole[way])


@pytest.mark.parametrize("way", ["image path", "reflections, three samples", "forward"])
def test_ctrl_c_in_the_first_replicate_loses_only_what_was_on_its_way(
    way: str, scene_of: Callable[[str], lf.Scene], whole: dict[str, lf.Image], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Light of chunks that were traced but not folded in is on the film, and is not there twice in the end."""
    monkeypatch.setattr("lfmesh.transport.render.render.PROGRESS_SECONDS", 0.0)
    scene, calls, kept = scene_of(way).changed({"transport.threads": 3}), [], Kept()

    def interrupt(progress: lf.Progress) -> None:
        calls.append(progress)
        if len(calls) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Renderer(lf.build(scene), chunk=CHUNK, progress=interrupt).image(keep=kept)
    saved = read(kept.files[-1])
    assert saved["partial.chunks"] == 3
    more: list[lf.Progress] = []
    image = Renderer(lf.build(scene), chunk=CHUNK, progress=more.append).image(saved)
    assert_same_bits(image, whole[way])
    assert more[0].done > calls[-1].done


def test_what_was_kept_of_a_replicate_that_others_have_finished_leaves_no_light(
    scene_of: Callable[[str], lf.Scene], whole: dict[str, lf.Image], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after a cluster has gone on: Ctrl-C before anything of the next replicate is folded, then once more on."""
    way, kept, again = "image path", Kept(), Kept()
    world = lf.build(scene_of(way))
    Renderer(world, chunk=CHUNK).image(keep=kept)
    early = next(read(file) for file in kept.files if is_within(file))
    later = [read(file) for file in kept.files if not is_within(file)][1]
    stale = later | {name: array for name, array in early.items() if name.startswith("partial.")}

    def interrupted(self: Tracer, pool: Any, replicate: int, chunks: Any, films: Any) -> Any:
        for film in films:
            film.power += 1.0
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Tracer, "traced", interrupted)
        assert not Renderer(world, chunk=CHUNK).image(stale, again).complete
    assert_same_bits(Renderer(world, chunk=CHUNK).image(read(again.files[-1])), whole[way])


def test_the_state_of_another_render_is_refused(scene_of: Callable[[str], lf.Scene]) -> None:
    other = Layout((16, 21, 1), (2, 30), 8).state()
    with pytest.raises(LfmeshError, match="another size"):
        Renderer(lf.build(scene_of("image path"))).image(arrays_of(other))
    with pytest.raises(LfmeshError, match="missing"):
        Renderer(lf.build(scene_of("image path"))).image({})


def test_a_scene_that_jobs_read_from_its_text_is_the_same(tmp_path: Path) -> None:
    """Numbers survive as text to the last bit: 0.1 + 0.2 among them."""
    scene = lf.Scene(camera=CAMERA, targets=[PLANE]).changed({"targets[0].position_mm": [0.1 + 0.2, 1e-17, -60.0]})
    assert lf.loads(scene.dump_toml(), tmp_path) == scene
