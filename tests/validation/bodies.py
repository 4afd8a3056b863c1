"""Bodies of glass with flat faces, for the tests of what light does in them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def body(
    path: Path, vertices: ArrayLike, faces: Sequence[tuple[int, int, int]], position: Sequence[float], **glass: Any
) -> dict[str, Any]:
    """A body of glass, its vertices written with all digits."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(vertices, np.float64).tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    path.write_text("\n".join(lines))
    return {
        "refractor": {"file": str(path), "units": "mm", "surface": "flat"} | glass, "position_mm": list(position),
    }  # fmt: skip


def prism(path: Path, outline: ArrayLike, width: float, position: Sequence[float], **glass: Any) -> dict[str, Any]:
    """A body whose convex outline in x and z, counter-clockwise as seen from −y, is extruded along y."""
    outline = np.asarray(outline, np.float64)
    n = len(outline)
    vertices = [(x, y, z) for y in (-0.5 * width, 0.5 * width) for x, z in outline]
    faces = [(0, k, k + 1) for k in range(1, n - 1)] + [(n, n + k + 1, n + k) for k in range(1, n - 1)]
    for k in range(n):
        m = (k + 1) % n
        faces += [(k, n + k, n + m), (k, n + m, m)]
    return body(path, vertices, faces, position, **glass)
