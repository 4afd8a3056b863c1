"""Scene in a notebook cell: a page that turns, in a frame, or a still picture where there can be none."""

import io
from pathlib import Path

import PIL.Image

from lfmesh.templates import filled
from lfmesh.view.output.html import has_extra, page_of
from lfmesh.view.pictures import file_url
from lfmesh.view.scene3d.plotter import View

MOST_BYTES = 2_600_000
"""Largest page in a cell: with it and a still picture, a cell stays below 3 MB. More makes notebooks slow to open."""

MOST_HEIGHT_PX = 560

STILL = 'This picture is still. For a scene that turns: pip install "lfmesh[browser]", then restart the kernel.'
TOO_LARGE = (
    "This picture is still, because a page that turns would take {size:.1f} MB. "
    'lf.show(..., html="scene.html") writes one of any size.'
)

TEMPLATE = Path(__file__).parent / "templates" / "cell.html"


class ShownPicture(PIL.Image.Image):
    """Picture of a scene that a notebook shows as HTML: a page that turns, or the picture with a note.

    Parameters
    ----------
    picture : PIL.Image.Image
    html : str
    """

    def __init__(self, picture: PIL.Image.Image, html: str) -> None:
        super().__init__()
        vars(self).update(vars(picture))
        self._html = html

    def _repr_html_(self) -> str:
        return self._html

    def _repr_png_(self) -> None:
        """Leave out the larger one of two still pictures; the JPEG is for programs that show no HTML."""


def shown_in_cell(view: View, picture: PIL.Image.Image) -> ShownPicture:
    """Return the picture of a view as a notebook shows it.

    Parameters
    ----------
    view : View
    picture : PIL.Image.Image
        Of the view.
    """
    if not has_extra():
        return ShownPicture(picture, _still(view, picture, STILL))
    page = page_of(view)
    size = len(page.encode())
    if size > MOST_BYTES:
        return ShownPicture(picture, _still(view, picture, TOO_LARGE.format(size=size / 1e6)))
    width, height = picture.size
    return ShownPicture(
        picture, filled(TEMPLATE, page=page, title=view.title, width=width, height=min(height, MOST_HEIGHT_PX))
    )


def _still(view: View, picture: PIL.Image.Image, words: str) -> str:
    content = io.BytesIO()
    picture.convert("RGB").save(content, format="JPEG")
    url = file_url(content.getvalue(), "image/jpeg")
    return filled(TEMPLATE, page="", title=view.title, picture=url, words=words)
