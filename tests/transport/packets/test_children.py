"""Numbers that one packet draws for different uses are independent."""

import itertools
import re
from pathlib import Path

import lfmesh
from lfmesh.scene.settings.transport import MOST_EVENTS
from lfmesh.transport.packets import children
from lfmesh.transport.regions.targets import FACETS

PACKAGE = Path(lfmesh.__file__).parent
USES = {name: number for name, number in vars(children).items() if name.isupper()}


def test_no_two_uses_take_the_same_child_of_a_key():
    firsts = sorted([0, *USES.values(), FACETS])
    assert all(after - before > MOST_EVENTS for before, after in itertools.pairwise(firsts))


def test_every_use_that_counts_events_stands_in_the_list():
    text = "".join(path.read_text() for path in sorted(PACKAGE.glob("transport/**/*.py")))
    counted = set(re.findall(r"derived\(\w*\.?key, (\w+) \+ (?:packet\.)?events\)", text))
    assert {"IN_MEDIUM", "IN_WALK", "IN_KICK"} <= counted
    assert counted <= set(USES)
