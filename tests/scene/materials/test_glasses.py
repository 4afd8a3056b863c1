"""The glasses of a scene in words: where they are, which catalogue they come from, and what they are."""

import lfmesh as lf
from lfmesh.cli import main
from tests.cameras import close_up_camera


def test_check_prints_every_glass_with_catalogue_index_and_abbe_number(tmp_path, capsys):
    camera = close_up_camera()
    surfaces = [dict(surface) for surface in camera["lens"]["surfaces"]]
    surfaces[0] = {key: value for key, value in surfaces[0].items() if key != "index"} | {"glass": "NSSK2_SCHOTT"}
    mla = {key: value for key, value in camera["mla"].items() if key != "index"} | {"glass": "n-bk7"}
    film = {"layers": [{"glass": "SILICA", "thickness_nm": 90.0}]}
    scene = lf.Scene(camera=camera | {"lens": {"surfaces": surfaces}, "mla": mla}, coatings={"film": film})
    (tmp_path / "scene.toml").write_text(scene.dump_toml())
    assert main(["check", str(tmp_path / "scene.toml")]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("glass ")]
    assert [line.split(maxsplit=1)[1] for line in lines] == [
        "SCHOTT/N-SSK2 (nd 1.62229, Vd 53.27): surface 0",
        "SCHOTT/N-BK7 (nd 1.51680, Vd 64.17): mla",
        "main/SiO2/Malitson (nd 1.45846, Vd 67.82): coating film",
    ]
