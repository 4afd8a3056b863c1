"""The built scene for kernels: flat tables of surfaces, facets, media, frames, materials and lights."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lenslets import Lenslets
from lfmesh.geometry.meshes.patch_tree import PatchTree
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined
from lfmesh.optics.gradients import Gradients
from lfmesh.transport.tables.lights import Lamps
from lfmesh.transport.tables.scattering import ScatteringTables
from lfmesh.transport.tables.varied_gloss import VariedGloss

Array = NDArray[np.float64]
Records = NDArray[np.void]


@by_address
class Interfaces(NamedTuple):
    """Interfaces of a region (see `tables.interfaces`)."""

    rows: Records  # (n,) INTERFACE
    parameters: Array  # (parameters of all, wavelengths); an interface's parameters begin in its `first` row
    coated: bool = False  # whether any of them is not bare
    thin: bool = False  # whether any of them is a thin lens
    rough: bool = False  # whether any of them scatters light
    # PhaseFaces if any of them has a phase, else None: code for the other case is not even compiled.
    phases: Any = None


@by_address
class Absorption(NamedTuple):
    """Absorption of media."""

    per_mm: Array  # (media, wavelengths) absorption coefficients, 1/mm
    slot: NDArray[np.int64]  # (media,) slot of the book; NO_SLOT if a medium is clear


@by_address
class Media(NamedTuple):
    """Media of rays, one row each (see `tables.media`)."""

    indices: Array  # (media, wavelengths) refractive indices
    # Absorption if a medium of the region absorbs, else None: code for the other case is not even compiled.
    absorption: Any = None


AIR = 0
"""Number of the medium that every scene has: air, or the medium outside the lens, see `tables.media`."""


@by_address
class LensTables(NamedTuple):
    """The main lens in the camera frame.

    Refracting surface k separates space k (towards the object) from space k + 1. A ring joins the rims of two
    neighbouring surfaces, so every space inside the lens is closed: a packet can meet only the two surfaces and the
    ring of its space. Any other facet that Embree reports is refused and the ray queried again.
    """

    surfaces: Records  # (K,) SURFACE
    patches: Array  # (m, 6, 3) curved facets; (0, 6, 3) if the surface level needs none
    across: NDArray[np.int64]  # (m, 3) neighbours of each patch
    tree: PatchTree  # of the patches
    facets: Records  # (m,) FACET; body: surface k ≥ 0, or −1 − s for the ring of space s
    media: Media
    medium: NDArray[np.int64]  # (K + 1,) medium of each space
    interfaces: Interfaces  # one row per surface
    ring_slot: NDArray[np.int64]  # (K + 1,) book slot of each space's ring
    mount_slot: NDArray[np.int64]  # (K,) book slot of the mount outside each surface's clear aperture
    stop_space: int  # −1: the stop is a refracting surface
    stop_z: float
    stop_radius: float
    stop_posed: bool  # a stop that is no refracting surface is displaced, as by `pose` of a SURFACE
    stop_pose: Array  # (3, 4)
    stop_unpose: Array  # (3, 4)
    box_low: Array  # (3,) mm, bounding box of the meshes of all surfaces
    box_high: Array
    convex_front: bool  # a ray that leaves the first surface towards the object cannot meet the lens again
    convex_back: bool
    lost_slot: NDArray[np.int64]  # (K + 1,) book slot of energy lost in each space
    order: Array  # (K + 1, 12) the conics of each space and the rays they hold for, see `tables.lens.surface_order`
    ordered: NDArray[np.bool_]  # (K + 1,) whether the surface is known without a mesh for some rays in a space
    by_roots: NDArray[np.bool_]  # (K + 1,) whether all surfaces of a space are exact conics without a pose
    aperture: Any = None  # Apertures if the stop diffracts: code for that is not even compiled otherwise
    gradients: Any = None  # GradientSpaces if gradient-index glass fills a space, else None, likewise


@by_address
class Apertures(NamedTuple):
    """Apertures of the lenslets, or the stop, for diffraction (see `events.kick`)."""

    shape: int  # RECTANGLE, HEXAGON or ROUND
    # (wavelengths, 2) wavelength over width, in x and y, for the array the wavelength in the medium outside it; 0: the
    # aperture has no end in that direction
    spread: Array
    quantiles: Array  # see `diffraction.sinc2_quantiles`
    cells: NDArray[np.float32]  # of a hexagon, see `diffraction.hexagon_cells`; else without rows
    row: int  # row of their face among the array's interfaces; −1 for the stop
    to_lens: bool  # that face is towards the lens
    events: int  # interfaces met by a packet from a pixel when it first comes here
    # Shift of a point on the sensor that turns a ray through a given point of the lenslets aimed at, by one radian
    # behind the array, over the point's distance from them.
    lever: float


@by_address
class CellGradients(NamedTuple):
    """Gradient-index glass of the array's plate, as seen from one of its faces (see `events.gradient_cell`)."""

    gradients: Gradients  # one profile per wavelength, about the axis of a lenslet
    steps: NDArray[np.int64]  # (wavelengths,) equal steps of a ray from face to face
    longest: Array  # (wavelengths,) mm in σ, longest step; rays that need longer ones take more
    outside: Array  # (wavelengths,) refractive index of the medium outside the plate
    acceptance: Array  # (wavelengths,) approximate tangent of the steepest rays outside that pass through a lenslet
    axes: Array  # (cells, 2) mm, axis of each gradient from its cell's centre; (0, 2): all in the centres
    opposite: Lenslets  # lenslets of the face at the other end of the plate
    clear_walls: bool  # light that reaches a wall goes on in the next cell


