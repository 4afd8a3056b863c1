"""The built scene as the kernels read it: flat tables of surfaces, facets, media, frames, materials and lights."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.lenslets import Lenslets
from lfmesh.transport.tables.scattering import ScatteringTables

Array = NDArray[np.float64]
Records = NDArray[np.void]


class Interfaces(NamedTuple):
    """What stands at the interfaces of a region (see `tables.interfaces`)."""

    rows: Records  # (n,) INTERFACE
    parameters: Array  # (numbers, wavelengths), those of an interface from its `first` row on


class Media(NamedTuple):
    """What rays travel through, a row a medium (see `tables.media`)."""

    indices: Array  # (media, wavelengths) of refraction


AIR = 0
"""Number of the medium that every scene has."""


class LensTables(NamedTuple):
    """The main lens in the camera frame.

    Refracting surface k separates space k (towards the object) from space k + 1. A ring joins the rims of two
    surfaces, so that every space inside the lens is closed: a packet in it meets its own two surfaces, its own ring,
    or nothing. What Embree reports beyond that is a contradiction, to be queried again.
    """

    surfaces: Records  # (K,) SURFACE
    patches: Array  # (m, 6, 3) curved facets, (0, 6, 3) where the level needs none
    across: NDArray[np.int64]  # (m, 3) their neighbours
    facets: Records  # (m,) FACET; body: surface k ≥ 0, or −1 − s for the ring of space s
    media: Media
    medium: NDArray[np.int64]  # (K + 1,) of each space
    indices: Array  # (K + 1, wavelengths) of these
    interfaces: Interfaces  # a row a surface
    ring_slot: NDArray[np.int64]  # (K + 1,) book slot of each space's ring
    mount_slot: NDArray[np.int64]  # (K,) book slot of what lies outside each surface's clear aperture
    stop_space: int  # −1: the stop is a refracting surface
    stop_z: float
    stop_radius: float
    box_low: Array  # (3,) bounds of all caps
    box_high: Array
    convex_front: bool  # a ray that leaves the first surface towards the object cannot meet the lens again
    convex_back: bool
    lost_slot: NDArray[np.int64]  # (K + 1,) book slot of what is lost in each space


class ArrayTables(NamedTuple):
    """The microlens array in its own frame (z from the curved face into the glass), folded into one cell a type."""

    present: bool
    lenslets: Lenslets
    patches: Array  # as the lens's
    across: NDArray[np.int64]
    facets: Records  # (m,) FACET of the cells of all types, side by side
    type_shift: float  # x distance of two types' cells in the Embree scene
    media: Media
    medium: int  # of the glass
    indices: Array  # (wavelengths,) of the glass
    interfaces: Interfaces  # CURVED_ROW and FLAT_ROW
    curved_to_lens: bool


class SensorTables(NamedTuple):
    """The pixels, in the sensor's frame: z = 0, light arrives with dz > 0."""

    columns: int
    rows: int
    pixel: float  # mm


OPAQUE = -1
"""In place of the medium of a target that is none."""


