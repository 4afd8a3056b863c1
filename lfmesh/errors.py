"""The one exception family: everything a user can cause ends in an `LfmeshError` with one clear message."""


class LfmeshError(Exception):
    """A mistake the user can mend: the message names the field or file, the value, and what is valid."""


class SceneError(LfmeshError):
    """The scene file or model is wrong; the message lists every fault, one a line."""


class MeshError(LfmeshError):
    """A mesh file is missing, empty, broken, or not what its use needs."""


class GlassError(LfmeshError):
    """A glass or refractive index that the catalogue does not hold at the wished wavelength."""


class FileError(LfmeshError):
    """A run folder, image or texture cannot be read or written."""


class LensFileWarning(UserWarning):
    """A lens file or glTF scene was read with approximations, or holds what the reader does not know."""
