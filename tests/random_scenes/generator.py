"""Random cameras and scenes: a number draws a camera, or a scene, that is valid, and always the same one.

Each feature has random numbers of its own, keyed by the number and its name. So a scene can be drawn again without one
of its features, and a new feature does not change the others: this is how a scene that fails is made smaller.
"""

import math
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Literal

import lfmesh as lf
from lfmesh.assets import asset_path
from tests.random_scenes import camera_features, object_features  # noqa: F401 (they fill the table of features)
from tests.random_scenes.draft import FEATURES, Dice, Draft, NotDrawnError, Tables, rounded
from tests.random_scenes.lenses import draw_lens

Kind = Literal["camera", "scene"]

ATTEMPTS = 60
"""Draws of one number until a scene is valid."""

OWN_KERNELS = frozenset(name for name, feature in FEATURES.items() if feature.own_kernels)
"""Features that the suite leaves to the long tests."""


@dataclass(frozen=True)
class Drawn:
    """A scene that was drawn.

    Attributes
    ----------
    kind : str
    number : int
    without : frozenset of str
        Features that were left out.
    features : tuple of str
        Features that it has.
    tables : dict
        Of the scene.
    attempt : int
        Which draw of this number was the first valid one.
    refused : tuple of str
        Why earlier draws were not valid.
    """

    kind: Kind
    number: int
    without: frozenset[str]
    features: tuple[str, ...]
    tables: Tables
    attempt: int = 0
    refused: tuple[str, ...] = ()

    @property
    def scene(self) -> lf.Scene:
        """The scene, whose files lie in the assets."""
        return lf.Scene(**self.tables).in_folder(asset_path("."))

    @property
    def toml(self) -> str:
        """The scene as a file of the folder of assets, for a report."""
        left_out = f" without {', '.join(sorted(self.without))}" if self.without else ""
        return f"# {self.kind} {self.number}{left_out}: {', '.join(self.features)}\n{self.scene.dump_toml()}"


def draw(kind: Kind, number: int, without: Collection[str] = (), attempt: int | None = None) -> Drawn:
    """Draw a camera before targets that shine, or targets, lamps, glass, media and particles before a simple camera.

    Parameters
    ----------
    kind : "camera" or "scene"
    number : int
    without : collection of str
        Features to leave out.
    attempt : int, optional
        The draw of this number that is wanted; omitted, the first one that is valid.

    Raises
    ------
    NotDrawnError
        The attempt that is wanted is not valid.
    """
    refused: list[str] = []
    for one in range(ATTEMPTS) if attempt is None else (attempt,):
        try:
            return _drawn(kind, number, frozenset(without), one, tuple(refused))
        except (NotDrawnError, lf.LfmeshError) as error:
            refused.append(str(error))
    raise NotDrawnError(f"{kind} {number}: no valid draw; the last ones: {refused[-3:]}")


def smaller(drawn: Drawn) -> Iterator[Drawn]:
    """Yield the same scene without each of its features in turn, where it is valid without it."""
    for name in drawn.features:
        try:
            yield draw(drawn.kind, drawn.number, drawn.without | {name}, drawn.attempt)
        except NotDrawnError:
            continue


def _drawn(kind: Kind, number: int, without: frozenset[str], attempt: int, refused: tuple[str, ...]) -> Drawn:
    # The kind is in the key: camera 3 has nothing in common with scene 3.
    key = (zlib.crc32(kind.encode()), number, attempt)
    draft = (_camera if kind == "camera" else _simple_camera)(Dice(*key))
    has = _put_features(draft, kind, key, without)
    drawn = Drawn(kind, number, without, has, draft.tables, attempt, refused)
    lf.build(drawn.scene)
    return drawn


def _put_features(draft: Draft, kind: Kind, key: tuple[int, ...], without: frozenset[str]) -> tuple[str, ...]:
    has = []
    for name, feature in FEATURES.items():
        dice = Dice(*key, zlib.crc32(name.encode()))
        wanted = dice.chance(feature.in_cameras if kind == "camera" else feature.in_scenes)
        if name == "camera_pose":
            _let_something_shine(draft)
        if wanted and name not in without and feature.put(draft, dice) is not False:
            has.append(name)
    return tuple(has)