@by_address
class MlaTables(NamedTuple):
    """The microlens array in its own frame, z from the curved face into the glass; one cell mesh per type.

    If both faces have lenslets, these are the tables of the face towards the sensor, and `back` those of the other
    face, in its own frame with z from that face into the glass. Both faces of a gradient-index plate count as such.
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
    frame: int  # MLA_FRAME; for the lenslets of `back` BACK_FRAME
    cells: int  # station where packets wait for a face in its cell
    cells_mesh: int  # the same, by its mesh
    row: int  # row of the lenslets' face among the interfaces
    face: int  # number of that face in recorded vertices
    # MlaTables of the lenslets on the other face, else None: code for them is not even compiled.
    back: Any = None
    # Apertures if they diffract, else None, likewise.
    apertures: Any = None
    # CellGradients if the plate is gradient-index glass, else None, likewise.
    gradient: Any = None


def undiffracted(mla: MlaTables) -> MlaTables:
    """Return the tables of the array, for both faces, without diffraction."""
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
    index2: Array  # (wavelengths,) squared refractive index of the medium before the pixels


@by_address
class Camera(NamedTuple):
    """Parts of the camera for sequences of faces."""

    lens: LensTables
    mla: MlaTables
    sensor: SensorTables
    frames: Array  # (6, 6, 3, 4): frames[a, b] moves from frame a into frame b
    cover: Any = None  # CoverTables where the sensor has a cover


BY_ALPHA = -1.0
"""`ObjectTables.opacity` of a target with opacity in its texture."""

OPAQUE = -1
"""`ObjectTables.medium` of a target that is not a body of glass."""


@by_address
class Emitters(NamedTuple):
    """Pieces of emitting facets, drawn as light sources (see `tables.emitting_facets`)."""

    facet: NDArray[np.int64]  # (n,) facet of each piece
    until: Array  # (n,) cumulative chance of the pieces, within each leaf of the tree if there is one
    nodes: Records  # (nodes,) EMITTER_NODE, see `tables.emitter_tree`; (0,): no tree, as pieces are few
    # (n, 3) barycentric weights of the facet's corners 1 and 2 at each piece's corner 0, and its size; for a round face
    # its parameters
    place: Array
    density: Array  # (n,) chance of each piece, within its leaf, over its area, 1/mm²
    number: NDArray[np.int64]  # (n,) places of the pieces of each facet, one facet after the other, in these tables
    first: NDArray[np.int64]  # (m,) begin of the pieces of each facet of object space in `number`; −1: none
    level: NDArray[np.int64]  # (m,) how often each facet is divided in four
    # (trees, 2) first node and mover of the tree of each mover, in a scene with motion and with a tree, else None
    trees: Any = None


@by_address
class SingleScatter(NamedTuple):
    """Light that media in air scatter near lamps, by the angle from the lamp (see `tables.single_scatter`)."""

    angles: Array  # (n + 1,) rad, from 0 to π; (0,): no such light, or negligible
    phase: Array  # (wavelengths, n) 1/sr, mean phase function between two angles
    beyond: Array  # (wavelengths, n + 1) its integral over the angle from each angle to π
    below: Array  # (wavelengths, n + 1) integral of that over the angle from 0 to each angle
    scattering: Array  # (media, wavelengths) 1/mm, largest coefficient of each medium in air
    extent: Array  # (media,) mm, largest length of a line in each medium; inf: unbounded


_NONE = np.zeros((0, 0))
NOTHING_NEAR_LAMPS = SingleScatter(np.zeros(0), _NONE, _NONE, _NONE, _NONE, np.zeros(0))


@by_address
class GlassTables(NamedTuple):
    """Tables of bodies of glass in object space."""

    interfaces: Interfaces  # one row per target and medium, see `body_row`
    level: NDArray[np.int64]  # (targets,) surface level of a body of glass
    patches: Array  # (m, 6, 3), or none
    across: NDArray[np.int64]
    tree: PatchTree  # of the patches of polished bodies
    contact_first: NDArray[np.int64]  # (m + 1,) begin of each facet's `contacts`; (0,) if no bodies touch
    contacts: NDArray[np.int64]  # for each facet, facets of other bodies of glass that it may lie on
    contact_mm: float  # distance within which facets are in contact
    boxes: Array  # (targets, 2, 3) mm, object frame: corners of the box that holds each target
    emits_inside: NDArray[np.bool_]  # (targets,) emits in bodies, where the forward method starts light
    models: NDArray[np.int64]  # (rows of `ScatteringTables.models`, media) row of the same surface in each medium


@by_address
class ObjectTables(NamedTuple):
    """Targets, lights and the housing in the object frame: world axes about the targets' middle."""

    # (m,) FACET; body: target t ≥ 0, or −1 for the housing. The last rows, without a normal, stand for `rounds`.
    facets: Records
    uv: Array  # (m, 3, 2)
    one_sided: NDArray[np.bool_]  # (targets,) scatters and emits on the side of its normals only; the other absorbs
    scattering: ScatteringTables
    # (m,) row of the scattering model of each facet, in the first medium around its target; 0 for the housing
    model: NDArray[np.int64]
    varied: VariedGloss  # models of facets with gloss that a picture varies
    smooth: NDArray[np.bool_]  # (targets,) shaded with normals interpolated between the facets' corners
    radiance: Array  # (targets, wavelengths) W/(m² sr), before the reduction by the model of emission
    emission_spectra: Array  # (targets, wavelengths) radiance relative to the largest of its target
    media: Media
    medium: NDArray[np.int64]  # (targets,) medium of a body of glass; OPAQUE for all other targets
    # (targets,) rank of a body of glass, from 1; 0 for all other targets. If bodies overlap, the medium is that of
    # the highest rank.
    rank: NDArray[np.int64]
    by_rank: NDArray[np.int64]  # (bodies of glass + 1,) target of each rank
    texture: NDArray[np.int64]  # (targets, 3): first value, height, width; height 0: none
    texels: NDArray[np.float32]  # (values, wavelengths), or (values, primaries) if there are weights
    texel_weights: Array  # (wavelengths, primaries) of the values' primaries at each wavelength; (0, 0): none
    opacity: Array  # (targets,) share of the surface that is present; BY_ALPHA: given by the texture
    alpha_first: NDArray[np.int64]  # (targets,) first value in `alpha`
    alpha: NDArray[np.float32]  # (values,) opacity at the texels of such targets
    target_slot: NDArray[np.int64]  # (targets,) book slot
    lost_slot: NDArray[np.int64]  # (targets + 1,) book slot of energy lost at each target; the last: in open space
    lamps: Lamps  # and parallel light
    emitters: Emitters
    sources: Records  # SOURCE: start of packets in the forward method
    radius: float  # mm, of a sphere about the origin that holds the targets
    outer_radius: float  # mm, of a sphere about the origin that holds targets, camera and media; inf: not all media
    lit_middle: Array  # (3,) mm, centre of the sphere at which packets from lamps are aimed
    lit_radius: float  # mm, radius of that sphere
    # GlassTables if there are bodies of glass, else None: code for them is not even compiled.
    glass: Any = None
    # Volumes of media that absorb, emit or scatter, else None, likewise.
    volumes: Any = None
    # RoundFaces if rays meet spheres, cylinders or disks themselves, else None, likewise.
    rounds: Any = None
    # BendingFields of media that bend light, else None, likewise.
    fields: Any = None


