"""The built scene as kernels read it: flat tables of surfaces, facets, media, frames, materials and lights."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lenslets import Lenslets
from lfmesh.geometry.meshes.patch_tree import PatchTree
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined
from lfmesh.transport.tables.lights import Lamps
from lfmesh.transport.tables.scattering import ScatteringTables
from lfmesh.transport.tables.varied_gloss import VariedGloss

Array = NDArray[np.float64]
Records = NDArray[np.void]


@by_address
class Interfaces(NamedTuple):
    """Interfaces of a region (see `tables.interfaces`)."""

    rows: Records  # (n,) INTERFACE
    parameters: Array  # (parameters of all, wavelengths); those of an interface begin in its `first` row
    coated: bool = False  # whether any of them is not bare
    thin: bool = False  # whether any of them is a thin lens
    rough: bool = False  # whether any of them scatters light


@by_address
class Absorption(NamedTuple):
    """Absorption of media."""

    per_mm: Array  # (media, wavelengths) absorption coefficients, 1/mm
    slot: NDArray[np.int64]  # (media,) of the book; NO_SLOT where a medium is clear


@by_address
class Media(NamedTuple):
    """Media that rays travel through, one row for each (see `tables.media`)."""

    indices: Array  # (media, wavelengths) refractive indices
    # Absorption where a medium of the region absorbs, else None: code for the other case is not even compiled.
    absorption: Any = None


AIR = 0
"""Number of the medium that every scene has: air, and in object space what bodies stand in, see `tables.media`."""


@by_address
class LensTables(NamedTuple):
    """The main lens in the camera frame.

    Refracting surface k separates space k (towards the object) from space k + 1. A ring joins the rims of two
    neighbouring surfaces, so that every space inside the lens is closed: a packet in it can meet the two surfaces and
    the ring of that space only. Any other facet that Embree reports is refused and the ray queried again.
    """

    surfaces: Records  # (K,) SURFACE
    patches: Array  # (m, 6, 3) curved facets; (0, 6, 3) where the surface level needs none
    across: NDArray[np.int64]  # (m, 3) neighbours of each patch
    tree: PatchTree  # of the patches
    facets: Records  # (m,) FACET; body: surface k ≥ 0, or −1 − s for the ring of space s
    media: Media
    medium: NDArray[np.int64]  # (K + 1,) medium of each space
    interfaces: Interfaces  # one row for each surface
    ring_slot: NDArray[np.int64]  # (K + 1,) book slot of each space's ring
    mount_slot: NDArray[np.int64]  # (K,) book slot of the mount outside each surface's clear aperture
    stop_space: int  # −1: the stop is a refracting surface
    stop_z: float
    stop_radius: float
    stop_posed: bool  # the stop that is no refracting surface stands off its place, as `pose` of a SURFACE says
    stop_pose: Array  # (3, 4)
    stop_unpose: Array  # (3, 4)
    box_low: Array  # (3,) mm, bounding box of the meshes of all surfaces
    box_high: Array
    convex_front: bool  # a ray that leaves the first surface towards the object cannot meet the lens again
    convex_back: bool
    lost_slot: NDArray[np.int64]  # (K + 1,) book slot of energy lost in each space
    order: Array  # (K + 1, 12) the conics of each space and what rays it holds for, see `tables.lens.surface_order`
    ordered: NDArray[np.bool_]  # (K + 1,) whether there are rays in a space whose surface is known without a mesh
    by_roots: NDArray[np.bool_]  # (K + 1,) whether all surfaces of a space are exact conics without a pose
    aperture: Any = None  # Apertures where the stop diffracts: code for that is not even compiled otherwise


@by_address
class Apertures(NamedTuple):
    """Apertures of the lenslets, or the stop, as diffraction needs them (see `events.kick`)."""

    shape: int  # RECTANGLE, HEXAGON or ROUND
    spread: Array  # (wavelengths, 2) wavelength over width, in x and y; 0: the aperture has no end in that direction
    quantiles: Array  # see `diffraction.sinc2_quantiles`
    cells: NDArray[np.float32]  # of a hexagon, see `diffraction.hexagon_cells`; else without rows
    row: int  # of the face that has them among the array's interfaces; of the stop −1
    to_lens: bool  # that face looks to the lens
    events: int  # interfaces that a packet from a pixel has met when it first comes here
    # Shift of a point of the sensor that turns a ray through a given point of the lenslets aimed at, by one radian
    # behind the array, over the point's distance from them.
    lever: float


@by_address
class MlaTables(NamedTuple):
    """The microlens array in its own frame, z from the curved face into the glass; one cell mesh for each type.

    Where both faces have lenslets, these are the tables of the one towards the sensor, and `back` those of the other
    one, in a frame of its own whose z runs from there into the glass.
    """

    present: bool
    lenslets: Lenslets
    patches: Array  # as for the lens
    across: NDArray[np.int64]
    tree: PatchTree
    facets: Records  # (m,) FACET of the cells of all types, side by side
    type_shift: float  # mm, x distance between the cells of two types in the Embree scene
    media: Media
    medium: int  # medium of the lenslets
    interfaces: Interfaces  # CURVED_ROW and FLAT_ROW
    curved_to_lens: bool
    frame: int  # MLA_FRAME; of the lenslets of `back` BACK_FRAME
    cells: int  # station at which packets wait for a face in its cell
    cells_mesh: int  # the same, by its mesh
    row: int  # of the lenslets' face among the interfaces
    face: int  # number of that face in recorded vertices
    # MlaTables of the lenslets on the other face, else None: code for them is not even compiled.
    back: Any = None
    # Apertures where they diffract, else None, likewise.
    apertures: Any = None


def undiffracted(mla: MlaTables) -> MlaTables:
    """Return the tables of the array, of both its faces, without diffraction."""
    if mla.apertures is None:
        return mla
    return mla._replace(apertures=None, back=None if mla.back is None else mla.back._replace(apertures=None))


@by_address
class SensorTables(NamedTuple):
    """The pixels, in the sensor's frame: z = 0, light arrives with dz > 0."""

    columns: int
    rows: int
    pixel: float  # mm
    reflectance: float  # share of the light that is reflected; the rest is detected


