"""Extension of Sphinx for this site: keys and commands that its search finds."""

from typing import Any

from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment


def setup(app: Sphinx) -> dict[str, Any]:
    """Add the directives `key` and `command`."""
    app.add_object_type("key", "key", parse_node=_key, objname="key of a file")
    app.add_object_type("command", "command", objname="command")
    return {"parallel_read_safe": True}


def _key(env: BuildEnvironment, signature: str, node: addnodes.desc_signature) -> str:
    """Show a key without its table: "Sensor.pixels" as "pixels"."""
    key = signature.rsplit(".", 1)[1]
    node += addnodes.desc_name(key, key)
    return signature