@by_address
class Disks(NamedTuple):
    """Disks in the plane of an opening, by two coordinates of the points that see them; see `aims.disks`.

    Rows and columns are evenly spaced. Centre and radius are interpolated between the nodes.
    """

    column_step: float  # columns begin at 0
    first: float  # coordinate of the first row
    row_step: float
    middle: Array  # (n + 1, m + 1) mm, centre of the disk along the meridian, positive towards the point
    radius: Array  # (n + 1, m + 1) mm; −1: no light gets through in the intervals around the node
    # (2, 2) mm, shift of the centre in x and y by poses of lens elements: in the first row, and per further row.
    decentre: Array


@by_address
class Opening(NamedTuple):
    """Effective pupil of one side of the lens: disks in a plane perpendicular to the axis.

    For points close to the plane the disks shrink in proportion to the distance. If nothing is known, the tables are
    closed, see `aims.mixture.anywhere`.
    """

    plane_z: float  # mm, camera frame
    sense: float  # 1: points lie in front of the plane (smaller z), −1: behind it
    far: Disks  # by the tangent of the field angle, and one over the distance, 1/mm
    near_depth: float  # mm, distance below which points are near; 0: the scene has no such points
    near: Disks  # for near points, by height over the axis and distance, mm


@by_address
class LensAim(NamedTuple):
    """Aim at one side of the lens. Disks are perpendicular to the axis, in the camera frame; see `aims.mixture`."""

    opening: Opening  # holds the image path
    wide_radius: float  # mm, of a disk in the plane of `opening` that every ray to the lens crosses
    wide_share: float  # share of unaimed rays, from a point that sees the opening
    share_without_aim: float  # share of rays sent at all, all unaimed, from a point that sees no opening
    # GlassAim if light is aimed through glass or liquids, else None: code for it is not even compiled.
    glass: Any = None
    ghosts: Any = None  # GhostTables if rays are aimed at origins of ghosts, else None, likewise