@by_address
class Camera(NamedTuple):
    """The parts of the camera that sequences of faces lead through."""

    lens: LensTables
    mla: MlaTables
    sensor: SensorTables
    frames: Array  # (6, 6, 3, 4): frames[a, b] moves from frame a into frame b
    cover: Any = None  # CoverTables where the sensor has a cover


BY_ALPHA = -1.0
"""`ObjectTables.opacity` of a target whose texture has it."""

OPAQUE = -1
"""`ObjectTables.medium` of a target that is not a body of glass."""


@by_address
class Emitters(NamedTuple):
    """Pieces of emitting facets, from which points are drawn as light sources (see `tables.emitting_facets`)."""

    facet: NDArray[np.int64]  # (n,) facet of each piece
    until: Array  # (n,) cumulative chance of the pieces, within each leaf of the tree if there is one
    nodes: Records  # (nodes,) EMITTER_NODE, see `tables.emitter_tree`; (0,): pieces are few, and there is no tree
    # (n, 3) barycentric weights of the facet's corners 1 and 2 at each piece's corner 0, and its size; of a round face
    # its parameters
    place: Array
    density: Array  # (n,) chance of each piece, within its leaf, over its area, 1/mm²
    number: NDArray[np.int64]  # (n,) places of the pieces of each facet, one facet after the other, in these tables
    first: NDArray[np.int64]  # (m,) where the pieces of each facet of object space begin in `number`; −1: none
    level: NDArray[np.int64]  # (m,) how often each facet is divided in four


@by_address
class SingleScatter(NamedTuple):
    """Light that media in air scatter near lamps, by the angle from the lamp (see `tables.single_scatter`)."""

    angles: Array  # (n + 1,) rad, from 0 to π; (0,): there is none, or next to none
    phase: Array  # (wavelengths, n) 1/sr, mean phase function between two angles
    beyond: Array  # (wavelengths, n + 1) its integral over the angle from each angle to π
    below: Array  # (wavelengths, n + 1) integral of that over the angle from 0 to each angle
    scattering: Array  # (media, wavelengths) 1/mm, largest coefficient of each medium in air
    extent: Array  # (media,) mm, largest length of a line in each medium; inf: it has no bounds


_NONE = np.zeros((0, 0))
NOTHING_NEAR_LAMPS = SingleScatter(np.zeros(0), _NONE, _NONE, _NONE, _NONE, np.zeros(0))


@by_address
class GlassTables(NamedTuple):
    """Tables of bodies of glass in object space."""

    interfaces: Interfaces  # for each target one row for each medium, see `body_row`
    level: NDArray[np.int64]  # (targets,) surface level of a body of glass
    patches: Array  # (m, 6, 3), or none
    across: NDArray[np.int64]
    tree: PatchTree  # of the patches of polished bodies
    contact_first: NDArray[np.int64]  # (m + 1,) where each facet's `contacts` begin; (0,) where no bodies touch
    contacts: NDArray[np.int64]  # for each facet, facets of other bodies of glass that it may lie on
    contact_mm: float  # distance within which facets are in contact
    boxes: Array  # (targets, 2, 3) mm, object frame: corners of the box that holds each target
    emits_inside: NDArray[np.bool_]  # (targets,) emits in bodies, where the forward method starts light
    models: NDArray[np.int64]  # (rows of `ScatteringTables.models`, media) row of the same surface in each medium


