"""Files of arrays that identify their subject and the program that wrote them.

A zip's checksums detect disk errors; the digest detects files altered, or combined from two.
"""

import hashlib
import json
import os
import warnings
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import FileError
from lfmesh.files.json_values import parse_json
from lfmesh.provenance import difference, processor, program
from lfmesh.regular_file import open_regular

Arrays = dict[str, NDArray[Any]]

_FACTS = "facts"


class ProcessorWarning(UserWarning):
    """Warning that another kind of processor, which may differ in the last bits, computed part of a result."""


def write_sealed(file: IO[bytes], form: int, facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays with the facts that identify them.

    Parameters
    ----------
    file : binary file
    form : int
        Format version; readers refuse any other.
    facts : dict
        JSON values.
    arrays : dict of arrays
    """
    stated = {
        "format": form,
        "program": program(),
        "processor": processor(),
        "facts": facts,
        "arrays": {name: _digest(array) for name, array in arrays.items()},
    }
    text = json.dumps(stated, ensure_ascii=False, sort_keys=True)
    digest = hashlib.sha256(text.encode()).hexdigest()
    np.savez(file, **{_FACTS: np.array([digest, text])}, **arrays)  # type: ignore[arg-type]


def read_sealed(path: Path, form: int) -> tuple[dict[str, Any], Arrays]:
    """Read the facts and arrays of a file made by `write_sealed`.

    Parameters
    ----------
    path : Path
    form : int
        Format version.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    FileError
        It cannot be read, is damaged or altered, or another program wrote it.

    Warns
    -----
    ProcessorWarning
        Another kind of processor computed it.
    """
    try:
        with open_regular(path) as file:
            return unsealed(file, form, str(path))
    except FileNotFoundError:
        raise
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror or error}") from None


def unsealed(file: IO[bytes], form: int, what: str) -> tuple[dict[str, Any], Arrays]:
    """Read an open file as `read_sealed` does.

    Parameters
    ----------
    file : binary file
    form : int
        Format version.
    what : str
        Name in messages.
    """
    try:
        _refuse_packed(file)
        with np.load(file, allow_pickle=False) as held:
            if not held[_FACTS].ndim:
                raise FileError(f"{what} was written by an older lfmesh, whose bits may differ")
            digest, text = (str(entry) for entry in held[_FACTS])
            stated = parse_json(text)
            if hashlib.sha256(text.encode()).hexdigest() != digest:
                raise ValueError("its facts were changed")
            refuse_maker(what, form, stated["format"], stated["program"])
            if {*held.files} != {*stated["arrays"], _FACTS}:
                raise ValueError("it has other arrays")
            arrays = {name: held[name] for name in stated["arrays"]}
        if any(_digest(arrays[name]) != known for name, known in stated["arrays"].items()):
            raise ValueError("its arrays were changed")
        facts, where = dict(stated["facts"]), stated["processor"]
    except FileError:
        raise
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error, MemoryError):
        raise FileError(f"{what} is damaged") from None
    if where != processor():
        warnings.warn(
            f"{what} was computed by another kind of processor ({where}, here {processor()}): bits of the whole may "
            "differ from those of either",
            ProcessorWarning,
            stacklevel=3,
        )
    return facts, arrays


def _refuse_packed(file: IO[bytes]) -> None:
    """Raise ValueError if the arrays of a file are larger than the file: `write_sealed` does not compress."""
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    with zipfile.ZipFile(file) as archive:
        if sum(member.file_size for member in archive.infolist()) > size:
            raise ValueError("it unpacks to more than it is")
    file.seek(0)


def refuse_maker(what: str, form: int, found: object, maker: object) -> None:
    """Refuse a file of another program or format version.

    Parameters
    ----------
    what : str
        Name in messages.
    form, found : int
        Expected and actual format version.
    maker : dict of str
        Program that wrote the file.

    Raises
    ------
    FileError
        The versions or the programs differ.
    """
    if other := f"format {found} in place of {form}" if found != form else difference(maker):
        raise FileError(
            f"{what} was written by another program ({other[:200]}), whose bits may differ: start again elsewhere, "
            "or continue with that program"
        )


def _digest(array: NDArray[Any]) -> str:
    found = hashlib.sha256(f"{array.dtype.str} {array.dtype.descr} {array.shape}".encode())
    found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()