class ObjectTables(NamedTuple):
    """Targets, lights and the camera's housing in the object frame: world axes about the targets' middle."""

    facets: Records  # (m,) FACET; body: target t ≥ 0, or −1 for the housing
    uv: Array  # (m, 3, 2)
    closed: NDArray[np.bool_]  # (targets,) scatters and emits outside only
    scattering: ScatteringTables
    radiance: Array  # (targets, wavelengths) W/(m² sr)
    media: Media
    medium: NDArray[np.int64]  # (targets,) of a body of glass; OPAQUE: of any other
    interfaces: Interfaces  # a row a target
    # (targets,) of a body of glass, from 1; 0: none. Where bodies overlap, the medium is that of the highest rank.
    rank: NDArray[np.int64]
    by_rank: NDArray[np.int64]  # (bodies of glass + 1,) target of each rank
    contact_first: NDArray[np.int64]  # (m + 1,) of each facet, its first one in `contacts`; (0,) where no bodies touch
    contacts: NDArray[np.int64]  # facets of other bodies of glass that it may lie on
    contact_mm: float  # distance within which facets that touch lie on each other
    level: NDArray[np.int64]  # (targets,) what a facet of glass stands for
    patches: Array  # (m, 6, 3), or none
    across: NDArray[np.int64]
    texture: NDArray[np.int64]  # (targets, 3): first value, height, width; height 0: none
    texels: NDArray[np.float32]  # (values, wavelengths)
    target_slot: NDArray[np.int64]  # (targets,)
    lost_slot: NDArray[np.int64]  # (targets + 1,) of what is lost in glass or beside a target; the last: in the open
    lights: Records  # LIGHT
    sources: Records  # SOURCE: what the forward method starts from
    radius: float  # of a sphere round the origin that holds the targets
    outer_radius: float  # of one that holds the camera too
    lit_middle: Array  # (3,) centre and
    lit_radius: float  # radius of the sphere at which the packets of lamps are aimed


class Opening(NamedTuple):
    """What of a side of the lens lets light through, as points see it: disks in a plane square to the axis.

    By field angle (columns, evenly spaced in its tangent) and distance (rows, evenly spaced in its inverse).
    """

    known: bool
    plane_z: float  # camera frame
    sense: float  # 1: points lie before the plane (smaller z), −1: behind it
    tangent_step: float
    nearness: float  # 1 / distance of the first row, 1/mm
    nearness_step: float
    middle: Array  # (n + 1, m + 1) mm along the meridian, towards the point
    radius: Array  # (n, m) mm, of the meshes between; −1: nothing gets through


class AimTables(NamedTuple):
    """Where rays are aimed. Disks are square to the axis, in the camera frame.

    Most rays go to the lens's opening, which holds the image path; a share goes to a disk that every ray that can reach
    the lens at all crosses, or to the whole hemisphere.
    """

    entrance: Opening  # as seen from the targets
    front_radius: float  # of the wide disk in its plane
    exit: Opening  # as seen from the sensor, where there is no array
    back_radius: float
    wide_share: float  # of the rays from a point that sees the opening, and ...
    share_without_aim: float  # ... that are sent at all from one that sees none
    # The array: which lenslets show the opening to a point of the sensor.
    lenslet_z: float  # the apexes as the sensor sees them, array frame
    pupil_x: float  # middle of the paraxial exit pupil, array frame: with it, the chief ray's cell is found
    pupil_y: float
    pupil_vergence: float  # 1 / reduced distance from the curved face to the exit pupil, 1/mm; 0: telecentric
    slope: Array  # (cells, 2) of the ray from a lenslet's middle to the middle of the opening that it sees
    slope_radius2: Array  # (cells,) square of how far from that a ray may go and still reach it; −1: it sees none
    sure2: float  # part of that square within which a lenslet surely shows the opening
    cell_margin: float  # mm by which an aimed cell stands out: a mesh of its face is not quite where that is
    search: int  # cells to each side that may show the pupil


class Tables(NamedTuple):
    """All of it."""

    lens: LensTables
    array: ArrayTables
    sensor: SensorTables
    objects: ObjectTables
    frames: Array  # (5, 5, 3, 4): frames[a, b] moves from frame a into frame b
    aim: AimTables


INTERFACE = np.dtype(
    [
        ("kind", "i8"),  # number in `tables.interfaces.KINDS`
        ("first", "i8"),  # row of its parameters
    ]
)

CURVED_ROW, FLAT_ROW = 0, 1
"""Rows of the array's interfaces."""

SOURCE = np.dtype(
    [
        ("light", "i8"),  # number of the light, or −1
        ("facet", "i8"),  # number of the emitting facet, or −1
        ("until", "f8"),  # cumulative share of the power
        ("share", "f8"),
        ("power", "f8"),  # W at full texture, all sides (facets); directional: over the targets' disk
    ]
)
