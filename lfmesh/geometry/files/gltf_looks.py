"""Materials of glTF files: colour, picture and its mapping, alpha, metallic and roughness.

glTF 2.0, section 3.9. Values are taken unchanged, except that a factor slightly above 1 due to rounding becomes 1.
"""

import reprlib
from typing import Any, NamedTuple

import numpy as np

from lfmesh.errors import MeshError
from lfmesh.geometry.files.gltf_buffers import Buffers, bytes_of, names_of
from lfmesh.geometry.files.gltf_nodes import LONGEST_NAME, entries_of, finite_numbers, number_below
from lfmesh.geometry.files.pictures import Pictures
from lfmesh.geometry.files.piece import REPEAT, Look
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.objects.texture import Texture, as_coded
from lfmesh.optics.gltf_material import GltfMaterial

REPEATS = 10497
WRAPS = {REPEATS: "repeat", 33071: "clamp", 33648: "mirror"}
"""Continuation of pictures outside 0..1, by glTF's codes (glTF 2.0, section 5.27)."""

ALPHA_MODES = ("OPAQUE", "MASK", "BLEND")

ROUNDED = 1.0 + 16.0 * float(np.finfo(np.float32).eps)
"""Largest factor that counts as 1: exporters compute colours in float32."""

SPECULAR_GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"


class Place(NamedTuple):
    """Mapping of a texture's picture to facets.

    Attributes
    ----------
    wrap : (str, str)
        See `Look.wrap`.
    uv_set : int
        Number of the picture's texture coordinates.
    to_picture : (2, 3) float64
        Map from these to the picture, with the origin at its top left.
    """

    wrap: tuple[str, str] = REPEAT
    uv_set: int = 0
    to_picture: Array = np.eye(2, 3)


class GltfLook(NamedTuple):
    """A material of a glTF file.

    Attributes
    ----------
    look : Look
    place : Place
        Of its base colour texture.
    gloss : (h, w, 3) float32 or None
        Picture of metallic and roughness, see `GlossPicture`.
    gloss_place : Place
    """

    look: Look
    place: Place = Place()
    gloss: Texture | None = None
    gloss_place: Place = Place()


class Looks:
    """Materials of one glTF file, each read once.

    Parameters
    ----------
    buffers : Buffers
    pictures : Pictures
    """

    def __init__(self, buffers: Buffers, pictures: Pictures) -> None:
        self.buffers, self.pictures = buffers, pictures
        self.path, self.document = buffers.path, buffers.document
        self._coded = Pictures(self.path, False, pictures.notes, as_coded)
        self._known: dict[int, GltfLook] = {}

    def of(self, number: Any) -> GltfLook:
        """Return the material with a number; a plain one if a primitive has none.

        Raises
        ------
        MeshError, ValueError
            It does not exist, or refers to an unreadable picture.
        """
        if number is None:
            return GltfLook(Look(factor=np.ones(4 if self.pictures.alpha else 3)))
        materials = entries_of(self.path, self.document, "materials")
        number = number_below(self.path, "a primitive's material", number, len(materials))
        if number not in self._known:
            self._known[number] = self._read(materials[number])
        return self._known[number]

    def _read(self, material: dict[str, Any]) -> GltfLook:
        pbr = material.get("pbrMetallicRoughness", {})
        if (other := only_specular(material)) is not None:
            pbr = {
                "baseColorFactor": other.get("diffuseFactor", [1.0] * 4),
                "metallicFactor": 0.0,
                "roughnessFactor": 1.0 - min(1.0, float(other.get("glossinessFactor", 1.0))),
                **({"baseColorTexture": other["diffuseTexture"]} if "diffuseTexture" in other else {}),
            }
        colour = np.minimum(np.array(pbr.get("baseColorFactor", [1.0] * 4), np.float64), 1.0)
        metallic, roughness = (min(1.0, float(pbr.get(key, 1.0))) for key in ("metallicFactor", "roughnessFactor"))
        base, gloss = pbr.get("baseColorTexture"), pbr.get("metallicRoughnessTexture")
        place = self._place("baseColorTexture", base) if base is not None else Place()
        look = Look(
            picture=self._opened(base, self.pictures) if base is not None else None,
            factor=colour[: 4 if self.pictures.alpha else 3],
            material=GltfMaterial((float(colour[0]), float(colour[1]), float(colour[2])), metallic, roughness),
            alpha_mode=material.get("alphaMode", "OPAQUE"),
            alpha_cutoff=float(material.get("alphaCutoff", 0.5)),
            wrap=place.wrap,
        )
        if gloss is None:
            return GltfLook(look, place)
        return GltfLook(look, place, self._opened(gloss, self._coded), self._place("metallicRoughnessTexture", gloss))

    def _content(self, info: dict[str, Any]) -> tuple[int, dict[str, Any]] | None:
        """Return number and entry of a texture's image; None, with a note, if it is in an extension."""
        textures = entries_of(self.path, self.document, "textures")
        texture = textures[number_below(self.path, "a texture's index", info.get("index"), len(textures))]
        if "source" not in texture:
            self.pictures.notes.add("a picture of an unsupported kind is left out: its facets have their plain colour")
            return None
        images = entries_of(self.path, self.document, "images")
        number = number_below(self.path, "textures.source", texture["source"], len(images))
        return number, images[number]

    def _opened(self, info: dict[str, Any], pictures: Pictures) -> Texture | None:
        if (found := self._content(info)) is None:
            return None
        number, image = found
        if "bufferView" in image:
            return pictures.of_bytes(number, bytes(self.buffers.view(image["bufferView"])[0]))
        uri = image.get("uri")
        if isinstance(uri, str) and not uri.startswith("data:"):
            return pictures.of_file(names_of(uri))
        return pictures.of_bytes(number, bytes_of(self.path, uri, "picture"))

    def _place(self, key: str, info: dict[str, Any]) -> Place:
        moved = info.get("extensions", {}).get("KHR_texture_transform", {})
        offset, scale = (
            finite_numbers(self.path, f"{key} of KHR_texture_transform", moved.get(key, default), 2)
            for key, default in (("offset", [0.0, 0.0]), ("scale", [1.0, 1.0]))
        )
        (angle,) = finite_numbers(self.path, "rotation of KHR_texture_transform", [moved.get("rotation", 0.0)], 1)
        cos, sin = np.cos(angle), np.sin(angle)
        # Counter-clockwise as seen in the picture, with rows running down.
        linear = np.array([[cos, sin], [-sin, cos]]) * scale
        uv_set = moved.get("texCoord", info.get("texCoord", 0))
        return Place(self._wrap(key, info), uv_set, np.column_stack([linear, offset]))

    def _wrap(self, key: str, info: dict[str, Any]) -> tuple[str, str]:
        """Return a texture's continuation outside its picture, across and down."""
        textures, samplers = (entries_of(self.path, self.document, key) for key in ("textures", "samplers"))
        texture = textures[number_below(self.path, f"{key}.index", info.get("index"), len(textures))]
        if (given := texture.get("sampler")) is None:
            return REPEAT
        number = number_below(self.path, "textures.sampler", given, len(samplers))
        across, down = (samplers[number].get(each, REPEATS) for each in ("wrapS", "wrapT"))
        for each, mode in (("wrapS", across), ("wrapT", down)):
            if not isinstance(mode, int) or mode not in WRAPS:
                shown = reprlib.repr(mode)[:LONGEST_NAME]
                raise MeshError(
                    f"{self.path}: broken: samplers[{number}].{each} is {shown}; valid are {', '.join(map(str, WRAPS))}"
                )
        return WRAPS[across], WRAPS[down]


