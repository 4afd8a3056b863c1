"""Units of a study: one batch of replicates of one point, as a pure function of its input.

A unit can be pickled and computed by any process; its outcome is bytes that are stored unchanged.
"""

import io
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import FileError, LfmeshError, PictureWarning, collected, in_order
from lfmesh.files.sealed import read_sealed, unsealed, write_sealed
from lfmesh.lightfield.views.upright import Upright
from lfmesh.provenance import program, refuse_other
from lfmesh.scene.inputs import file_stamp
from lfmesh.study.metrics.metrics import columns_of, pictures_of
from lfmesh.study.metrics.pictures import Camera, Films, Taken, in_a_line, taken
from lfmesh.study.sweeps.bench import Bench, OnTheWay, Traced, in_threads
from lfmesh.study.tolerances.compensators import Compensator
from lfmesh.study.tolerances.largest_change import Allowed, Search

Array = NDArray[np.float64]

FORMAT = 5
"""Format of an outcome's bytes; a reader refuses any other."""

PREVIEW_PX = 200
"""Longest side of a preview."""

FULL = 99.5
"""Percentile of the reference's image that is displayed as white."""


@dataclass(frozen=True)
class Unit:
    """A batch of replicates of a point.

    Attributes
    ----------
    study : str
        Digest of the plan.
    point, batch : int
        Point 0 is the reference.
    camera, reference : Camera
    metrics : tuple of str
    replicates : range
    threads : int
        Threads that trace it; they do not change the outcome.
    program : dict of str
        Program that planned it, see `lfmesh.provenance.program`.
    compensators : tuple of Compensator
        Adjust every camera but the reference.
    search : Search or None
        Search at this point; the camera is then the one at its end.
    """

    study: str
    point: int
    batch: int
    camera: Camera
    reference: Camera
    metrics: tuple[str, ...]
    replicates: range
    threads: int = 0
    program: dict[str, str] = field(default_factory=program)
    compensators: tuple[Compensator, ...] = ()
    search: Search | None = None

    def compute(self, given: "Reference") -> bytes:
        """Return the unit's outcome as bytes, from the reference's films.

        Raises
        ------
        LfmeshError
            This program is not the one that planned the unit.
        """
        refuse_other(self.program)
        return run_unit(self, given)


@dataclass
class Outcome:
    """Outcome of a unit.

    Attributes
    ----------
    point, batch : int
    columns : dict of (n,) float64
        Pseudo-values of each column of the metrics.
    seconds : float
        Wall-clock time of tracing.
    fault : str or None
        Reason why the point cannot be traced, or why all its metrics are unknown.
    unknown : dict of str
        Reasons for unknown metrics, by name; some of their columns are NaN or impossible values.
    on_the_way : dict of OnTheWay
        Metrics unknown for cameras that a search or an adjustment traced, by name.
    maps : dict of (rows, columns, 2) float64
        Displacement of each centre, pixels.
    preview : (h, w) uint8, or None
        Upright, reduced raw image.
    warnings : tuple of PictureWarning
        Warnings of the pictures behind its values, without the reference's.
    adjusted : tuple of float
        Changes by the compensators.
    allowed : Allowed or None
        Result of a search; all other fields are for the camera found.
    """

    point: int
    batch: int
    columns: dict[str, Array] = field(default_factory=dict)
    seconds: float = 0.0
    fault: str | None = None
    unknown: dict[str, str] = field(default_factory=dict)
    maps: dict[str, Array] = field(default_factory=dict)
    preview: NDArray[np.uint8] | None = None
    warnings: tuple[PictureWarning, ...] = ()
    adjusted: tuple[float, ...] = ()
    allowed: Allowed | None = None
    on_the_way: dict[str, OnTheWay] = field(default_factory=dict)


Reference = bytes | Path
"""Films of the reference's replicates of the same batch: bytes from `reference_films`, or a file with them."""


def reference_films(unit: Unit) -> bytes:
    """Trace the reference's replicates of a unit's batch; return their films as bytes.

    Raises
    ------
    LfmeshError
        None of the reference's pictures can be traced.
    """
    began = time.perf_counter()
    with collected() as found:
        traced = taken(in_threads(unit.reference, unit.threads), pictures_of(unit.metrics), unit.replicates)
    facts = {
        "study": unit.study,
        "batch": unit.batch,
        "seconds": time.perf_counter() - began,
        "warnings": _as_dicts(found),
        "lacking": dict(traced.lacking),
    }
    return _sealed(facts, {f"film.{name}": power for name, power in traced.items()})


def run_unit(unit: Unit, reference: Reference) -> bytes:
    """Trace a unit, compare it with the reference, and return its outcome as bytes.

    Parameters
    ----------
    unit : Unit
    reference : Reference

    Raises
    ------
    FileError
        The reference's films or a file of the scene cannot be read, or have changed since planning.
    """
    known = opened_reference(reference)
    with collected() as found:
        try:
            outcome = _outcome(unit, known)
        except FileError:
            # A fault of the machine, not of the point: the unit is tried again when the study is resumed.
            raise
        except LfmeshError as error:
            outcome = Outcome(unit.point, unit.batch, fault=in_a_line(error))
    outcome.warnings = in_order([*(known.warnings if unit.point == 0 else ()), *found])
    return packed(outcome, unit.study)


