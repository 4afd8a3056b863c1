"""Numbers of the children of a packet's key, one range for each use.

What a packet draws beside its own numbers comes from children of its key (see `random.derived`). Two uses of one number
would draw the same random numbers, and what they decide would depend on one another. So all uses stand here: except
`EMITTED`, each has room for the number of an event, at most `scene.settings.transport.MOST_EVENTS`. The plain number of
an event is the child that an interface splits off. `surface.VARIED` and `targets.FACETS`, far beyond, are followed by
the number of a facet.
"""

AIMED_CHILD = 1 << 20
"""Child that is sent towards a lens, a lamp, or what else is aimed at."""

IN_MEDIUM = 2 << 20
"""Path through media."""

IN_WALK = 3 << 20
"""Walk between the facets of rough glass."""

TOWARDS_MEDIA = 4 << 20
"""Ray to an emitting medium."""

IN_DENSITY = 5 << 20
"""Estimate of the density of a direction at rough glass."""

IN_KICK = 6 << 20
"""Change of direction by diffraction."""

IN_ORDER = 7 << 20
"""Child in a further diffraction order of a phase; its own children have the numbers of the orders."""

TOWARDS_SCATTERED = 8 << 20
"""Ray past a lamp, whose light a medium scatters."""

IN_BENDING = 9 << 20
"""Rest of a path behind a node in an index field."""

EMITTED = 16 << 20
"""Place in the texture of an emitting facet."""