def only_specular(material: dict[str, Any]) -> dict[str, Any] | None:
    """Return the specular-glossiness extension of a material without a metallic-roughness description, else None."""
    if "pbrMetallicRoughness" in material:
        return None
    return material.get("extensions", {}).get(SPECULAR_GLOSSINESS)


def check_material(path: Any, where: str, material: dict[str, Any]) -> None:
    """Raise on a value of a material that glTF does not allow.

    Parameters
    ----------
    path : Path
        The file, for messages.
    where : str
        The material's place in it.
    material : dict

    Raises
    ------
    MeshError
        Naming the value.
    """
    pbr = material.get("pbrMetallicRoughness", {})
    shares = {f"{key}": pbr.get(key, 1.0) for key in ("metallicFactor", "roughnessFactor")}
    colours = {"baseColorFactor": pbr.get("baseColorFactor", [1.0] * 4)}
    if (other := only_specular(material)) is not None:
        shares["glossinessFactor"] = other.get("glossinessFactor", 1.0)
        colours["diffuseFactor"] = other.get("diffuseFactor", [1.0] * 4)
        if not isinstance(other.get("diffuseTexture", {}), dict):
            raise MeshError(f"{path}: broken: {where}.diffuseTexture is not an object")
    for key, value in shares.items():
        if not _is_share(value):
            raise MeshError(f"{path}: {where}.{key} is {reprlib.repr(value)}; valid are numbers from 0 to 1")
    for key, colour in colours.items():
        if not isinstance(colour, list) or len(colour) != 4 or not all(map(_is_share, colour)):
            shown = reprlib.repr(colour)[:LONGEST_NAME]
            raise MeshError(f"{path}: {where}.{key} is {shown}; valid are four numbers from 0 to 1")
    mode, cutoff = material.get("alphaMode", "OPAQUE"), material.get("alphaCutoff", 0.5)
    if mode not in ALPHA_MODES:
        raise MeshError(f"{path}: {where}.alphaMode is {reprlib.repr(mode)}; valid are {', '.join(ALPHA_MODES)}")
    if isinstance(cutoff, bool) or not isinstance(cutoff, int | float) or not 0.0 <= cutoff < np.inf:
        raise MeshError(f"{path}: {where}.alphaCutoff is {reprlib.repr(cutoff)}; valid are numbers from 0")


def _is_share(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value <= ROUNDED