@by_address
class ObjectTables(NamedTuple):
    """Targets, lights and the camera's housing in the object frame: world axes about the targets' middle."""

    # (m,) FACET; body: target t ≥ 0, or −1 for the housing. The last rows, without a normal, stand for `rounds`.
    facets: Records
    uv: Array  # (m, 3, 2)
    one_sided: NDArray[np.bool_]  # (targets,) scatters and emits on the side of its normals only; the other absorbs
    scattering: ScatteringTables
    # (m,) row of the scattering model of each facet, in the first of the media round its target; of the housing 0
    model: NDArray[np.int64]
    varied: VariedGloss  # models of facets whose gloss a picture varies
    smooth: NDArray[np.bool_]  # (targets,) shaded with normals interpolated between the facets' corners
    radiance: Array  # (targets, wavelengths) W/(m² sr), which the model of emission lowers
    emission_spectra: Array  # (targets, wavelengths) radiance relative to the largest of its target
    media: Media
    medium: NDArray[np.int64]  # (targets,) medium of a body of glass; OPAQUE for all other targets
    # (targets,) rank of a body of glass, from 1; 0 for all other targets. Where bodies overlap, the medium is that of
    # the highest rank.
    rank: NDArray[np.int64]
    by_rank: NDArray[np.int64]  # (bodies of glass + 1,) target of each rank
    texture: NDArray[np.int64]  # (targets, 3): first value, height, width; height 0: none
    texels: NDArray[np.float32]  # (values, wavelengths), or (values, primaries) where there are weights
    texel_weights: Array  # (wavelengths, primaries) of the values' primaries at each wavelength; (0, 0): none
    opacity: Array  # (targets,) share of the surface that is there; BY_ALPHA: as the texture says
    alpha_first: NDArray[np.int64]  # (targets,) first value in `alpha`
    alpha: NDArray[np.float32]  # (values,) opacity at the texels of such targets
    target_slot: NDArray[np.int64]  # (targets,) book slot
    lost_slot: NDArray[np.int64]  # (targets + 1,) book slot of energy lost at each target; the last: in open space
    lamps: Lamps  # and parallel light
    emitters: Emitters
    sources: Records  # SOURCE: where the forward method starts packets
    radius: float  # mm, of a sphere about the origin that holds the targets
    outer_radius: float  # mm, of a sphere about the origin that holds targets, camera and media; inf: not all media
    lit_middle: Array  # (3,) mm, centre of the sphere at which lamps' packets are aimed
    lit_radius: float  # mm, radius of that sphere
    # GlassTables where there are bodies of glass, else None: code for them is not even compiled.
    glass: Any = None
    # Volumes of media that absorb, emit or scatter, else None, likewise.
    volumes: Any = None
    # RoundFaces where rays meet spheres, cylinders or disks themselves, else None, likewise.
    rounds: Any = None


@by_address
class Disks(NamedTuple):
    """Disks in the plane of an opening, by two numbers of the points that see them; see `aims.disks`.

    Rows and columns are evenly spaced, and centre and radius are interpolated between the nodes.
    """

    column_step: float  # columns begin at 0
    first: float  # of the first row
    row_step: float
    middle: Array  # (n + 1, m + 1) mm, centre of the disk along the meridian, positive towards the point
    radius: Array  # (n + 1, m + 1) mm; −1: no light gets through in the intervals round the node
    # (2, 2) mm, x and y of what poses of lens elements add to the centre: in the first row, and for each row further.
    decentre: Array


@by_address
class Opening(NamedTuple):
    """Effective pupil of one side of the lens: disks in a plane perpendicular to the axis.

    From points close before the plane the disks shrink towards it as the distance does. Where nothing is known of it,
    its tables are closed, see `aims.mixture.anywhere`.
    """

    plane_z: float  # mm, camera frame
    sense: float  # 1: points lie before the plane (smaller z), −1: behind it
    far: Disks  # by the tangent of the field angle, and one over the distance, 1/mm
    near_depth: float  # mm, distance below which points are near; 0: the scene has no such points
    near: Disks  # of near points, by height over the axis and distance, mm


@by_address
class LensAim(NamedTuple):
    """Aim at one side of the lens. Disks are perpendicular to the axis, in the camera frame; see `aims.mixture`."""

    opening: Opening  # holds the image path
    wide_radius: float  # mm, of a disk in the plane of `opening` that every ray to the lens crosses
    wide_share: float  # share of unaimed rays, from a point that sees the opening
    share_without_aim: float  # share of rays that are sent at all, all unaimed, from a point that sees no opening
    # GlassAim where light is aimed through glass or liquids, else None: code for it is not even compiled.
    glass: Any = None
    ghosts: Any = None  # GhostTables where rays go to where ghosts come from, else None, likewise


