"""Program behind a result: versions and sources that determine its bits, and the processor.

Pieces of a result from different processes, machines or days must come from the same program.
"""

import hashlib
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from lfmesh.errors import LfmeshError
from lfmesh.regular_file import read_bytes

LIBRARIES = ("numba", "llvmlite", "numpy", "embreex")

_DIGITS = 12


@cache
def program() -> dict[str, str]:
    """Return the versions of lfmesh and of the numerical libraries, and the digest of lfmesh's sources."""
    import lfmesh

    return {"lfmesh": lfmesh.__version__, "sources": _sources(), **{name: _version(name) for name in LIBRARIES}}


def difference(other: object) -> str:
    """Return in words the differences of another program from this one, or "".

    Parameters
    ----------
    other : dict of str, or anything that stands in its place
        Result of `program` there.
    """
    theirs = other if isinstance(other, Mapping) else {}
    unlike = {name: own for name, own in program().items() if theirs.get(name) != own}
    return ", ".join(f"{name} {theirs.get(name, 'unknown')}, here {own}" for name, own in unlike.items())


def refuse_other(other: object) -> None:
    """Refuse to compute for another program.

    Raises
    ------
    LfmeshError
        The other program's versions or sources differ from this one's.
    """
    if said := difference(other):
        raise LfmeshError(f"this process runs another program than the one that asks it to compute: {said}")


@cache
def processor() -> str:
    """Return the name and the digest of features of the processor that kernels are compiled for."""
    from llvmlite import binding

    features = binding.get_host_cpu_features().flatten()
    return f"{binding.get_host_cpu_name()} {hashlib.sha256(features.encode()).hexdigest()[:_DIGITS]}"


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"


def _sources() -> str:
    package = Path(__file__).parent
    found = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        found.update(path.relative_to(package).as_posix().encode() + b"\0" + read_bytes(path) + b"\0")
    return found.hexdigest()[:_DIGITS]