@by_address
class LensletAim(NamedTuple):
    """Aim at the lenslets that show the lens's opening to a point of the sensor, array frame (`aims.lenslet_aim`)."""

    apex_z: float  # mm, lenslet apexes as the sensor sees them
    pupil_x: float  # mm, centre of the paraxial exit pupil, which gives the cell of the chief ray
    pupil_y: float
    pupil_vergence: float  # 1 / reduced distance from the curved face to the exit pupil, 1/mm; 0: telecentric
    slope: Array  # (cells, 2) slope of the ray from a lenslet's centre to the centre of its view of the opening
    slope_radius2: Array  # (cells,) squared radius, in slopes, of that view; −1: the lenslet sees no opening
    # (rings + 1,) relative root mean square of the light in rings of equal area in a view, from the centre; last 0
    shown: Array
    cell_margin: float  # mm by which aimed cells are larger than the lattice's, as meshes of their faces deviate
    search: float  # pitches, largest distance of a lenslet that shows the opening from the pixel's chief ray


@by_address
class AimTables(NamedTuple):
    """Tables of the aim of rays."""

    entrance: LensAim  # as seen from the targets
    exit: LensAim  # as seen from the sensor; with an array, from the lenslets
    lenslets: LensletAim  # `exit` gives the shares of rays through them


