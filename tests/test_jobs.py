"""Jobs that may take more than two seconds show their progress to somebody at a terminal, without being asked."""

import io
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import sparse

import lfmesh as lf
from lfmesh import notebook
from lfmesh.study.fits import board_fit
from lfmesh.study.fits import fit as fitting
from tests.study.studies import SHIFT, shifted, small_scene

Words = list[str]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> Words:
    """All progress shown at a terminal, however short the job is."""
    words: Words = []

    @contextmanager
    def status(waits: bool) -> Iterator[Callable[[str], None]]:
        assert waits, "nobody asked for it"
        with notebook.job():
            yield words.append

    @contextmanager
    def progress(waits: bool) -> Iterator[Callable[[lf.Progress], None]]:
        assert waits, "nobody asked for it"
        with notebook.job():
            yield lambda now: words.append(f"{now.stage}: {now.done} of {now.total}")

    # pytest sets `sys.stderr` again before each phase of a test.
    monkeypatch.setattr(notebook, "sys", SimpleNamespace(stderr=Terminal(), modules=sys.modules))
    monkeypatch.setitem(notebook._shown_by, "progress", lambda: SimpleNamespace(status=status, progress=progress))
    return words


def volumes() -> tuple[sparse.csr_array, np.ndarray]:
    """Return a matrix of 14 pixels that see 8 voxels, and their image."""
    draw = np.random.default_rng(1)
    full = draw.uniform(0.1, 1.0, (14, 8))
    return sparse.csr_array(full), full @ draw.uniform(0.5, 2.0, 8)


def grid() -> lf.VoxelBox:
    return lf.VoxelBox.of_size((3, 3, 3), (6.0, 6.0, 6.0), position_mm=(0.0, 0.0, -60.0))


def reconstructed(method: str) -> None:
    rows, image = volumes()
    if method == "tikhonov":
        lf.reconstruct(rows, image, method, noise=np.full(14, 0.01))
    else:
        lf.reconstruct(rows, image, method, 30)


def field() -> lf.LightField:
    return lf.decode(lf.render(small_scene(), progress=False), views=3)


def designed() -> None:
    path = "camera.lens.surfaces[0].radius_mm"
    merit = [{"metric": "efl_mm", "target": 25.0}]
    lf.optimise(small_scene(), [{"path": path, "range": (15.0, 30.0)}], merit, search={"evaluations": 3})


def drawn() -> lf.Dataset:
    return lf.Dataset(small_scene(), [{"path": SHIFT, "uniform": [-0.1, 0.1]}], count=1, parts=[])


@pytest.mark.parametrize(
    ("job", "words"),
    [
        (lambda _: lf.render(small_scene()), "tracing: "),
        (lambda _: lf.white_image(small_scene()), "tracing: "),
        (lambda _: reconstructed("tikhonov"), "strength "),
        (lambda _: reconstructed("mart"), "iteration 30 of 30"),
        (lambda _: reconstructed("rl"), "iteration 30 of 30"),
        (lambda _: reconstructed("sart"), "iteration 30 of 30"),
        (lambda _: lf.projection_matrix(small_scene(), grid()), "100 % of the pixels"),
        (lambda out: lf.write_projection_matrix(small_scene(), grid(), out / "a.npz"), "100 % of the pixels"),
        (lambda _: lf.focal_stack(field(), [50.0, 70.0]), "photograph 2 of 2"),
        (lambda _: lf.estimate_depth(field(), near_mm=50.0, far_mm=70.0), "depth: plane 2 of "),
        (lambda _: lf.depth_truth(small_scene(), views=3, samples=1), "true depth: view 9 of 9"),
        (lambda _: lf.camera_model(small_scene(), views=3), "camera model: view 9 of 9"),
        (lambda _: lf.analyse(small_scene(), across=4), "lens: spot 2 of "),
        (lambda _: designed(), "cameras tried: "),
        (lambda out: shifted(2).run(out, workers=0), " units"),
        (lambda out: drawn().make(out, workers=0), "1 of 1 items"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::lfmesh.PictureWarning")
def test_it_shows_its_progress_by_default(
    job: Callable[[Path], object], words: str, shown: Words, tmp_path: Path
) -> None:
    job(tmp_path)
    assert any(words in line for line in shown), shown


def test_fits_show_their_steps_by_default(shown: Words, monkeypatch: pytest.MonkeyPatch) -> None:
    """Real fits take too long for here."""

    class Said:
        def __init__(self, *given: object) -> None:
            self.say = given[-1]

        def run(self) -> object:
            assert callable(self.say)
            self.say(f"a step of {type(self).__name__}")
            return SimpleNamespace(scene=small_scene(), estimates=())

    monkeypatch.setattr(fitting, "_Search", Said)
    monkeypatch.setattr(fitting, "_warnings", lambda _: ())
    monkeypatch.setattr(board_fit, "_Adjustment", Said)
    monkeypatch.setattr(board_fit, "corners_of", lambda *_: [])
    for module in (fitting, board_fit):
        monkeypatch.setattr(module, "light_of", lambda white, *_: white)
    white = np.ones((20, 20))
    lf.fit(white, small_scene())
    assert shown == ["a step of Said"]
    lf.fit_boards(white, small_scene(), [lf.Board(white, square_mm=1.0)])
    assert shown[1:] == ["a step of Said", "finding corners", "a step of Said"]


def test_they_show_nothing_without_somebody_who_watches(shown: Words, monkeypatch: pytest.MonkeyPatch) -> None:
    reconstructed("sart")
    assert shown
    shown.clear()
    rows, image = volumes()
    lf.reconstruct(rows, image, "sart", say=False)
    monkeypatch.setattr(notebook, "sys", SimpleNamespace(stderr=io.StringIO(), modules=sys.modules))
    reconstructed("sart")
    assert shown == []