def _let_something_shine(draft: Draft) -> None:
    """Let the plane in focus shine where there is no other light."""
    targets = [target["material"] for target in draft.tables["targets"] if "material" in target]
    lit = draft.tables.get("lights") or any(m.get("radiance_w_m2_sr") or m.get("temperature_k") for m in targets)
    if not lit:
        targets[0]["radiance_w_m2_sr"] = 1.0


def _camera(dice: Dice) -> Draft:
    """Draw lens, sensor and, mostly, an array before a plane through the focus that shines."""
    draft = _draft(dice, int(dice.draw.integers(1, 7)), dice.log_between(1.2, 64.0), dice.chance(0.7))
    draft.tables["targets"] = [_plane(draft, {"reflectance": 0.0, "radiance_w_m2_sr": 1.0})]
    return draft


def _simple_camera(dice: Dice) -> Draft:
    """Draw a camera of one to three surfaces, so fast that light from lamps finds it, before a matt plane."""
    draft = _draft(dice, int(dice.draw.integers(1, 4)), dice.log_between(1.5, 11.0), dice.chance(0.5))
    material = {"reflectance": dice.between(0.3, 0.95), "radiance_w_m2_sr": dice.one_of(0.0, dice.between(0.3, 1.5))}
    draft.tables["targets"] = [_plane(draft, material)]
    return draft


def _draft(dice: Dice, surfaces: int, f_number: float, array: bool) -> Draft:
    focal = dice.log_between(2.0, 120.0)
    lens, groups = draw_lens(dice, surfaces, focal, f_number)
    focus = rounded(focal * dice.log_between(3.0, 60.0))
    pixels = [int(dice.draw.integers(6, 15)) for _ in range(2)]
    camera: Tables = {"focus_mm": focus, "lens": {"surfaces": lens, "f_number": f_number}}
    if array:
        camera["mla"], pixel, room = _array(dice, focal, f_number, max(pixels))
        margin = dice.one_of(0, 1, 3)
        camera["mla"]["count"] = [math.ceil(p * pixel / camera["mla"]["pitch_mm"]) + margin for p in pixels]
    else:
        pixel, room = rounded(focal * dice.log_between(1e-3, 0.04)), focal
    camera["sensor"] = {"pixels": pixels, "pixel_mm": pixel}
    half_field = 0.5 * max(pixels) * pixel * (focus - focal) / focal
    transport = {"samples": 64, "split": "transmit", "threads": 1}
    tables = {"camera": camera, "transport": transport}
    return Draft(tables, focal, f_number, focus, 0.5 * focal / f_number, room, half_field, groups)


def _array(dice: Dice, focal: float, f_number: float, pixels: int) -> tuple[Tables, float, float]:
    """Draw an array near the lens's f-number, the width of a pixel and the way from the array to the sensor, mm."""
    per_lenslet = dice.log_between(1.2, 20.0)
    # The sensor's half diagonal is at most a third of the focal length.
    widest = 0.5 * focal * per_lenslet / pixels
    pitch = rounded(min(focal * dice.log_between(1e-3, 5e-2), widest))
    index = dice.between(1.4, 1.9)
    wished = pitch * f_number * dice.log_between(0.6, 2.0)
    radius = rounded(max(wished * (index - 1.0), dice.between(0.75, 1.0) * pitch))
    corner = pitch / math.sqrt(2.0)
    sag = radius - math.sqrt(radius**2 - corner**2)
    thickness = rounded(1.05 * sag + dice.between(0.05, 0.8) * pitch)
    room = radius / (index - 1.0) - thickness / index
    if room <= 0.05 * pitch:
        raise NotDrawnError("the lenslets focus inside their plate")
    array = {"pitch_mm": pitch, "radius_mm": radius, "index": index, "thickness_mm": thickness}
    return array, rounded(pitch / per_lenslet), room


def _plane(draft: Draft, material: Tables) -> Tables:
    side = rounded(2.0 * (1.3 * draft.half_field_mm + 0.3 * draft.semi_mm))
    shape = {"kind": "plane", "width_mm": side, "height_mm": side}
    return {"shape": shape, "position_mm": [0.0, 0.0, -draft.focus_mm], "material": material}