class Tables(NamedTuple):
    """All tables of a scene."""

    lens: LensTables
    mla: MlaTables
    sensor: SensorTables
    objects: ObjectTables
    frames: Array  # (6, 6, 3, 4): frames[a, b] moves from frame a into frame b
    aim: AimTables
    polarised: Any = None  # PolarisationTables if packets carry a state of polarisation
    cover: Any = None  # CoverTables where the sensor has a cover
    # (6, 6, 3, 4) as `frames`, with the sensor where it appears to be through its cover, if it has one: for aiming
    apparent: Any = None
    ghosts: Any = None  # GhostTables if ghosts are estimated by themselves
    motions: Any = None  # Motions if anything moves during the exposure

    @property
    def camera(self) -> Camera:
        """Parts of the camera without diffraction, for rays, which have no random numbers."""
        return Camera(self.lens._replace(aperture=None), undiffracted(self.mla), self.sensor, self.frames, self.cover)

    @property
    def camera_of_packets(self) -> Camera:
        """Parts of the camera, with diffraction if the scene asks for it."""
        return Camera(self.lens, self.mla, self.sensor, self.frames, self.cover)


NO_SLOT = -1
"""Placeholder for a slot of the book, in tables that trace no packets."""

KINDS = ("smooth and bare", "coated", "coated with layers that absorb", "a thin lens", "diffuse", "ground")
"""Kinds of interfaces by number, as named in messages. Rough kinds come last, with the name of their finish."""

BARE, COATED, ABSORBING, THIN_LENS, DIFFUSE, GROUND = range(len(KINDS))

ROUGH = DIFFUSE
"""First rough kind of interface, which scatters light."""

INTERFACE = np.dtype(
    [
        ("kind", "i8"),  # number in `KINDS`
        ("first", "i8"),  # row of its first parameter
        ("pieces", "i8"),  # pieces of a coating's table
        ("slot", "i8"),  # slot of the book for light absorbed by a coating
    ]
)

FACES_OF_ARRAY, FACES_OF_COVER = 2, 2
"""Number of interfaces on the way through the microlens array, and through the sensor's cover."""

CURVED_ROW, FLAT_ROW = 0, 1
"""Rows of the array's interfaces: the face described by `camera.mla`, and the other face."""


def thin_lens_power(interfaces: Interfaces, number: int) -> float:
    """Return the power of a thin lens, 1/mm; 0 for other interfaces."""
    row = interfaces.rows[number]
    return float(interfaces.parameters[row["first"], 0]) if row["kind"] == THIN_LENS else 0.0


@inlined
def body_row(body: int, other: int, media: int) -> int:
    """Return the row of a target's interface with an outer medium.

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
"""`facet` of the first medium in a table of sources; further media have smaller numbers."""

SOURCE = np.dtype(
    [
        ("light", "i8"),  # number of the light, or −1
        ("facet", "i8"),  # number of the emitting facet, −1, or for a medium FIRST_VOLUME − its number
        ("until", "f8"),  # cumulative share of power
        ("share", "f8"),
        ("power", "f8"),  # W; facets: all sides, texture value 1; directional light: through the targets' disk
    ]
)
