"""JSON Schema of the scene file: `lfmesh schema`."""

import json

from lfmesh.cli.application import app


@app.command
def schema() -> int:
    """Print the JSON Schema of scene files."""
    from lfmesh.scene import Scene

    print(json.dumps(Scene.model_json_schema(), indent=2))
    return 0
