"""Commands by task: headings and order in `lfmesh --help`, and the example that begins each command's help."""

from cyclopts import App, Group

TASKS = {
    "Everyday": {
        "demo": "lfmesh demo",
        "check": "lfmesh check scene.toml",
        "view": "lfmesh view scene.toml",
        "render": "lfmesh render scene.toml -o run/",
        "white": "lfmesh white run/",
        "decode": "lfmesh decode run/",
        "refocus": "lfmesh refocus run/ --distance-mm 480",
        "depth": "lfmesh depth run/",
        "expose": "lfmesh expose run/ --bayer RGGB",
        "export": "lfmesh export run/ --format hci -o hci/",
    },
    "Lenses and scene files": {
        "new": "lfmesh new scene.toml --camera ng_2005_handheld",
        "draw": "lfmesh draw scene.toml -o layout.svg",
        "lens": "lfmesh lens list",
        "lens list": "lfmesh lens list",
        "lens convert": "lfmesh lens convert singlet.zmx singlet.toml",
        "lens sheet": "lfmesh lens sheet scene.toml -o sheet.pdf",
        "schema": "lfmesh schema > scene.schema.json",
    },
    "Other images and models": {
        "grid": "lfmesh grid flow.vtu -o plume.vti --units m --spacing-mm 1 1 1",
        "frames": "lfmesh frames particles.toml -o pair/",
        "schlieren": "lfmesh schlieren hot/ cold/",
        "psf": "lfmesh psf scene.toml --point-mm 0 0 -480 --window 64 -o spread/",
        "matrix": "lfmesh matrix scene.toml -o m.npz --grid g.npz --position-mm 0 0 -500",
        "camera-model": "lfmesh camera-model scene.toml -o camera.exr",
    },
    "Many cameras": {
        "compare": "lfmesh compare scene.toml -o comparison/",
        "study": "lfmesh study study.toml -o out/",
        "study merge": "lfmesh study merge study.toml a/ b/ c/ -o out/",
        "optimise": "lfmesh optimise assets/designs/triplet.toml -o best/",
        "fit": "lfmesh fit white.png scene.toml -o fitted/",
        "dataset": "lfmesh dataset template.toml -o data/ --count 100",
        "accuracy": "lfmesh accuracy scene.toml -o report/",
    },
}
"""Commands by heading, each with an example; a space separates a command from its subcommand."""


def arrange(app: App) -> None:
    """Put each command under its heading, with its example first and each paragraph of its help on one line.

    Parameters
    ----------
    app : App
        Program with all commands.
    """
    for number, (heading, examples) in enumerate(TASKS.items()):
        group = Group(heading, sort_key=number)
        for place, (words, example) in enumerate(examples.items()):
            command = app
            for word in words.split():
                command = command[word]
            command.help_prologue = f"Example: {example}"
            # Source lines are longer than a terminal's.
            command.help = "\n\n".join(" ".join(part.split()) for part in command.help.split("\n\n"))
            if " " not in words:
                command.group = group
                command.sort_key = place