@by_address
class LensletAim(NamedTuple):
    """Aim at the lenslets that show the lens's opening to a point of the sensor, array frame; see `aims.lenslets`."""

    apex_z: float  # mm, lenslet apexes as the sensor sees them
    pupil_x: float  # mm, centre of the paraxial exit pupil; it gives the cell that the chief ray meets
    pupil_y: float
    pupil_vergence: float  # 1 / reduced distance from the curved face to the exit pupil, 1/mm; 0: telecentric
    slope: Array  # (cells, 2) slope of the ray from a lenslet's centre to the centre of the opening that it sees
    slope_radius2: Array  # (cells,) squared radius, in slopes, of the opening about that; −1: the lenslet sees none
    # (rings + 1,) relative root mean square of the light in rings of a view, of equal area, from the centre; last 0
    shown: Array
    cell_margin: float  # mm by which aimed cells are larger than the lattice's, as meshes of their faces deviate
    search: float  # pitches, largest distance of a lenslet that shows the opening from the pixel's chief ray


@by_address
class AimTables(NamedTuple):
    """Tables of the aim of rays."""

    entrance: LensAim  # as seen from the targets
    exit: LensAim  # as seen from the sensor; with an array, from the lenslets
    lenslets: LensletAim  # the shares of rays through them are those of `exit`


class Tables(NamedTuple):
    """All tables of a scene."""

    lens: LensTables
    mla: MlaTables
    sensor: SensorTables
    objects: ObjectTables
    frames: Array  # (6, 6, 3, 4): frames[a, b] moves from frame a into frame b
    aim: AimTables
    polarised: Any = None  # PolarisationTables where packets carry a state of polarisation
    cover: Any = None  # CoverTables where the sensor has a cover
    # (6, 6, 3, 4) as `frames`, with the sensor where it appears to be through its cover, if it has one: for aiming
    apparent: Any = None
    ghosts: Any = None  # GhostTables where ghosts are estimated by themselves

    @property
    def camera(self) -> Camera:
        """The parts of the camera, without diffraction: for rays, which have no random numbers."""
        return Camera(self.lens._replace(aperture=None), undiffracted(self.mla), self.sensor, self.frames, self.cover)

    @property
    def camera_of_packets(self) -> Camera:
        """The same with diffraction, where the scene asks for it."""
        return Camera(self.lens, self.mla, self.sensor, self.frames, self.cover)


NO_SLOT = -1
"""In place of a slot of the book, in tables by which no packet is traced."""

KINDS = ("smooth and bare", "coated", "coated with layers that absorb", "a thin lens", "diffuse", "ground")
"""Kinds of interfaces by their number, as messages name them. Rough ones come last, by the name of their finish."""

BARE, COATED, ABSORBING, THIN_LENS, DIFFUSE, GROUND = range(len(KINDS))

ROUGH = DIFFUSE
"""First kind of rough interfaces, which scatter light."""

INTERFACE = np.dtype(
    [
        ("kind", "i8"),  # number in `KINDS`
        ("first", "i8"),  # row of its first parameter
        ("pieces", "i8"),  # of a coating's table
        ("slot", "i8"),  # of the book, for light that a coating absorbs
    ]
)

FACES_OF_ARRAY, FACES_OF_COVER = 2, 2
"""Interfaces that light meets on its way through the microlens array, and through the sensor's cover."""

CURVED_ROW, FLAT_ROW = 0, 1
"""Rows of the array's interfaces: of the face that `camera.mla` describes, and of the other one."""


def thin_lens_power(interfaces: Interfaces, number: int) -> float:
    """Return the power of a thin lens, 1/mm; 0 for an interface."""
    row = interfaces.rows[number]
    return float(interfaces.parameters[row["first"], 0]) if row["kind"] == THIN_LENS else 0.0


@inlined
def body_row(body: int, other: int, media: int) -> int:
    """Return the row of a target's interface with another medium.

    Parameters
    ----------
    body : int
        Number of the target.
    other : int
        Medium on the target's outside.
    media : int
        Number of media.
    """
    return body * media + other


FIRST_VOLUME = -2
"""`facet` of the first medium in a table of sources; the others have smaller numbers."""

SOURCE = np.dtype(
    [
        ("light", "i8"),  # number of the light, or −1
        ("facet", "i8"),  # number of the emitting facet, −1, or of a medium FIRST_VOLUME − its number
        ("until", "f8"),  # cumulative share of the power
        ("share", "f8"),
        ("power", "f8"),  # W; facets: all sides, texture value 1; directional light: through the targets' disk
    ]
)