def _outcome(unit: Unit, reference: Traced) -> Outcome:
    bench = Bench(
        unit.camera, unit.reference, reference, unit.metrics, unit.replicates, unit.threads, unit.compensators
    )
    camera, own, seconds = unit.reference, reference.films, reference.seconds
    allowed: Allowed | None = None
    adjusted: tuple[float, ...] = ()
    if unit.point:
        scene = unit.camera.scene
        if unit.search is not None:
            allowed = bench.searched(unit.search)
            scene = scene.changed({unit.search.path: allowed.value})
        scene, adjusted = bench.adjusted(scene)
        camera = Camera(scene, unit.camera.edge_distance_mm)
        began = time.perf_counter()
        own = bench.traced(camera, unit.metrics)
        seconds = time.perf_counter() - began
    found = bench.compared(camera, own, unit.metrics)
    if found.has_none:
        raise LfmeshError("; ".join(dict.fromkeys(found.unknown.values())))
    preview = _preview(unit, own, reference.films) if "scene" in own and "scene" in reference.films else None
    return Outcome(
        unit.point, unit.batch, found.columns, seconds, None, found.unknown, found.maps, preview, (), adjusted, allowed,
        bench.on_the_way(),
    )  # fmt: skip


def _preview(unit: Unit, own: Films, known: Films) -> NDArray[np.uint8]:
    """Return the upright raw image, reduced, at the reference's brightness scale."""
    reference = known["scene"].mean(axis=(0, 3))
    white = float(np.percentile(reference, FULL)) or 1.0
    picture = Upright.of(unit.reference.scene).picture(own["scene"].mean(axis=(0, 3))[:, :, None])[:, :, 0]
    step = -(-max(picture.shape) // PREVIEW_PX)
    height, width = (size // step * step for size in picture.shape)
    small = picture[:height, :width].reshape(height // step, step, width // step, step).mean(axis=(1, 3))
    return np.asarray(np.round(255.0 * np.clip(small / white, 0.0, 1.0) ** (1.0 / 2.2)), dtype=np.uint8)


def packed(outcome: Outcome, study: str) -> bytes:
    """Return an outcome as bytes."""
    facts = {
        "study": study,
        "point": outcome.point,
        "batch": outcome.batch,
        "seconds": outcome.seconds,
        "fault": outcome.fault,
        "unknown": outcome.unknown,
        "warnings": _as_dicts(outcome.warnings),
        "adjusted": outcome.adjusted,
        "allowed": outcome.allowed,
        "on_the_way": outcome.on_the_way,
    }
    arrays: dict[str, NDArray[Any]] = {f"column.{name}": values for name, values in outcome.columns.items()}
    arrays |= {f"map.{name}": values for name, values in outcome.maps.items()}
    if outcome.preview is not None:
        arrays["preview"] = outcome.preview
    return _sealed(facts, arrays)


def unpacked(
    content: bytes, study: str, point: int, batch: int, metrics: tuple[str, ...], what: str = "the outcome"
) -> Outcome:
    """Return an outcome from its bytes.

    Parameters
    ----------
    content : bytes
    study : str
        Digest of the study.
    point, batch : int
        Numbers of the unit.
    metrics : tuple of str
    what : str
        Name of the file in messages.

    Raises
    ------
    FileError
        The bytes are damaged, belong to another unit, or come from another program.
    """
    facts, arrays = unsealed(io.BytesIO(content), FORMAT, what)
    if (facts["study"], facts["point"], facts["batch"]) != (study, point, batch):
        raise FileError(f"{what} belongs to another study or unit")
    fault = facts["fault"]
    columns = {} if fault else {column.name: arrays[f"column.{column.name}"] for column in columns_of(metrics)}
    maps = {name.removeprefix("map."): values for name, values in arrays.items() if name.startswith("map.")}
    found, allowed = _warnings_in(facts), facts["allowed"]
    return Outcome(
        point, batch, columns, facts["seconds"], fault, facts["unknown"], maps, arrays.get("preview"), found,
        tuple(facts["adjusted"]), None if allowed is None else Allowed(*allowed),
        {name: OnTheWay(*met) for name, met in facts["on_the_way"].items()},
    )  # fmt: skip


def _as_dicts(found: Iterable[PictureWarning]) -> list[dict[str, str]]:
    return [each.as_dict() for each in in_order(found)]


def _warnings_in(facts: Mapping[str, Any]) -> tuple[PictureWarning, ...]:
    return tuple(map(PictureWarning.from_dict, facts["warnings"]))


def opened_reference(reference: Reference) -> Traced:
    """Return the films of a reference.

    Raises
    ------
    FileError
        The films cannot be read, are damaged, or come from another program.
    """
    if isinstance(reference, Path):
        # Another study may have begun in the folder since.
        return _opened_file(reference, file_stamp(reference))
    return _films_in(*unsealed(io.BytesIO(reference), FORMAT, "the reference"))


@lru_cache(maxsize=2)
def _opened_file(path: Path, stamp: tuple[object, ...]) -> Traced:
    try:
        return _films_in(*read_sealed(path, FORMAT))
    except FileNotFoundError as error:
        raise FileError(f"{path} cannot be read: {error.strerror}") from None


def _films_in(facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Traced:
    found = {name.removeprefix("film."): power for name, power in arrays.items()}
    return Traced(Taken(found, facts["lacking"]), facts["seconds"], _warnings_in(facts))


def is_reference(path: Path, study: str, batch: int) -> bool:
    """Tell whether a file holds complete films of a study's reference.

    Parameters
    ----------
    path : Path
    study : str
        Digest of the study.
    batch : int
    """
    try:
        facts, _ = read_sealed(path, FORMAT)
        return (facts["study"], facts["batch"]) == (study, batch)
    except (FileError, FileNotFoundError):
        return False


def _sealed(facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    stream = io.BytesIO()
    write_sealed(stream, FORMAT, facts, arrays)
    return stream.getvalue()
