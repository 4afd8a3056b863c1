"""World, run and light field shown by all pages of a server, read once and never changed."""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from lfmesh.files import run
from lfmesh.lightfield.calibration.calibration import Calibration
from lfmesh.transport.render.image import Image
from lfmesh.view.browser.field_views import FieldViews, calibration_of_run
from lfmesh.view.request import Subject, sensor_picture, subject_of

if TYPE_CHECKING:
    from lfmesh.scene import Scene
    from lfmesh.transport.world import World
    from lfmesh.view.rays.paths import Rays


@dataclass(frozen=True)
class PageSubject:
    """Scene, or run with its image and light field.

    Attributes
    ----------
    seen : Subject
    image : Image or None
        Image of the run.
    folder : Path or None
        Run folder.
    rays : Rays or None
        Initial rays.
    """

    seen: Subject
    image: Image | None
    folder: Path | None
    rays: "Rays | None"

    @classmethod
    def read(
        cls, subject: "Scene | World | Image | str | os.PathLike[str]", rays: "Rays | None" = None
    ) -> "PageSubject":
        """Read a subject.

        Raises
        ------
        LfmeshError
            The scene or run does not exist or is damaged.
        """
        folder = Path(subject) if isinstance(subject, str | os.PathLike) and Path(subject).is_dir() else None
        image = run.open_run(folder) if folder is not None else subject if isinstance(subject, Image) else None
        if rays is not None:
            seen = Subject(rays.world, sensor_picture(image) if image is not None else None)
        else:
            seen = subject_of(subject if image is None else image)
        return cls(seen, image, folder, rays)

    @property
    def scene(self) -> "Scene":
        """Solved scene."""
        return self.seen.world.scene

    @cached_property
    def calibration(self) -> Calibration:
        """Positions of the micro-images; tracing them takes seconds for a large array."""
        return calibration_of_run(self.scene, self.folder)

    @cached_property
    def field_views(self) -> FieldViews:
        """Light field of the run.

        Raises
        ------
        LfmeshError
            A file of the run is damaged, or its camera records no light field.
        """
        assert self.image is not None
        assert self.folder is not None
        return FieldViews(self.image, self.folder, self.calibration)
